"""The posterior of a linear fit agrees with the dense formulas for every prior and every variance of the noise."""

import numpy as np
import pytest

from test_shrinkage import waved
from workbench.core.least_squares.solver import solve
from workbench.fitting.priors.linear_posterior import LinearFit, Posterior, without_free

NOISE = (0.3, 1.0, 20.0)


@pytest.fixture(scope="module")
def linear():
    model, free, _ = waved(3e-3, 30)
    return LinearFit.of(solve(model, free))


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("wider", [1.0, 100.0])
def test_solution_and_covariance_are_those_of_the_normal_equations(linear, noise, wider):
    precision = linear.precision / wider
    posterior = Posterior(linear, precision)
    information = linear.normal / noise + np.diag(precision)
    covariance = np.linalg.inv(information)
    right = (linear.normal @ linear.deviation - linear.gradient) / noise
    np.testing.assert_allclose(posterior.covariance(noise), covariance, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(posterior.variances(noise), np.diag(covariance), rtol=1e-7)
    np.testing.assert_allclose(posterior.values(noise), covariance @ right, rtol=1e-6, atol=1e-9)


def test_the_evidence_is_the_largest_over_the_noise(linear):
    """Against the log density of the data, on a grid of variances, with the number of parameters spent."""
    posterior = Posterior(linear, linear.precision)
    best = posterior.evidence((linear.noise,))
    grid = linear.noise * np.geomspace(0.3, 3, 61)
    values = [_log_evidence(linear, linear.precision, noise) for noise in grid]
    assert best == pytest.approx(max(values), abs=0.5)


def test_the_most_probable_noise_maximises_the_density_of_the_data(linear):
    posterior = Posterior(linear, linear.precision)
    best = posterior.most_probable_noise()
    largest = _log_evidence(linear, linear.precision, best)
    for factor in (0.5, 0.8, 1.25, 2.0):
        assert _log_evidence(linear, linear.precision, factor * best) < largest


def _log_evidence(linear, precision, noise):
    information = linear.normal / noise + np.diag(precision)
    step = np.linalg.solve(information, -linear.gradient / noise - precision * linear.deviation)
    squares = linear.squares + 2 * linear.gradient @ step + step @ linear.normal @ step
    values = linear.deviation + step
    count = linear.count - linear.eliminated
    volume = np.log(precision).sum() - np.linalg.slogdet(information)[1] - count * np.log(noise)
    return 0.5 * (volume - squares / noise - values @ (precision * values))


def test_elimination_leaves_the_information_of_the_others():
    rows = np.random.default_rng(3).normal(size=(40, 7))
    normal = rows.T @ rows
    kept = np.array([True, False, True, True, False, False, True])
    reduced, rank = without_free(normal, kept)
    assert rank == 3
    np.testing.assert_allclose(np.linalg.inv(reduced), np.linalg.inv(normal)[np.ix_(kept, kept)])
