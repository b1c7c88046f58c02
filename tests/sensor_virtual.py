"""A scanner's measurements without images, for the tests of its diagnosis: corners, stripes on boards and on balls."""

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.boards.board import Board
from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from sensors.light.ball_stripes import Balls
from sensors.light.board_chain import BoardStripeChain
from sensors.rendering.instrument import sweeping_mirror
from sensors.rendering.places import board_poses
from sensors.rendering.scene import BoardKeys, Views
from workbench.core.rigid import rotation_matrix
from workbench.jobs.sensor.chains import Chains

CAMERA = Camera(560.0, 559.0, 322.0, 253.0, (-0.08, 0.03, 3e-4, -4e-4, 0.0), (640, 512))
KEYS = BoardKeys(columns=11, rows=8, square_mm=8.0)
RADII = np.array([10.0, 13.0, 16.0])
PLATE = np.array([[0.0, 36.0, -38.0], [0.0, 6.0, -8.0], [0.0, -4.0, 5.0]])


def chains(
    seed: int = 1,
    boards: int = 12,
    steps: int = 15,
    sweep_deg: float = 12.0,
    scans: int = 6,
    corner_px: float = 0.01,
    stripe_px: float = 0.03,
) -> Chains:
    """Exact measurements of a flawless scanner with a mirror, and the noise that they would have."""
    rng = np.random.default_rng(seed)
    board = Board.of(KEYS.recorded)
    poses = board_poses(
        Views(count=boards, range_mm=(100.0, 155.0), tilt_deg=35.0, aside=0.35),
        KEYS.pattern,
        CAMERA,
        rng,
    )
    mirror, _ = sweeping_mirror(69.0, 125.0, 2.0, 60.0, (0.3, -0.2))
    angles = np.deg2rad(np.linspace(-sweep_deg, sweep_deg, steps))
    planes = mirror.planes(angles)
    board_stripes = _stripes(board, poses, mirror, angles, planes, stripe_px, rng)
    return Chains(
        _corners(board, poses, corner_px),
        board_stripes,
        _balls(mirror, angles, planes, scans, stripe_px, rng),
        tuple(map(str, range(boards))),
        tuple(map(str, range(scans))),
    )


def _corners(board, poses, sigma):
    points = np.tile(board.points, len(poses))
    group = np.repeat(np.arange(len(poses)), board.count)
    seen = (
        np.einsum("nij,jn->in", rotation_matrix(poses[:, 3:])[group], points) + poses[group, :3].T
    )
    place = (points - board.middle[:, None])[:2] / board.half_diagonal
    labels = {
        "placement": group,
        "view": group,
        "corner": np.tile(np.arange(board.count), len(poses)),
    }
    time = {"time_s": 60.0 * group}
    return Corners(
        CAMERA,
        points,
        place,
        CAMERA.project(seen),
        labels,
        poses,
        np.full((2, len(group)), sigma),
        covariates=time,
    )


def _stripes(board, poses, mirror, angles, planes, sigma, rng):
    """Where planes cut boards, at 14 places of each stripe."""
    found = []
    for k, pose in enumerate(poses):
        turn = rotation_matrix(pose[3:])
        for step, plane in enumerate(planes.T):
            line = np.array(
                [*(turn.T @ plane[:3])[:2], plane[:3] @ pose[:3] + plane[3]]
            )  # a x + b y + c = 0 on the board
            y = np.linspace(-board.square_mm, board.rows * board.square_mm, 14)
            x = -(line[1] * y + line[2]) / line[0]
            on = (x > -board.square_mm) & (x < board.columns * board.square_mm)
            points = turn @ np.stack([x, y, 0 * x])[:, on] + pose[:3, None]
            found.append((CAMERA.project(points), np.full(on.sum(), k), np.full(on.sum(), step)))
    pixels, group, step = (np.concatenate([one[k] for one in found], axis=-1) for k in range(3))
    inside = ((pixels > 0) & (pixels < np.array([[640.0], [512.0]]))).all(0)
    pixels, group, step = pixels[:, inside], group[inside], step[inside]
    return BoardStripeChain(
        CAMERA,
        pixels,
        {"placement": group, "step": step},
        poses,
        planes,
        board.middle[:2],
        board.half_diagonal,
        np.array([[1.0], [0.0]]),
        np.full((1, len(step)), sigma),
        mirror,
        angles,
        covariates=_swept(group, step, rng),
    )


def _balls(mirror, angles, planes, scans, sigma, rng):
    found, centres = [], []
    for scan in range(scans):
        turn = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)).as_matrix()
        middle = np.array([rng.uniform(-10, 10), rng.uniform(-8, 8), rng.uniform(112, 140)])
        for ball, (place, radius) in enumerate(zip(PLATE.T, RADII)):
            centre = turn @ place + middle
            centres.append(centre)
            for step, plane in enumerate(planes.T):
                pixels = CAMERA.project(_arc(centre, radius, plane))
                inside = ((pixels > 0) & (pixels < np.array([[640.0], [512.0]]))).all(0)
                found.append(
                    (
                        pixels[:, inside],
                        np.full(inside.sum(), 3 * scan + ball),
                        np.full(inside.sum(), step),
                    )
                )
    pixels, ball, step = (np.concatenate([one[k] for one in found], axis=-1) for k in range(3))
    return Balls(
        CAMERA,
        pixels,
        {"ball": ball, "step": step},
        np.array(centres),
        np.tile(RADII, scans),
        np.tile([1, 2, 3], scans),
        planes,
        np.array([[1.0], [0.0]]),
        np.full((1, len(step)), sigma),
        mirror,
        angles,
        covariates=_swept(100 + ball // 3, step, rng),
    )


def _arc(centre, radius, plane):
    """Points (3, k) of the circle in which a plane cuts a ball, those seen and lit from less than 60 degrees."""
    distance = plane[:3] @ centre + plane[3]
    if abs(distance) > 0.8 * radius:
        return np.zeros((3, 0)) + 1.0
    first = np.cross(plane[:3], [0.0, 1.0, 0.0])
    first = first / np.linalg.norm(first)
    turns = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    around = np.outer(first, np.cos(turns)) + np.outer(np.cross(plane[:3], first), np.sin(turns))
    points = (centre - distance * plane[:3])[:, None] + np.sqrt(radius**2 - distance**2) * around
    normals = (points - centre[:, None]) / radius
    towards = np.array([69.0, 0.0, 0.0])[:, None] - points
    lit = (normals * towards).sum(0) / np.linalg.norm(towards, axis=0)
    seen = -(normals * points).sum(0) / np.linalg.norm(points, axis=0)
    return points[:, (lit > 0.5) & (seen > 0.5)]


def _swept(group, step, rng):
    """Sweeps both ways at different speeds, a minute each."""
    count = int(group.max()) + 1
    way, speed = rng.choice([-1.0, 1.0], count), rng.uniform(2.0, 8.0, count)
    return {
        "time_s": 60.0 * group + 2.0 * step,
        "sweep": way[group],
        "mirror_speed_deg_s": (way * speed)[group],
    }
