"""The variance that a model misses: a posterior mean that is right on average, and no threshold at chance."""

import numpy as np
import pytest

from workbench.fitting.discrepancy import expected_discrepancy

NOISE, KNOWN, COUNT = 1.0, 1.08, 390


def estimate(mean_square, count=COUNT):
    return expected_discrepancy(mean_square, KNOWN, NOISE, count)


def test_a_discrepancy_far_above_its_uncertainty_is_the_difference():
    for missed in (1.0, 5.0, 400.0):
        assert estimate(KNOWN + missed) == pytest.approx(missed, rel=0.02)


def test_a_model_without_a_discrepancy_gets_little_and_never_nothing():
    """The difference cut off at zero adds nothing to half of the models and 3 % of the variance on average."""
    draws = KNOWN * np.random.default_rng(0).chisquare(COUNT, 400) / COUNT
    found = np.array([estimate(draw) for draw in draws])
    assert (found > 0).all() and np.median(found) < 0.01
    assert found.mean() < 0.03 and np.diff(found[np.argsort(draws)]).min() >= 0


def test_the_estimate_is_right_on_average_over_the_prior():
    """Half of the models miss nothing, the others a half-Cauchy size: the mean error of the estimate is zero."""
    rng = np.random.default_rng(1)
    size = np.abs(rng.standard_cauchy(4000)) * (rng.random(4000) < 0.5)
    size = size[size < 3]  # the tail has no mean
    mean_square = (KNOWN + size**2) * rng.chisquare(COUNT, len(size)) / COUNT
    error = np.array([estimate(one) for one in mean_square]) - size**2
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(len(error))
    # also where only models count that seem to miss nothing: no selection by the estimate itself is biased
    small = mean_square < KNOWN
    assert abs(error[small].mean()) < 4 * error[small].std() / np.sqrt(small.sum())


def test_few_samples_leave_much_open():
    assert estimate(KNOWN, 12) > 10 * estimate(KNOWN, 1200) > 0
    assert expected_discrepancy(2.0, 0.0, 0.0, 10) == 2.0
