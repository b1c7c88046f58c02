"""Circles in profiles of a ball: few points, long and short arcs, noisy ends."""

import numpy as np
import pytest

from sensors.hand_eye.circles import find_circles

RADIUS, SIGMA = 15.0, 0.02


def profiles(points, count=30, ragged=0.0, seed=4):
    """(2, n) mm and labels (n,) of sections of a ball at equal steps of x; `ragged` mm: more noise of the outer fifths."""
    rng = np.random.default_rng(seed)
    flat, label = [], []
    for k in range(count):
        radius = RADIUS * np.cos(np.arcsin(rng.uniform(-0.6, 0.6)))
        x = np.linspace(-0.8, 0.8, points) * radius
        noise = rng.normal(0, SIGMA, points)
        outer = np.abs(x) > 0.8 * 0.8 * radius
        noise += ragged * outer * rng.normal(0, 1, points)
        flat.append([x + 3.0, 150.0 - np.sqrt(radius**2 - x**2) + noise])
        label.append(np.full(points, k))
    return np.concatenate(flat, axis=1), np.concatenate(label)


@pytest.mark.parametrize("points", [25, 50, 77, 120, 300])
def test_points_of_a_clean_arc_are_used_however_few_they_are(points):
    flat, label = profiles(points)
    circles = find_circles(flat, label, [f"profile {k}" for k in range(30)], RADIUS * 1.1)
    assert circles.used.mean() > 0.97
    np.testing.assert_allclose(circles.centre[0], 3.0, atol=6 * SIGMA)
    assert (circles.radius < RADIUS + 6 * SIGMA).all()


def test_noisy_ends_are_left_out():
    flat, label = profiles(100, ragged=0.15)
    circles = find_circles(flat, label, [f"profile {k}" for k in range(30)], RADIUS * 1.1)
    x = np.abs(flat[0] - 3.0)
    middle, ends = x < 6.0, x > 0.75 * RADIUS
    assert circles.used[middle].mean() > 0.97
    assert circles.used[ends].mean() < 0.3
