"""Import of tables with remarks: small gross errors are named, and so is what the file itself says of its rows."""

import numpy as np
import pytest

from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

JOINTS = [f"J{k}" for k in range(1, 7)]
LETTERS = [f"Drehwinkel Achse {letter}" for letter in "ABCDEF"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, truth, points, joints=JOINTS):
    """With remarks in rows 6 and 14 of the file, and a column that nothing is read from."""
    remarks = {4: "laser lost", 12: "repeat"}
    rows = [
        (*angles, *point, 0.7, remarks.get(k, ""))
        for k, (angles, point) in enumerate(zip(degrees(truth), points))
    ]
    return write_rows(path, [*joints, "X", "Y", "Z", "Confidence", "Remark"], rows)


def test_small_gross_errors_are_named_with_their_sizes_and_the_remarks(truth, tmp_path):
    points = truth.points.copy()
    points[4, 1] += 2.0
    points[23, 0] -= 1.5
    made = import_recording([table(tmp_path / "t.csv", truth, points)], tmp_path / "out", UR10)
    (doubt,) = made.suspicions
    assert "2 of 36 rows are off" in doubt and "In the file: rows 6 and 25." in doubt
    assert "5 (1.99 mm) and 24 (1.51 mm)" in doubt
    assert any("row 6 'laser lost', row 14 'repeat'" in text for text in made.warnings)


def test_a_refusal_names_remarks_and_unused_columns(truth, tmp_path):
    points = np.random.default_rng(3).permutation(truth.points) * [1.0, 0.3, 1.0]
    with pytest.raises(InputError) as problem:
        import_recording([table(tmp_path / "t.csv", truth, points)], tmp_path / "out", UR10)
    assert "'Remark': row 6 'laser lost', row 14 'repeat'" in str(problem.value)
    assert "Columns that are not used: 'Confidence', 'Remark'." in str(problem.value)


def test_remarks_are_no_cells_of_a_column_of_numbers(truth, tmp_path):
    headers = [f"a{k}{k}" for k in range(6)]
    with pytest.raises(InputError) as problem:
        import_recording(
            [table(tmp_path / "t.csv", truth, truth.points[:, [0, 0, 2]], headers)],
            tmp_path / "out",
            UR10,
        )
    assert "expected numbers in all rows" not in str(problem.value)


def test_axes_that_are_named_by_letters_are_a_series(truth, tmp_path):
    """D is the fourth axis, and no deviation."""
    source = table(tmp_path / "t.csv", truth, truth.points, LETTERS)
    made = import_recording([source], tmp_path / "out", UR10)
    assert made.mapping.joints.columns == tuple(LETTERS)
    assert not made.suspicions
