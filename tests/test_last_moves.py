"""Backlash where no side of approach was recorded: the arm came from where the sample before was measured."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import found, recorded
from workbench.core.covariates import last_sides
from workbench.diagnosis.robot.bench import bench_of

BACKLASH = CATALOGUE["backlash"]("joint-3", seat="moves")


def test_the_side_is_that_of_the_last_move_beyond_standing_still():
    moves = np.array([[0.0, 1.0, -2.0, 0.05, 0.0, 3.0]])
    sides = last_sides(moves, np.arange(6.0), np.array([0.1]))
    assert sides.tolist() == [[0, 1, -1, -1, -1, 1]]


def test_rounded_readings_of_a_joint_that_stands_still_change_no_side():
    rng = np.random.default_rng(1)
    long = np.repeat(rng.choice([-0.5, 0.5], 40), 10) * np.tile([1.0] + 9 * [0.0], 40)
    jitter = np.diff(rng.choice([0.0, 1.7e-4], 401))
    sides = last_sides((long + jitter)[None], np.arange(400.0), np.array([1e-3]))
    true = last_sides(long[None], np.arange(400.0), np.array([1e-3]))
    assert np.array_equal(sides, true)


def test_several_reflectors_of_a_pose_share_its_side():
    moves = np.repeat(np.array([[0.0, 0.5, -0.5, 0.4]]), 3, axis=1)
    sides = last_sides(moves, np.arange(12.0), np.array([1e-3]))
    assert sides.tolist() == [np.repeat([0, 1, -1, 1], 3).tolist()]


@pytest.mark.parametrize("reversals", [0, 1, 2])
def test_a_joint_that_hardly_reverses_has_no_side(reversals):
    """Its side is a step then, as a shift of its zero is."""
    n = 60
    way = np.ones(n)
    for k in range(reversals):
        way[20 * (k + 1) :] *= -1
    readings = {"q1_deg": np.cumsum(2.0 * way)}
    chain = bench_of(recorded(1, n=n, more=readings)).chain
    assert "joint-1" not in {
        v.effect.where for v in CATALOGUE["backlash"].candidates(chain) if v.effect.seat == "moves"
    }


def test_samples_are_taken_in_the_order_of_their_time():
    moves = np.array([[1.0, -1.0, 0.0]])
    assert last_sides(moves, np.array([2.0, 1.0, 0.0]), np.array([0.1])).tolist() == [[1, -1, 0]]


@pytest.mark.parametrize("is_recorded", [True, False])
def test_it_is_a_candidate_only_where_no_side_was_recorded(is_recorded):
    n = 40
    side = np.where(np.arange(n) % 2, 1.0, -1.0)
    more = {f"approach{k}": side for k in range(1, 7)} if is_recorded else None
    chain = bench_of(recorded(1, n=n, more=more)).chain
    seats = {v.effect.seat for v in CATALOGUE["backlash"].candidates(chain)}
    assert ("approach" in seats, "moves" in seats) == (is_recorded, not is_recorded)


@pytest.mark.slow
def test_backlash_is_named_and_not_hysteresis_without_a_recorded_side():
    findings = found(81, [BACKLASH], [3e-4], n=160).findings
    assert [(f.effect, f.where) for f in findings] == [("backlash", "joint-3")]
    assert findings[0].probability > 0.9


@pytest.mark.slow
def test_hysteresis_that_winds_up_over_long_moves_is_still_named():
    law = CATALOGUE["joint-hysteresis"]("joint-3", width=0.3)
    findings = found(82, [law], [4e-4, 0.0], n=160).findings
    assert [(f.effect, f.where) for f in findings] == [("joint-hysteresis", "joint-3")]


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_missing():
    assert not found(83, n=160).findings


@pytest.mark.slow
def test_the_first_pose_is_no_outlier_of_a_law_of_the_last_moves():
    """Nobody recorded from where the arm came to it, so that the law makes nothing of it."""
    answer = found(84, [BACKLASH], [2e-3], n=120)
    assert [(f.effect, f.where) for f in answer.findings] == [("backlash", "joint-3")]
    assert "outliers" not in {f.effect for f in answer.noise_findings} and not answer.outliers.any()
