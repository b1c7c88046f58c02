"""Rounded mirror angles: recognised from the angles alone, and a random effect of each of them."""

import numpy as np
import pytest

from sensors.light.shared_errors import decorrelated
from workbench.diagnosis.scanner.sensor_linear import rounding_std, rounding_steps

SWEEP = np.linspace(-1.55, 1.65, 20)


@pytest.mark.parametrize("digits", [3, 4])
def test_a_rounded_sweep_has_the_uncertainty_of_its_last_digit(digits):
    angles = np.deg2rad(np.repeat(np.round(SWEEP, digits), 5))
    assert np.rad2deg(rounding_std(angles)) == pytest.approx(10.0**-digits / np.sqrt(12), rel=0.02)


@pytest.mark.parametrize("angles", [SWEEP, np.arange(-5, 5) * 0.5, np.full(20, 0.3), np.arange(3)])
def test_a_sweep_in_equal_steps_is_not_rounded(angles):
    assert rounding_std(np.deg2rad(angles)) == 0


def test_angles_that_are_unknown_have_no_lattice():
    assert rounding_std(np.full(20, np.nan)) == 0


def test_points_of_a_rounded_angle_become_independent():
    """Variance of each direction as the covariance of noise and rounding says: one."""
    rng = np.random.default_rng(4)
    degrees = np.repeat(np.round(SWEEP, 3), 8)
    angles, by_angle = np.deg2rad(degrees), 4e4 + 1e4 * rng.random(len(degrees))
    sigma = np.full(len(degrees), 0.05)
    spread = rounding_std(angles)
    label = np.unique(angles, return_inverse=True)[1]
    steps = rounding_steps(angles, by_angle, sigma, [])
    shared = spread * by_angle * (label[:, None] == np.arange(20)).T  # (20, n)
    whole = np.diag(sigma**2) + shared.T @ shared
    white = decorrelated(steps, np.eye(len(sigma))) / sigma
    assert white.T @ whole @ white == pytest.approx(np.eye(len(sigma)), abs=1e-9)
