"""Steps of the fit of a ball with errors that stripes share, where few stripes hardly determine a direction."""

import numpy as np
import pytest

from sensors.ball import shared as shared_fit
from sensors.ball.fit import fit_ball
from sensors.ball.shared import Shared

RADIUS, CENTRE = 19.0, np.array([0.0, 0.0, 230.0])


def two_stripes(seed):
    """Points (3, 100) of two stripes on a ball, and the errors of their light planes, shift and tilt."""
    rng = np.random.default_rng(seed)
    x, y = np.repeat([-4.0, 3.0], 50), np.tile(np.linspace(-12, 12, 50), 2)
    points = np.stack([x, y, CENTRE[2] - np.sqrt(RADIUS**2 - x**2 - y**2)])
    along = np.tile(np.array([[0.0], [0.0], [-1.0]]), 100)
    derivative = np.stack([along, along * y / 12])
    covariance = np.diag(np.tile([0.03, 0.01], 2) ** 2.0)
    shared = Shared(np.repeat([0, 1], 50), derivative, covariance)
    return points + along * rng.normal(0, 0.015, 100), along, shared


@pytest.mark.parametrize("length", [6.0, 60.0])
def test_a_step_beyond_the_linear_range_is_halved_and_loses_no_points(monkeypatch, length):
    """A redescending loss would give all points the weight 0 after it, and nothing would bring them back."""
    points, along, shared = two_stripes(3)
    options = {"direction": along, "shared": shared, "compare": False}
    expected = fit_ball(points, 0.015, RADIUS, **options)
    steps = []
    right_step = shared_fit._move

    def with_one_long_step(normal, covariance):
        steps.append(right_step(normal, covariance))
        long = np.array([length, 0.0, length])[: len(steps[-1])]
        return steps[-1] + long if len(steps) == 10 else steps[-1]

    monkeypatch.setattr(shared_fit, "_move", with_one_long_step)
    monkeypatch.setattr(shared_fit, "_SETTLE", 2)
    monkeypatch.setattr(shared_fit, "_CONVERGED_STEP", 0.0)
    fit = fit_ball(points, 0.015, RADIUS, **options)
    assert len(steps) > 10
    np.testing.assert_allclose(fit.centre, expected.centre, atol=1e-3)
    np.testing.assert_allclose(fit.std, expected.std, rtol=0.05)
