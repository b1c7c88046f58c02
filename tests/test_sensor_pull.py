"""Uncertainty of the pull of a ball's curvature on its stripes, and what it adds to the covariance of the ball."""

from dataclasses import replace

import numpy as np
import pytest

from sensors.ball.fit import fit_ball
from sensors.ball.shared import Shared
from sensors.stripe.surface_bias.centre_bias import estimate_centre_bias
from sensors.stripe.surface_bias.surface_line import LineShape
from test_sensor_line_shape import RADIUS, TRUE, light_planes, measured


@pytest.fixture(scope="module")
def seen():
    """A ball under three light planes."""
    rng = np.random.default_rng(7)
    centre = np.array([1.0, -2.0, 260.0])
    _, bend, shape, _ = measured(
        centre, light_planes(3, RADIUS * 0.5, centre[2] - 0.8 * RADIUS), rng
    )
    return bend, shape


def test_a_line_that_is_known_is_kept_to_where_few_widths_do_not_distinguish(seen):
    """A short piece of one stripe: slopes are alike, so that light plane and blur are confounded."""
    bend, shape = seen
    few = replace(bend, facing=np.where(np.arange(len(bend.slope)) < 30, bend.facing, 0.0))
    line, covariance = few.fitted_line(shape[0], TRUE)
    assert line.plane_width_mm == pytest.approx(TRUE.plane_width_mm, rel=0.1)
    assert line.blur_px == pytest.approx(TRUE.blur_px, rel=0.1)
    alone, uncertain = few.fitted_line(shape[0])
    assert (np.diag(covariance) < np.diag(uncertain)).all()
    none = replace(bend, facing=0 * bend.facing)
    assert none.fitted_line(shape[0], TRUE)[0] == TRUE
    assert none.fitted_line(shape[0])[0] == LineShape(0.0, 0.0)


def test_many_widths_outweigh_a_line_that_is_known_wrongly(seen):
    bend, shape = seen
    wrong = LineShape(1.15 * TRUE.plane_width_mm, 0.9 * TRUE.blur_px)
    line, _ = bend.fitted_line(shape[0], wrong)
    assert line.plane_width_mm == pytest.approx(TRUE.plane_width_mm, rel=0.05)


def test_derivative_of_the_pull_is_that_of_its_size(seen):
    bend, shape = seen
    pull = estimate_centre_bias(bend, shape, TRUE)
    wider = estimate_centre_bias(bend, shape, None)
    assert pull.derivative.shape == (5, len(bend.slope))
    assert np.isfinite(pull.derivative).all()
    assert np.linalg.eigvalsh(pull.covariance).min() >= 0
    plane = np.sqrt(TRUE.plane_width_mm**2 + 1e-4)
    moved = np.nan_to_num(
        pull.bend.centre_bias(LineShape(plane, TRUE.blur_px), *shape[:2])
        - pull.bend.centre_bias(TRUE, *shape[:2])
    )
    usual = np.abs(moved) < np.quantile(np.abs(moved), 0.9)
    assert 1e-4 * pull.derivative[0, usual] == pytest.approx(moved[usual], rel=0.1, abs=2e-5)
    assert np.median(np.abs(wider.size - pull.size)) < 0.002


def test_an_error_that_all_groups_share_is_in_the_covariance():
    """What the ball moves by, squared; of two such errors the sum."""
    rng = np.random.default_rng(3)
    outward = rng.normal(size=(3, 600)) * np.array([[0.4], [0.4], [1.0]])
    outward[2] = -np.abs(outward[2])
    outward /= np.linalg.norm(outward, axis=0)
    points = 20 * outward + np.array([[3.0], [1.0], [200.0]]) + 0.01 * rng.normal(size=(3, 600))
    shared = Shared(np.arange(600) % 6, np.zeros((1, 3, 600)), np.zeros((6, 6)))
    moves = outward * np.array([np.cos(3 * outward[0]), outward[1]])[:, None]
    std = np.array([0.05, 0.08])
    both = shared.with_common(moves[:1], np.diag(std[:1] ** 2))
    both = both.with_common(moves[1:], np.diag(std[1:] ** 2))
    plain, made = (
        fit_ball(points, 0.01, 20.0, shared=one, loss="linear") for one in (shared, both)
    )
    expected = plain.covariance[:3, :3].copy()
    for move, size in zip(moves, std):
        moved = fit_ball(points + 0.01 * move, 0.01, 20.0, shared=shared, loss="linear")
        away = (moved.centre - plain.centre) / 0.01 * size
        expected += np.outer(away, away)
    assert made.centre == pytest.approx(plain.centre, abs=1e-6)
    assert made.covariance[:3, :3] == pytest.approx(expected, rel=0.05, abs=5e-6)
