"""Stripes on boards with known truth: a simulated copy of Ye's instrument at the level of pixels.

Made forwards, from the point on the bowed board to the pixel; the stripe chain goes backwards.
"""

from dataclasses import dataclass

import numpy as np

from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from sensors.light.board_stripes import BoardStripes
from sensors.light.mirror import Mirror
from sensors.scanner.errors import laid_over
from sensors.state import SensorState
from workbench.core.rigid import rotation_matrix

CAMERA = Camera.of([3421.0, 3419.0, 645.0, 507.0, -0.11, 0.23, 4e-4, -3e-4, 0.0], (1280, 1024))
COLUMNS, ROWS, SQUARE = 11, 8, 4.0
BOW = np.array([0.05, -0.03, 0.02])
SWEEP = np.deg2rad(10)  # of the mirror: 20 degrees of the beam
STEPS, PLACEMENTS = 120, 20
MIDDLE = SQUARE * np.array([COLUMNS - 1, ROWS - 1]) / 2
HALF_DIAGONAL = float(np.hypot(*MIDDLE))


@dataclass(frozen=True)
class SimulatedScanner:
    """Truth and what was measured of it: corners (2, G K) and stripe points with their labels."""

    camera: Camera
    mirror: Mirror
    angles: np.ndarray
    planes: np.ndarray
    poses: np.ndarray
    board: np.ndarray
    corners: np.ndarray
    stripes: np.ndarray
    placement: np.ndarray
    step: np.ndarray


def mirror(offset=0.0):
    """Mirror 69 mm left of the camera whose axis is nearly the image's vertical, its light plane through z = 125 mm."""
    axis = np.array([0.004, 1.0, -0.003])
    axis /= np.linalg.norm(axis)
    out = np.deg2rad(29)
    light_plane = np.array([np.cos(out), 0.002, -np.sin(out)])  # normal of the plane in mid-sweep
    light_plane /= np.linalg.norm(light_plane)
    face = rotation_matrix(axis * np.deg2rad(-45)) @ (light_plane - (light_plane @ axis) * axis)
    face /= np.linalg.norm(face)
    point = np.array([-69.0, 1.0, 2.0])
    beam = light_plane - 2 * (light_plane @ face) * face
    return Mirror(axis, point, face, offset, np.append(beam, 0.1 - beam @ point))


def wobbled(planes, angles, values):
    """(4, S) planes of a mirror that wobbles by its law, made units again."""
    n, nothing = len(angles), np.full(len(angles), np.nan)
    where = np.stack([nothing] * 3)
    state = SensorState(
        CAMERA, where[:2], where, planes, angles, where[:2], where, np.zeros(n, int), {}, where
    )
    made = planes + CATALOGUE["mirror-wobble"]("mirror").delta(np.asarray(values, float), state)
    return made / np.linalg.norm(made[:3], axis=0)


def bow(x, y, amounts=BOW):
    """Height (mm) of the bowed board at x, y (mm), board frame."""
    u, v = (x - MIDDLE[0]) / HALF_DIAGONAL, (y - MIDDLE[1]) / HALF_DIAGONAL
    return amounts[0] * u * u + amounts[1] * v * v + amounts[2] * u * v


def poses(rng, count):
    """(G, 6) boards that face the camera within 25 degrees, 115 to 135 mm away."""
    turns = np.stack(
        [
            rng.uniform(-0.45, 0.45, count),
            rng.uniform(-0.45, 0.45, count),
            rng.uniform(-0.2, 0.2, count),
        ],
        1,
    )
    middle = np.stack([*rng.uniform(-4, 4, (2, count)), np.linspace(116, 134, count)], 1)
    return np.hstack(
        [middle - np.einsum("gij,j->gi", rotation_matrix(turns), np.append(MIDDLE, 0)), turns]
    )


def stripe_points(pose, plane, points, amounts=BOW):
    """(3, k) board frame, on the bowed board and in the light plane (4,), at equal distances down the board."""
    turn = rotation_matrix(pose[3:])
    normal, offset = turn.T @ plane[:3], plane[:3] @ pose[:3] + plane[3]
    y = np.linspace(-SQUARE, ROWS * SQUARE, points)
    x = -(normal[1] * y + offset) / normal[0]
    for _ in range(20):
        x = -(normal[1] * y + normal[2] * bow(x, y, amounts) + offset) / normal[0]
    inside = (x > -SQUARE) & (x < COLUMNS * SQUARE)
    return np.stack([x, y, bow(x, y, amounts)])[:, inside]


def seen(camera, pose, points):
    """(2, k) px of board points, and whether they are in the image."""
    pixels = camera.project(rotation_matrix(pose[3:]) @ points + pose[:3, None])
    return pixels, ((pixels > 5) & (pixels < np.array(camera.size)[:, None] - 6)).all(0)


def simulated_scanner(
    rng,
    placements=PLACEMENTS,
    steps=STEPS,
    points=300,
    stripe=0.1,
    corner=0.06,
    wobble=None,
    shake=0.0,
    offset=0.0,
    sweep=SWEEP,
):
    """A simulated scanner with noise of `stripe` px along the image's rows and `corner` px; wobble: (8,) of mirror-wobble.

    shake: mm by which bearings move the planes, once in 4 degrees of the mirror.
    """
    instrument, angles = (
        mirror(offset),
        np.linspace(-sweep / 2, sweep / 2, steps) if steps > 1 else np.zeros(1),
    )
    planes = instrument.planes(angles)
    if wobble is not None:
        planes = wobbled(planes, angles, wobble)
    planes[3] += shake * np.sin(2 * np.pi * angles / np.deg2rad(4))
    boards = poses(rng, placements)
    x, y = (SQUARE * a.ravel() for a in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)))
    board, pixels, labels = np.stack([x, y, 0 * x]), [], []
    real = np.stack([x, y, bow(x, y)])
    corners = np.hstack([seen(CAMERA, pose, real)[0] for pose in boards])
    for g, pose in enumerate(boards):
        for s in range(steps):
            found, inside = seen(CAMERA, pose, stripe_points(pose, planes[:, s], points))
            pixels.append(found[:, inside])
            labels.append(np.array([[g], [s]]) + np.zeros((2, inside.sum()), int))
    stripes, (placement, step) = np.hstack(pixels), np.hstack(labels)
    stripes[0] += stripe * rng.normal(size=stripes.shape[1])
    corners += corner * rng.normal(size=corners.shape)
    return SimulatedScanner(
        CAMERA, instrument, angles, planes, boards, board, corners, stripes, placement, step
    )


def views(truth, sigma=0.06):
    """What `boards.detect` would have given of the board images."""
    count = truth.board.shape[1]
    return [
        View(
            f"b{g}.png",
            f"p{g:02d}",
            np.arange(count),
            part,
            truth.camera.size,
            np.full(count, sigma),
        )
        for g, part in enumerate(np.split(truth.corners, len(truth.poses), axis=1))
    ]


def board():
    return Board("chessboard", COLUMNS, ROWS, SQUARE)


def board_stripes(truth, sigma=0.1, angles=True):
    names = np.array([f"p{g:02d}" for g in range(len(truth.poses))])
    return BoardStripes(
        truth.stripes,
        names[truth.placement],
        truth.step,
        np.full(truth.stripes.shape[1], sigma),
        mirror=truth.angles[truth.step] if angles else None,
    )


def aligned(truth, camera, planes, near=115.0, far=135.0, steps=slice(None)):
    """RMS (mm) over the working volume of found planes from the true ones and of found points from the true ones.

    After the rigid motion of the found camera frame that fits the points best: where a camera's own
    frame stands is a convention that nothing measured with the scanner depends on.
    """
    _, _, distance, error = laid_over(
        truth.camera, truth.planes[:, steps], camera, planes, (near, far)
    )
    return np.sqrt((distance**2).mean()), np.sqrt((error**2).sum(0).mean())
