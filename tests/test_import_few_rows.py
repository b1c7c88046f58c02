"""Rows that are too few to fit the geometry of the arm still decide their units by base and tool alone."""

import numpy as np
import pytest

from import_scenes import UR10, degrees, pose_scene, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

HEADER = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
TURN = ["qx", "qy", "qz", "qw"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene("ur10", 9, 5))


@pytest.mark.parametrize("scale, unit", [(1.0, "mm"), (1e-3, "m")])
def test_nine_poses_decide_units(truth, tmp_path, scale, unit):
    turns = [truth.columns[name] for name in TURN]
    cells = np.column_stack([degrees(truth), truth.points * scale, *turns])
    path = write_rows(tmp_path / "t.csv", [*HEADER, *TURN], cells)
    made = import_recording([path], tmp_path / "out", UR10)
    assert (made.mapping.joints.unit, made.mapping.point.unit) == ("deg", unit)
    assert np.abs(made.recording.points - truth.points).max() < 1e-3
    assert any("base and tool alone" in said for said in made.warnings)


def test_nine_positions_alone_are_too_few(truth, tmp_path):
    cells = np.column_stack([degrees(truth), truth.points])
    path = write_rows(tmp_path / "t.csv", HEADER, cells)
    with pytest.raises(InputError, match="too few poses to determine"):
        import_recording([path], tmp_path / "out", UR10)


def test_nine_rows_of_other_points_decide_nothing(truth, tmp_path):
    points = np.random.default_rng(1).normal(size=(truth.n, 3)) * 400
    path = write_rows(tmp_path / "t.csv", HEADER, np.column_stack([degrees(truth), points]))
    with pytest.raises(InputError, match="no interpretation fits"):
        import_recording([path], tmp_path / "out", UR10)
