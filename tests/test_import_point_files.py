"""A file of points for each reflector, next to one file of joint readings with the same rows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import SCENE, UR10, degrees, simulated
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

OFFSETS = np.array([[0.0, 0.0, 0.0], [120.0, 10.0, -20.0], [-30.0, 90.0, 60.0]])
HEAD = {None: "", "named": "X,Y,Z\n"}


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def files(folder, truth, offsets, head):
    turn = Rotation.from_quat(np.stack([truth.columns[f"q{k}"] for k in "xyzw"], axis=1))
    first = "J1,J2,J3,J4,J5,J6\n" if head else ""
    tables = {"joints.csv": (first, degrees(truth))}
    for number, offset in enumerate(offsets, 1):
        points = truth.points + (turn.apply(offset) if offset.ndim == 1 else offset)
        tables[f"SMR_{number}.csv"] = (HEAD[head], points)
    for name, (line, cells) in tables.items():
        rows = [",".join(f"{value:.8f}" for value in row) for row in cells]
        (folder / name).write_text(line + "\n".join(rows) + "\n")
    return [folder / name for name in tables]


@pytest.mark.parametrize("head", HEAD)
def test_files_of_points_are_reflectors(tmp_path, truth, head):
    paths = files(tmp_path, truth, OFFSETS, head)
    made = import_recording(paths, tmp_path / "out", UR10)
    recording = made.recording
    assert recording.n == 3 * truth.n and list(made.mapping.reflectors) == [
        "SMR_1",
        "SMR_2",
        "SMR_3",
    ]
    np.testing.assert_allclose(recording.points[::3], truth.points, atol=1e-6)
    np.testing.assert_allclose(recording.joints[::3], truth.joints, atol=1e-9)
    assert made.fits[0].rms_mm < 0.1
    assert any("read as 3 reflectors on one tool" in said for said in made.warnings)
    options = ImportOptions(robot="ur10", mapping=made.mapping)
    again = import_recording(paths, tmp_path / "again", options)
    np.testing.assert_allclose(again.recording.points, recording.points)


def test_points_at_changing_distances_are_asked_for(tmp_path, truth):
    scattered = np.random.default_rng(2).normal(size=(truth.n, 3)) * 20
    paths = files(tmp_path, truth, [OFFSETS[0], scattered], "named")
    with pytest.raises(InputError, match="expected one set of columns for the point"):
        import_recording(paths, tmp_path / "out", UR10)
