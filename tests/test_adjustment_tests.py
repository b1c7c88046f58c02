"""Tests of a least-squares adjustment, on simulated linear models whose law is known."""

import numpy as np
import pytest

from workbench.core.least_squares.adjustment_tests import (
    fit_tail,
    neighbour_test,
    outlying,
    redundancy,
    regression_test,
    robust_sigma,
    standardised_squares,
    variance_test,
)


def adjusted(rng, n=80, parameters=25, law=None):
    """Whitened residual (3, n) of a random linear model, its rows (F, 3, n) and covariance (F, F)."""
    rows = rng.standard_normal((parameters, 3, n))
    flat = rows.reshape(parameters, -1)
    noise = (rng.standard_normal((3, n)) if law is None else law(rng, (3, n))).ravel()
    covariance = np.linalg.inv(flat @ flat.T)
    return (noise - flat.T @ (covariance @ (flat @ noise))).reshape(3, n), rows, covariance


def heavy(rng, shape):
    return rng.standard_t(5, shape) / np.sqrt(5 / 3)


def significant(test):
    return test.factor > 1.1 and test.p_above < 0.001


@pytest.mark.parametrize("law", [None, heavy])
def test_the_global_test_keeps_its_level_for_normal_and_heavy_tailed_noise(law):
    rng = np.random.default_rng(1)
    false_alarms = 0
    for _ in range(400):
        white, _, _ = adjusted(rng, law=law)
        false_alarms += significant(variance_test(white, white.size - 25))
    assert false_alarms <= 4


@pytest.mark.parametrize("law", [None, heavy])
def test_the_global_test_finds_noise_that_is_stated_one_and_a_half_times_too_small(law):
    rng = np.random.default_rng(2)
    tests = [variance_test(1.5 * adjusted(rng, law=law)[0], 215) for _ in range(50)]
    assert np.median([test.factor for test in tests]) == pytest.approx(1.5, rel=0.05)
    assert np.mean([significant(test) for test in tests]) > 0.9


def test_the_redundancies_add_up_to_the_degrees_of_freedom():
    white, rows, covariance = adjusted(np.random.default_rng(3))
    numbers = redundancy(rows, covariance)
    assert numbers.trace(axis1=1, axis2=2).sum() == pytest.approx(white.size - 25)


def test_standardised_squares_have_their_chi_square_law_whatever_the_leverage():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((10, 3, 30))
    rows[:, :, 0] *= 8  # a sample that the fit follows closely
    flat = rows.reshape(10, -1)
    covariance = np.linalg.inv(flat @ flat.T)
    squares = []
    for _ in range(400):
        noise = rng.standard_normal(90)
        white = (noise - flat.T @ (covariance @ (flat @ noise))).reshape(3, 30)
        squares.append(standardised_squares(white, redundancy(rows, covariance)))
    assert np.mean(squares, 0) == pytest.approx(3, abs=0.6)


@pytest.mark.parametrize("law", [None, heavy])
def test_clean_samples_are_not_called_outlying(law):
    rng = np.random.default_rng(5)
    alarms = [
        outlying((adjusted(rng, law=law)[0] ** 2).sum(0), 3, 0.9, 0.002).any() for _ in range(300)
    ]
    assert np.mean(alarms) <= 0.01


def test_a_tenth_of_faulty_samples_does_not_mask_itself():
    rng = np.random.default_rng(6)
    white = rng.standard_normal((3, 100))
    white[:, :10] += 40
    found = outlying((white**2).sum(0), 3, 1.0)
    assert found[:10].all() and not found[10:].any()


def test_the_robust_scale_ignores_faulty_samples():
    rng = np.random.default_rng(7)
    white = 0.5 * rng.standard_normal((3, 400))
    white[:, :30] += 100
    assert robust_sigma((white**2).sum(0), 3) == pytest.approx(0.5, rel=0.15)
    assert fit_tail((white**2).sum(0), 3).scale < 0.7


def test_neighbours_that_agree_are_found_and_independent_ones_are_not():
    rng = np.random.default_rng(8)
    place = np.arange(120)
    neighbour = np.maximum(place - 1, 0)
    smooth = np.sin(place / 15) + 0.3 * rng.standard_normal((3, 120))
    found = neighbour_test(smooth, neighbour)
    assert found.ratio < 0.5 and found.p_value < 1e-6
    alarms = [
        neighbour_test(rng.standard_normal((3, 60)), neighbour[:60]).p_value < 0.001
        for _ in range(150)
    ]
    assert np.sum(alarms) <= 1


def test_added_columns_are_judged_beyond_what_the_fit_absorbs():
    rng = np.random.default_rng(9)
    baseline, columns = rng.standard_normal((200, 10)), rng.standard_normal((200, 5))
    noise = rng.standard_normal(200)
    assert regression_test(noise, baseline, columns).p_value > 0.001
    found = regression_test(noise + 3 * columns[:, 0], baseline, columns)
    assert found.p_value < 1e-10 and found.share > 0.8
    absorbed = regression_test(noise, baseline, baseline[:, :3])
    assert absorbed.p_value == 1 and absorbed.share == 0
