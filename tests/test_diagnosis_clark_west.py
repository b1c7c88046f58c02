"""Significance of a held-out gain: what terms move the predictions by, in the errors without them."""

import numpy as np
import pytest

from workbench.diagnosis.levels import CRITICAL_CLARK_WEST_T
from workbench.diagnosis.validation.held_out import (
    _jackknife_t,
    _serial_factor,
    clark_west_t,
    paired_t,
)

FOLDS = 5


def held_out_errors(rng, size, poses=100, terms=1):
    """(3, n) errors of `poses` poses without and with effects of `size` sigmas, fitted to four fifths of the poses."""
    effects = size * rng.normal(size=(terms, 3, poses))
    error = rng.normal(size=(3, poses)) + effects.sum(0)
    after = error.copy()
    fold = np.arange(poses) % FOLDS
    directions = rng.normal(size=(terms, 3, poses)) if size == 0 else effects
    for k in range(FOLDS):
        seen = directions[:, :, fold != k].reshape(terms, -1).T
        found = np.linalg.lstsq(seen, error[:, fold != k].ravel())[0]
        after[:, fold == k] -= np.tensordot(found, directions[:, :, fold == k], 1)
    return error, after


def t_of(before, after):
    return clark_west_t(np.arange(before.shape[1]), before, after, np.ones(before.shape[1], bool))


def fall_of(before, after):
    lengths = [np.sqrt((one**2).sum(0)) for one in (before, after)]
    return paired_t(np.arange(len(lengths[0])), *lengths, np.ones(len(lengths[0]), bool))


def test_an_effect_near_the_noise_is_twice_as_significant_as_its_fall():
    """Noncentrality 47: the t of Clark and West is its root at most, that of the fall half of that."""
    rng = np.random.default_rng(1)
    made = [held_out_errors(rng, 0.4) for _ in range(60)]
    ours = np.array([t_of(*one) for one in made])
    falls = np.array([fall_of(*one) for one in made])
    assert np.median(ours) == pytest.approx(np.sqrt(0.4**2 * 300), rel=0.2)
    assert np.median(ours) > 1.7 * np.median(falls)
    assert (ours > CRITICAL_CLARK_WEST_T).mean() > 0.95 > (falls > CRITICAL_CLARK_WEST_T).mean()


@pytest.mark.parametrize("terms", [1, 6])
def test_absent_effects_are_hardly_ever_significant(terms):
    """Folds share most of their fits, so that t is wider than a normal's, the more the more coefficients there are."""
    rng = np.random.default_rng(2)
    chance = np.array([t_of(*held_out_errors(rng, 0.0, terms=terms)) for _ in range(1000)])
    assert (chance > CRITICAL_CLARK_WEST_T).mean() < 0.025


def autoregressive(rng, rho, n, rows=3):
    """(rows, n) of unit variance, neighbours correlated by rho."""
    made = rng.normal(size=(rows, n))
    for k in range(1, n):
        made[:, k] = rho * made[:, k - 1] + np.sqrt(1 - rho**2) * made[:, k]
    return made


def chance_of_correlated(rho, runs=300, n=150):
    """t of changes that are slow in time and have nothing to do with errors that are correlated in time."""
    rng = np.random.default_rng(5)
    out = []
    for _ in range(runs):
        error, change = autoregressive(rng, rho, n), 0.2 * autoregressive(rng, 0.9, n)
        # by its sum of products alone: as where the loss falls as much as it can
        out.append(_jackknife_t((error * change).sum(0), (change**2).sum(0), in_order=True))
    return np.array(out)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.7])
def test_errors_that_are_alike_from_pose_to_pose_prove_no_slow_effect(rho):
    """Without the correlation of neighbours 5 and 11 % of these are significant at correlations of 0.5 and 0.7."""
    assert (chance_of_correlated(rho) > CRITICAL_CLARK_WEST_T).mean() < 0.035


def test_independent_errors_lose_no_significance():
    rng = np.random.default_rng(6)
    factors = [_serial_factor(rng.normal(size=150)) for _ in range(400)]
    assert np.mean(np.array(factors) == 1.0) > 0.95


def test_the_order_is_that_of_the_rows_and_not_of_the_names_of_poses():
    rng = np.random.default_rng(7)
    error = autoregressive(rng, 0.7, 150)
    after = error - 0.3 * autoregressive(rng, 0.9, 150) - 0.2 * error
    usual, names = np.ones(150, bool), rng.permutation(150)
    assert clark_west_t(names, error, after, usual) == pytest.approx(t_of(error, after))


def test_a_rise_of_the_error_is_never_significant():
    rng = np.random.default_rng(3)
    before, change = rng.normal(size=(2, 3, 100))
    after = before - 3 * (0.3 * before + change)
    assert (after**2).sum() > (before**2).sum() and (before * (before - after)).sum() > 0
    assert t_of(before, after) < 0


def test_one_pose_proves_nothing_and_repeats_count_once():
    rng = np.random.default_rng(4)
    before = rng.normal(size=(3, 60))
    after = before.copy()
    before[:, 7] += 30
    assert t_of(before, after) < CRITICAL_CLARK_WEST_T
    one, other = held_out_errors(rng, 0.5, poses=50)
    pose = np.repeat(np.arange(50), 7)
    often = clark_west_t(pose, one[:, pose], other[:, pose], np.ones(350, bool))
    assert often == pytest.approx(t_of(one, other))
