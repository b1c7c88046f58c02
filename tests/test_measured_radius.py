"""The standard deviation of a measured radius of a ball includes the errors of hand-eye transform and flange poses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from datasets.samples.columns import FLANGE
from sensors.ball.fit import compared_with, fit_ball, with_radius_variance
from sensors.scanner.motion import Motion
from workbench.core.rigid import rotation_matrix, transform
from workbench.jobs.sensor import hand_eye, surface_scan

RADIUS = 15.0
BALL = np.array([500.0, 50.0, 20.0])
HAND_EYE = transform(rotation_matrix(np.array([0.1, -0.2, 1.2])), np.array([15.0, -30.0, 80.0]))
POSES = 30


def _silent(text: str) -> None:
    return None


def _profiles(seed: int) -> Recording:
    """Profiles of a ball, at flange poses whose positions err by 0.05 mm."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(-1.0, 1.0, 60)
    rows, points = [], []
    for _ in range(POSES):
        centre = [rng.uniform(-20, 20), rng.uniform(-0.6, 0.6) * RADIUS, rng.uniform(150, 210)]
        section = np.sqrt(RADIUS**2 - centre[1] ** 2) + rng.normal(0, 0.01, len(angle))
        profile = np.stack(
            [centre[0] + section * np.sin(angle), 0 * angle, centre[2] - section * np.cos(angle)], 1
        )
        roll, pitch, yaw = rng.uniform(-0.5, 0.5, 2).tolist() + [rng.uniform(-2, 2)]
        sensor = Rotation.from_euler("xyz", [np.pi + roll, pitch, yaw]).as_matrix()
        flange = sensor @ HAND_EYE[:3, :3].T
        origin = BALL - sensor @ centre - flange @ HAND_EYE[:3, 3] + rng.normal(0, 0.05, 3)
        x, y, z, w = Rotation.from_matrix(flange).as_quat()
        rows += [[*origin, w, x, y, z]] * len(angle)
        points.append(profile)
    x, y, z = np.concatenate(points).T
    count = len(x)
    columns = {
        "sample": np.arange(1.0, count + 1),
        "pose": np.repeat(np.arange(1.0, POSES + 1), count // POSES),
        "ball": np.ones(count),
        **{"x_mm": x, "y_mm": y, "z_mm": z},
        **dict(zip(FLANGE, np.array(rows).T)),
    }
    return Recording("ball-surface", columns, None, balls={1: (0, 0, 0, RADIUS)}, name="profiles")


def test_radius_of_joined_profiles_is_that_of_their_own_hand_eye(tmp_path):
    recording = _profiles(3)
    free = hand_eye.calibrate(recording, None, None, _silent).free
    (ball,) = surface_scan.join_surface(recording, None, tmp_path, _silent).scans[0].balls
    assert ball.free.radius == pytest.approx(free.radius)
    assert ball.free.std[3] == pytest.approx(free.std["target.radius"])
    assert abs(ball.free.radius - RADIUS) < 3 * ball.free.std[3]
    assert ball.fit.radius == RADIUS and np.isfinite(ball.fit.radius_gap)


def test_common_errors_of_a_motion_are_in_the_variance_of_a_radius():
    """The spread of radii fitted under drawn common errors agrees with the variance that is stated."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(3, 300))
    normals = -np.abs(normals / np.linalg.norm(normals, axis=0))
    points, image = RADIUS * normals, np.arange(300) % 10
    twists = np.zeros((10, 2, 6))
    twists[:, :, :3] = rng.normal(0, 1, (10, 2, 3))
    covariance = np.array([[4e-6, 1e-6], [1e-6, 9e-6]])
    none = np.zeros((10, 1, 6))
    poses = np.broadcast_to(np.eye(4), (10, 4, 4))
    motion = Motion("base", poses, twists, covariance, none, np.zeros((1, 1)))
    stated = motion.common_of_radius(points, image, normals)
    drawn = rng.multivariate_normal([0, 0], covariance, 200)
    moves = np.einsum("npk->pkn", twists[image][:, :, :3])
    moved = (points + np.tensordot(size, moves, 1) for size in drawn)
    radii = [fit_ball(place, sigma=0.01, loss="linear").radius for place in moved]
    assert np.var(radii) == pytest.approx(stated, rel=0.3)


def test_a_radius_is_compared_again_with_its_whole_variance():
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(3, 400))
    points = 15.02 * normals / np.linalg.norm(normals, axis=0) + rng.normal(0, 0.01, (3, 400))
    fit = fit_ball(points, sigma=0.01, radius=RADIUS)
    assert fit.radius_gap > 4 and any("radius differs" in text for text in fit.warnings)
    wider = with_radius_variance(fit, 0.02**2)
    assert wider.radius_gap < 2 and not wider.warnings and "radius differs" not in wider.outcome
    far = compared_with(wider, replace(fit.free, radius=15.5))
    assert any("15.5000" in text for text in far.warnings) and "15.5000" in far.outcome
