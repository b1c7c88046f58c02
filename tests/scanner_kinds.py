"""Simulated points on balls, for scanners that move or are moved: no images, exact planes, noise along the scan line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.ball.result import BallFit
from sensors.camera.model import Camera
from sensors.scanner.cloud import Cloud
from sensors.scanner.model import Scanner
from sensors.scanner.motion import Motion
from workbench.files.images.flange import flange_poses
from workbench.jobs.sensor import surface_scan
from workbench.jobs.sensor.joined_scans import KnownHandEye, moved_by_robot
from workbench.recordings.templates.scanner_kinds import HAND_EYE, example

SIGMA_PX = 0.08
CAMERA = Camera.of([750.0, 749.3, 241.4, 188.2, -0.15, 0.1, 0.0004, -0.0006, 0.0], (480, 384))
PLANE = np.array([125.0, 0.0, 69.0, -69.0 * 125.0]) / np.hypot(125.0, 69.0)
SCANNER = Scanner(CAMERA, np.array([0]), PLANE[:, None], sigma_px=SIGMA_PX)
POSE_SIGMA, PROFILE_SIGMA, DEPTH_SIGMA = 0.02, 0.006, 0.03
"""Of flange positions, of points of a profiler and of a 3-D camera in the templates, mm."""
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


@dataclass(frozen=True)
class JoinedBall:
    """The ball of a template's recording: `fit`, its true centre `truth` (3,), the bound `least` (3, 3) mm^2, and the
    fit with a `free` radius."""

    recording: Recording
    fit: BallFit
    truth: np.ndarray
    least: np.ndarray
    free: BallFit


def joined_ball(kind: str, folder: Path, seed: int) -> JoinedBall:
    """Points of a "profiler" or a "3d-camera", joined by flange pose, and the ball in them."""
    made = example(kind, folder, lambda text: None, seed)
    recording, truth = made.recording, made.balls[1]
    pose = np.unique(recording.poses, return_inverse=True)[1]
    first = np.unique(pose, return_index=True)[1]
    known = KnownHandEye(HAND_EYE, np.zeros((6, 6)), POSE_SIGMA)
    motion = moved_by_robot(flange_poses(recording)[first], known)
    points = motion.points(recording.points.T, pose)
    (ball,), _ = surface_scan._balls(recording, motion, points, pose, None)
    least = joined_bound(kind, motion, points, pose, truth)
    free = surface_scan._fit(motion, points, pose, None)
    return JoinedBall(recording, ball.fit, truth, least, free)


def joined_bound(kind, motion, points, pose, centre) -> np.ndarray:
    """(3, 3) mm^2: points with noise along the surface normal (profiler) or the line of sight, poses with a shift."""
    information = np.zeros((3, 3))
    for number in np.unique(pose):
        outward = points[:, pose == number] - centre[:, None]
        outward = outward / np.linalg.norm(outward, axis=0)
        sigma = np.full(outward.shape[1], PROFILE_SIGMA)
        if kind == "3d-camera":
            sight = points[:, pose == number] - motion.poses[number, :3, 3][:, None]
            cosine = (outward * sight).sum(0) / np.linalg.norm(sight, axis=0)
            sigma = DEPTH_SIGMA * np.abs(cosine)
        rows = (outward / sigma).T
        one = rows.T @ rows
        information += one @ np.linalg.inv(np.eye(3) + POSE_SIGMA**2 * one)
    return np.linalg.inv(information)
