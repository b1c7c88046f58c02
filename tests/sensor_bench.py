"""A small scanner, a board and what measures rendered light, for the tests of rendering."""

from dataclasses import replace

import cv2
import numpy as np

from sensors.boards.board import Board
from sensors.camera.model import Camera
from sensors.rendering.instrument import Instrument, Laser, sweeping_mirror
from sensors.rendering.patterns import Pattern
from sensors.rendering.ports import Moment
from sensors.rendering.surfaces import BoardSurface

CAMERA = Camera(1000.0, 998.0, 162.0, 125.0, (-0.3, 0.4, 0.002, -0.003, 0.5), (320, 256))
MILD = Camera(2000.0, 1996.0, 324.0, 250.0, (-0.16, 0.2, 0.001, -0.0015, 0.0), (640, 512))
BOARD = Board("chessboard", 6, 4, 4.0)
PLAIN = Pattern(BOARD, white=0.8, dark=0.8, margin=12.0)
HERE, STILL = np.zeros(6), Moment()
POSE = np.array([-10.0, -6.0, 124.0, 0.2, -0.15, 0.1])
MIRROR, SOURCE = sweeping_mirror(69.0, 125.0, 2.0, 60.0, (0.2, -0.3))


def instrument(steps=(-1.0, 0.5), **changes) -> Instrument:
    """A small scanner without speckle; steps: mirror angles in degrees."""
    angles = np.deg2rad(np.array(steps))
    made = Instrument(
        CAMERA,
        np.arange(len(angles)),
        angles,
        MIRROR,
        laser=Laser(width_mm=0.15, source=SOURCE, contrast=0.0),
    )
    return replace(made, **changes)


def board(pattern=PLAIN, pose=POSE, moment=STILL) -> BoardSurface:
    return BoardSurface(pattern, pose, CAMERA, moment)


def opencv(points, pose=HERE, camera=CAMERA) -> np.ndarray:
    """(2, n) px by cv2.projectPoints."""
    return cv2.projectPoints(
        points.T.copy(), pose[3:], pose[:3], camera.matrix, np.array(camera.distortion)
    )[0][:, 0].T


def centroids(light, least=0.5) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n,) with a whole stripe, and its centre of gravity (n,) in px along the row."""
    total = light.sum(1, dtype=float)
    inner = light[:, :8].max(1) + light[:, -8:].max(1) < 1e-3 * light.max()  # not cut by the border
    rows = np.flatnonzero((total > least * total.max()) & inner)
    return rows, (light[rows] * np.arange(light.shape[1])).sum(1) / total[rows]


def refined(light, start):
    """(2, n) px, corners by OpenCV from a start."""
    image = (light / light.max() * 250).astype(np.float32)
    corners = start.T.astype(np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(image, corners, (8, 8), (-1, -1), (3, 100, 1e-4))[:, 0].T
