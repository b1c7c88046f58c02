"""Poses of a simulated arm whose rotations are in another frame than their positions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import Mapping
from import_scenes import UR10, degrees, pose_scene, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

SCENE = pose_scene("ur10", 40, 77, "share_of_limits = 0.4")


@pytest.mark.parametrize("sequence", ["xyz", "quaternion"])
def test_rotations_of_another_frame_are_named(sequence, tmp_path):
    truth = simulated(tmp_path, SCENE)
    turns = Rotation.from_quat(np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1))
    turned = Rotation.from_euler("z", 90, degrees=True) * turns
    header = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    if sequence == "quaternion":
        header += ["qx", "qy", "qz", "qw"]
        cells = turned.as_quat()
    else:
        header += ["RotX", "RotY", "RotZ"]
        cells = turned.as_euler(sequence)
    rows = np.column_stack([degrees(truth), truth.points, cells])
    path = write_rows(tmp_path / "t.csv", header, rows)
    with pytest.raises(InputError, match="positions fit .*without the rotations.*external-point"):
        import_recording([path], tmp_path / "out", UR10)
    alone = replace(UR10, mapping=Mapping(measures="external-point"))
    assert import_recording([path], tmp_path / "out", alone).recording.measures == "external-point"
