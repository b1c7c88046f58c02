"""Gross errors below the size of unmodelled effects: named where a gap separates them, unless a condition explains them."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import SCENE, simulated
from robot_model import load_robot
from workbench.fitting.plausibility import check_plausibility

ROWS = np.array([3, 9, 15, 22, 30])


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def displaced(recording, rows, size_mm=1.6, **columns):
    points = {name: recording.columns[name].copy() for name in ("x_mm", "y_mm", "z_mm")}
    points["z_mm"][rows] -= size_mm
    return replace(recording, columns={**recording.columns, **points, **columns})


def found(recording):
    return check_plausibility(load_robot(recording.robot), recording)


def test_a_sound_recording_has_none(truth):
    assert found(truth) == ()


@pytest.mark.parametrize("rows", [ROWS, ROWS[:1]])
def test_rows_that_a_gap_separates_are_named(rows, truth):
    (one,) = found(displaced(truth, rows))
    assert one.cause == "blunders" and one.rows == tuple(rows.tolist()) and not one.certain


@pytest.mark.parametrize("rows", [ROWS, ROWS[:1]])
def test_an_effect_of_a_load_is_no_gross_error(rows, truth):
    load = np.zeros(truth.n)
    load[rows] = 5.0
    assert found(displaced(truth, rows, payload_kg=load)) == ()


def test_neighbouring_rows_are_an_effect_of_their_time(truth):
    assert not any(one.cause == "blunders" for one in found(displaced(truth, np.arange(20, 24))))


def test_errors_that_fill_the_range_are_an_unmodelled_effect(truth):
    """As large as before, but with all sizes in between."""
    random = np.random.default_rng(5)
    effect = np.geomspace(0.02, 1.6, truth.n)[random.permutation(truth.n)]
    assert found(displaced(truth, slice(None), effect)) == ()
