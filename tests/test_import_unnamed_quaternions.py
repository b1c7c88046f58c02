"""Import of quaternions whose headers do not name the components: four columns of length 1 that differ in one letter."""

import numpy as np
import pytest

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.source import RawTable
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.recordings.importing import import_recording
from workbench.recordings.importing.interpretation.orientation_misfits import measured_rotations

JOINTS = [f"J{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def quaternions(truth, letters: str) -> np.ndarray:
    return np.stack([truth.columns[f"q{axis}"] for axis in letters], axis=1)


def raw_table(columns: dict) -> RawTable:
    count = len(next(iter(columns.values())))
    return RawTable("t.csv", columns, np.arange(2, count + 2))


@pytest.mark.parametrize(
    "names, letters",
    [
        (["ori_a", "ori_b", "ori_c", "ori_d"], "wxyz"),
        (["Lage.1", "Lage.2", "Lage.3", "Lage.4"], "xyzw"),
        (["Dreh P", "Dreh Q", "Dreh R", "Dreh S"], "wxyz"),
        (["e1", "e2", "e3", "e4"], "xyzw"),
    ],
)
def test_four_columns_of_length_1_are_a_quaternion(truth, tmp_path, names, letters):
    header = [*JOINTS, "X", "Y", "Z", *names]
    signs = np.where(np.arange(truth.n) % 3 == 0, -1.0, 1.0)[:, None]  # both signs are one rotation
    cells = [degrees(truth), truth.points, signs * quaternions(truth, letters)]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack(cells))
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.mapping.rotation.columns == tuple(names)
    assert made.mapping.rotation.convention == f"quaternion {letters}"
    assert_same_rows(made.recording, truth)
    gap = measured_rotations(made.recording) - measured_rotations(truth)
    assert np.abs(gap).max() < 1e-5


def test_rows_that_were_not_measured_do_not_hide_a_quaternion(truth):
    cells = quaternions(truth, "wxyz")
    cells[[2, 5]] = np.nan
    cells[7, 1] = np.nan
    columns = {f"rot_{letter}": cells[:, k] for k, letter in enumerate("abcd")}
    kinds = [one.kind for one in find_sets(raw_table(columns))]
    assert kinds == ["quaternion"]


@pytest.mark.parametrize("change", ["length", "one row", "five columns", "constant", "deviations"])
def test_other_columns_are_no_quaternion(truth, change):
    cells = quaternions(truth, "wxyz")
    names = [f"rot_{letter}" for letter in "abcd"]
    if change == "length":
        cells = cells * 1.1
    if change == "one row":
        cells[4] *= 2.0
    if change == "constant":
        cells[:] = cells[0]
    if change == "deviations":
        names = [f"delta_{letter}" for letter in "abcd"]
    columns = {name: cells[:, k] for k, name in enumerate(names)}
    if change == "five columns":
        columns["rot_e"] = cells[:, 0]
    assert not any(one.kind == "quaternion" for one in find_sets(raw_table(columns)))


def test_joint_readings_of_length_1_next_to_others_stay_joint_readings(truth):
    """Four of six columns of joint readings may be a unit vector by accident: only all that are alike count."""
    cells = quaternions(truth, "wxyz")
    columns = {f"A{k + 1}": cells[:, k % 4] for k in range(6)}
    assert [one.kind for one in find_sets(raw_table(columns))] == ["joints"]
    assert read_header("A1").kind == "joint"
