"""Rows in another unit than the others, and one joint column that is a row late, are named."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import SCENE, simulated
from robot_model import load_robot
from workbench.fitting.plausibility import check_plausibility


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def found(recording, **columns):
    changed = replace(recording, columns={**recording.columns, **columns})
    return check_plausibility(load_robot(recording.robot), changed)[0]


@pytest.mark.parametrize(
    ("size", "words"), [(25.4, "unit in instead of mm"), (1000.0, "unit m instead of mm")]
)
def test_rows_in_another_unit_are_named(size, words, truth):
    rows = np.array([3, 4, 11, 20, 31])
    points = truth.points.copy()
    points[rows] /= size
    one = found(truth, **dict(zip(("x_mm", "y_mm", "z_mm"), points.T)))
    assert one.cause == "length-unit" and words in one.sentence
    assert one.rows == tuple(rows.tolist())


def test_a_joint_column_that_is_a_row_late_is_named(truth):
    column = truth.columns["q3_deg"]
    one = found(truth, q3_deg=np.append(column[:1], column[:-1]))
    assert one.cause == "column-shifted" and one.certain
    assert "column q3_deg is 1 row late against the other columns" in one.sentence
