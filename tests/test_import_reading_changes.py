"""Import of a table in which unit, sign, order or convention of columns changes at a row: the rows are named."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import mostly_slow
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording
from workbench.recordings.importing.segments.row_segments import least_cost_labels

READINGS = [f"J{k}" for k in range(1, 7)]
FIRST = 18
"""Row from which on the second session stands in the table."""


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("truth"), SCENE)


def rotations(truth) -> Rotation:
    quaternions = np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1)
    return Rotation.from_quat(quaternions)


def changed(truth, kind: str):
    """Joint readings (n, 6) deg, points (n, 3) mm and angles (n, 3) deg with one change."""
    joints, points = degrees(truth), truth.points.copy()
    angles = rotations(truth).as_euler("XYZ", degrees=True)
    if kind == "gon":
        joints[FIRST:] /= 0.9
    elif kind == "both":
        joints[FIRST:] = np.deg2rad(joints[FIRST:])
        points[FIRST:] /= 1000
    elif kind == "one column":
        joints[FIRST:, 3] = np.deg2rad(joints[FIRST:, 3])
    elif kind == "sign":
        joints[FIRST:, 4] *= -1
    elif kind == "exchanged":
        points[FIRST:] = points[FIRST:, [1, 0, 2]]
    elif kind == "three parts":
        joints[12:24] = np.deg2rad(joints[12:24])
    elif kind == "convention":
        angles[FIRST:] = rotations(truth).as_euler("ZYX", degrees=True)[FIRST:]
    elif kind == "few rows":
        angles[31:] = rotations(truth).as_euler("ZYX", degrees=True)[31:]
    elif kind == "set up again":
        turned = Rotation.from_euler("z", 25, degrees=True)
        points[FIRST:] = turned.apply(points[FIRST:]) + [100.0, 50.0, 0.0]
    elif kind == "lost zero":
        joints[FIRST:, 3] += 7.0
    return joints, points, angles


CASES = {
    "gon": "degrees in rows 2 to 19 and gon in rows 20 to 37",
    "both": "J1 ... J6 in degrees and X, Y, Z in millimetres in rows 2 to 19 and J1 ... J6 in radians and "
    "X, Y, Z in metres in rows 20 to 37",
    "one column": "columns J4: expected one unit and convention in all rows, found degrees in rows 2 to 19 and "
    "radians in rows 20 to 37",
    "sign": "columns J5: expected one unit and convention in all rows, found one sign in rows 2 to 19 and the "
    "opposite sign in rows 20 to 37",
    "exchanged": "columns X, Y: expected one unit and convention in all rows, found the order of the headers in "
    "rows 2 to 19 and exchanged columns in rows 20 to 37",
    "three parts": "degrees in rows 2 to 13, radians in rows 14 to 25 and degrees in rows 26 to 37",
    "convention": "intrinsic XYZ in degrees in rows 2 to 19 and intrinsic ZYX in degrees in rows 20 to 37",
    "few rows": "intrinsic XYZ in degrees in rows 2 to 32 and intrinsic ZYX in degrees in rows 33 to 37",
    "set up again": "rows 2 to 19 and rows 20 to 37 fit the robot each by itself, but not together: the instrument or "
    "the robot's base has moved between them",
    "lost zero": "rows 2 to 19 and rows 20 to 37 fit the robot each by itself, but not together: the zero of joint 4 "
    "(lost counts, a slipped belt) has moved between them",
}


@pytest.mark.parametrize("kind", mostly_slow(CASES, 0, 5))
def test_the_rows_of_each_reading_are_named(truth, tmp_path, kind):
    joints, points, angles = changed(truth, kind)
    cells = [joints, points]
    names = [*READINGS, "X", "Y", "Z"]
    if kind in ("convention", "few rows"):
        cells.append(angles)
        names += ["A", "B", "C"]
    table = write_rows(tmp_path / "days.csv", names, np.column_stack(cells))
    with pytest.raises(InputError) as refused:
        import_recording([table], tmp_path / "made", UR10)
    assert CASES[kind] in str(refused.value)
    assert "days.csv" in str(refused.value)
    assert not (tmp_path / "made").exists()


def test_labels_of_rows_change_only_where_it_pays():
    costs = np.array([[0, 0, 9, 0, 0, 9, 9, 9], [9, 9, 0, 9, 9, 0, 0, 0]], float)
    assert least_cost_labels(costs, 8.0).tolist() == [0, 0, 0, 0, 0, 1, 1, 1]
    assert least_cost_labels(costs, 4.0).tolist() == [0, 0, 1, 0, 0, 1, 1, 1]
