"""Effects on the noise: their size is found, with a sigma that covers it, and the mean gains by it."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import model_of, observed, scene
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.solver import solve

TRUE = 0.8


ROW = ("noise-heteroscedastic", "noise", {"covariate": "range_mm", "mean": 250.0, "spread": 29.0})
KEY = "noise.noise-heteroscedastic.range_mm"


def _fit(seed):
    """The value found and its sigma, on 150 samples whose noise grows with range."""
    model = model_of(scene("external-point", n=150, seed=seed), ROW)
    truth = model.parameters.update({KEY: TRUE})
    extra = np.random.default_rng(seed).normal(size=(3, 150)) * model.sigma(truth)
    noisy = observed(model, truth)
    moved = replace(noisy.chain.measurement, measured=noisy.chain.measurement.measured + extra)
    noisy = replace(noisy, chain=replace(noisy.chain, measurement=moved))
    fit = solve(noisy, noisy.parameters.free("base.*", "tool.*", KEY))
    known = identifiability(fit.normal, fit.parameters, fit.sigma_scale)
    return fit.parameters[KEY], np.sqrt(known.covariance[-1, -1])


@pytest.mark.parametrize("seed", range(3))
def test_the_growth_of_the_noise_is_found_within_four_sigma(seed):
    value, std = _fit(seed)
    assert 0.01 < std < 0.1
    assert abs(value - TRUE) < 4 * std


def test_its_sigma_covers_it():
    gaps = np.array([(value - TRUE) / std for value, std in map(_fit, range(10, 40))])
    # 30 draws: the spread of their gaps lies within 0.7 and 1.35 of what is stated in 99 of 100 runs
    assert 0.7 < gaps.std() < 1.35
