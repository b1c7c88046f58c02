"""Measurements that are late or early from some row on: the row and the amount are named."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import degrees, pose_scene, simulated
from robot_model import load_robot
from workbench.fitting.plausibility import check_plausibility

MEASURED = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene("kuka_kr6_r900", 50, 19))


def late_from(recording, row: int, step: int):
    """From a row on, the measurements are those of `step` rows above; the last rows repeat where none is left."""
    source = np.arange(recording.n)
    source[row:] -= step
    source = source.clip(0, recording.n - 1)
    columns = {c: v[source] if c in MEASURED else v for c, v in recording.columns.items()}
    return replace(recording, columns=columns)


def found(recording):
    return check_plausibility(load_robot(recording.robot), recording)


@pytest.mark.parametrize("row, step", [(10, 1), (10, -1), (14, 2), (20, -2)])
def test_a_shift_of_most_rows_is_named_with_its_first_row(row, step, truth):
    (one,) = found(late_from(truth, row, step))
    assert one.cause == "rows-shifted" and one.certain and abs(one.rows[0] - row) <= max(-step, 0)
    amount = f"{abs(step)} row{'s' * (abs(step) > 1)} {'late' if step > 0 else 'early'}"
    first = truth.sample_ids[one.rows[0]]
    assert f"From sample {first} on the measurements are {amount}" in one.sentence


def test_a_shift_of_two_rows_in_the_last_rows_is_no_exchange(truth):
    (one,) = found(late_from(truth, 35, 2))
    assert one.cause == "rows-shifted" and "measurement of the second row before" in one.sentence


def test_lost_decimal_points_of_single_cells_are_named(truth):
    columns = {name: cells.copy() for name, cells in truth.columns.items()}
    value = degrees(truth)[7, 2].round(3)
    columns["q3_deg"][7] = 1000 * value
    columns["y_mm"][31] *= 100
    (one,) = found(replace(truth, columns=columns))
    assert one.cause == "decimal-point" and one.rows == (7, 31)
    assert f"q3_deg {value:.8g} in place of {1000 * value:.8g}" in one.sentence


def test_a_lost_decimal_point_of_a_column_is_named(truth):
    columns = dict(truth.columns) | {"q4_deg": (1e4 * truth.columns["q4_deg"]).round()}
    (one,) = found(replace(truth, columns=columns))
    assert one.cause == "decimal-point" and one.certain
    assert "divide it by 10000" in one.sentence


def test_other_gross_errors_are_no_lost_decimal_point(truth):
    columns = {name: cells.copy() for name, cells in truth.columns.items()}
    columns["x_mm"][[5, 22]] += 37.0
    (one,) = found(replace(truth, columns=columns))
    assert one.cause == "blunders"
