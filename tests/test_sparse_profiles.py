"""Circles of profiles with few points: their arcs stay whole, and an end that is noisier than the middle is cut."""

import numpy as np
import pytest

from sensors.hand_eye.circles import find_circles


def arcs(points, rng, profiles=10, noise=0.02, end_noise=0.02):
    """flat (2, n) mm and label (n,) of arcs of 18 mm radius; end_noise: of the last tenth of each."""
    angle = np.linspace(-1.1, 1.1, points)
    sigma = np.where(np.arange(points) < 0.9 * points, noise, end_noise)
    radius = 18.0 + sigma * rng.standard_normal((profiles, points))
    flat = np.stack([radius * np.sin(angle), 160 - radius * np.cos(angle)])
    return flat.reshape(2, -1), np.repeat(np.arange(profiles), points)


def used_share(flat, label):
    names = [f"profile {k + 1}" for k in range(label.max() + 1)]
    circles = find_circles(flat, label, names, largest=22.0)
    return np.bincount(label, circles.used) / np.bincount(label)


@pytest.mark.parametrize("points", [40, 80, 300])
def test_an_arc_of_few_points_stays_whole(points):
    assert used_share(*arcs(points, np.random.default_rng(points))).min() > 0.85


def test_a_noisy_end_is_cut():
    flat, label = arcs(120, np.random.default_rng(5), end_noise=0.3)
    assert np.median(used_share(flat, label)) < 0.95


@pytest.mark.parametrize("seed", range(3))
def test_points_at_uneven_distances_with_a_background_keep_their_circle(seed):
    """The noise comes from neighbours in x: at uneven distances their second difference is mostly slope."""
    rng = np.random.default_rng(seed)
    profiles, label = [], []
    for k in range(6):
        radius = rng.uniform(8, 20)
        on_ball = rng.uniform(-0.9, 0.9, rng.integers(25, 40)) * radius
        background = rng.uniform(1.0, 2.5, 15) * radius
        x = np.concatenate([on_ball, background])
        z = np.concatenate([150 - np.sqrt(radius**2 - on_ball**2), 152 + 0.1 * background])
        profiles.append(np.stack([x, z]) + rng.normal(0, 0.003, (2, len(x))))
        label += [k] * len(x)
    names = [f"profile {k}" for k in range(6)]
    found = find_circles(np.concatenate(profiles, axis=1), np.array(label), names)
    assert (found.rms < 0.006).all()
    assert found.used.mean() > 0.6
