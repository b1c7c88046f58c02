"""Simulated stripe points on balls, for scanners that move: no images, exact planes, noise along the scan line."""

from dataclasses import dataclass

import numpy as np

from sensors.camera.model import Camera
from sensors.scanner.cloud import Cloud
from sensors.scanner.model import Scanner
from sensors.scanner.motion import Motion

SIGMA_PX = 0.08
CAMERA = Camera.of([750.0, 749.3, 241.4, 188.2, -0.15, 0.1, 0.0004, -0.0006, 0.0], (480, 384))
PLANE = np.array([125.0, 0.0, 69.0, -69.0 * 125.0]) / np.hypot(125.0, 69.0)
SCANNER = Scanner(CAMERA, np.array([0]), PLANE[:, None], sigma_px=SIGMA_PX)
_ROWS = 384
_OUTERMOST = 0.85  # radii from the middle of a ball beyond which a plane only grazes it
_LEAST_COSINE = 0.55  # of the angle of view
_FEWEST_POINTS = 8


@dataclass(frozen=True)
class Truth:
    """True pixels (2, n) of a ball in the images `image` (n,), and the ball."""

    pixels: np.ndarray
    image: np.ndarray
    centre: np.ndarray
    radius: float


def stripe_on_ball(plane: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Pixels (2, n) of the line in which a light plane (4,) cuts a ball (3,), mm in the camera frame, one a row.

    No pixels where the plane misses the ball, or nearly.
    """
    normal, offset = plane[:3], plane[3]
    away = normal @ centre + offset
    if abs(away) > _OUTERMOST * radius:
        return np.zeros((2, 0))
    along = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    along /= np.linalg.norm(along)
    middle = centre - away * normal
    side = np.cross(normal, along)
    toward = side if side @ middle < 0 else -side
    angle = np.linspace(-1.0, 1.0, 4 * _ROWS)
    circle = np.sqrt(radius**2 - away**2)
    arc = np.outer(along, np.sin(angle)) + np.outer(toward, np.cos(angle))
    points = middle[:, None] + circle * arc
    outward = (points - centre[:, None]) / radius
    facing = -(outward * points).sum(0) / np.linalg.norm(points, axis=0)
    projected = CAMERA.project(points[:, facing > _LEAST_COSINE])
    if projected.shape[1] < _FEWEST_POINTS:
        return np.zeros((2, 0))
    order = np.argsort(projected[1])
    rows = np.arange(np.ceil(projected[1].min()), np.floor(projected[1].max()))
    return np.stack([np.interp(rows, projected[1][order], projected[0][order]), rows])


def stripes_on_ball(planes, centres, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (2, n) of the stripes of pairs of a light plane (4,) and a centre (3,), and the number (n,) of the pair."""
    stripes = [stripe_on_ball(*pair, radius) for pair in zip(planes, centres)]
    counts = [stripe.shape[1] for stripe in stripes]
    return np.concatenate(stripes, 1), np.repeat(np.arange(len(stripes)), counts)


def seen_stripes(motion: Motion, centre: np.ndarray, radius: float) -> Truth:
    """Where the fixed plane cuts a ball (3,), mm in the frame of the motion, one point a row of each image."""
    centres = [motion.local(centre, k) for k in range(len(motion.poses))]
    pixels, image = stripes_on_ball([PLANE] * len(centres), centres, radius)
    return Truth(pixels, image, centre, radius)


def cloud_of(truth: Truth, motion: Motion, noise: np.ndarray) -> Cloud:
    """What is reconstructed of the stripes with noise (n,) px along the scan line."""
    pixels = truth.pixels + np.stack([noise, 0 * noise])
    steps = np.zeros(pixels.shape[1], int)
    local = SCANNER.reconstruct(pixels, steps)
    return Cloud(SCANNER, local, pixels, steps, truth.image, motion)


def bound(cloud: Cloud, truth: Truth) -> np.ndarray:
    """(3, 3) mm^2 Cramer-Rao bound of the centre of a ball of known radius.

    Noise of one px along the scan line moves a point by `error`; its distance from the ball errs by n.error.
    """
    outward = (cloud.points - truth.centre[:, None]) / truth.radius
    gain = (outward * cloud.error).sum(0)
    rows = outward / (SIGMA_PX * gain)
    return np.linalg.inv(rows @ rows.T)
