"""Reachable configurations for made recordings: batched inverse kinematics on the rigid nominal arm.

Lengths mm, angles rad. Only for choosing where the arm goes; what is measured
there comes from the engine.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

_LEVER = 300.0  # mm that one rad of orientation error counts as
_LEAST_STEP = 1e-13  # rad


def _fixed(d, a, alpha, beta) -> np.ndarray:
    """(4, 4) Tz(d) Tx(a) Rx(alpha) Ry(beta), what follows the rotation of a joint."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("XY", [alpha, beta]).as_matrix()
    out[:3, 3] = a, 0, d
    return out


def forward_kinematics(geometry: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(n, 4, 4) flange poses of the rigid arm at joint angles (n, J)."""
    out = np.tile(np.eye(4), (len(joints), 1, 1))
    for (theta, *constants), q in zip(geometry, joints.T):
        cosine, sine = np.cos(q + theta)[:, None], np.sin(q + theta)[:, None]
        x, y = out[..., 0].copy(), out[..., 1].copy()
        out[..., 0], out[..., 1] = cosine * x + sine * y, cosine * y - sine * x
        out = out @ _fixed(*constants)
    return out


def _miss(geometry, joints, targets) -> np.ndarray:
    """(n, 6) how far each flange is from its target, all in mm."""
    reached = forward_kinematics(geometry, joints)
    relative = targets[:, :3, :3] @ reached[:, :3, :3].transpose(0, 2, 1)
    rotation = Rotation.from_matrix(relative).as_rotvec()
    return np.hstack([targets[:, :3, 3] - reached[:, :3, 3], _LEVER * rotation])


def _newton_step(geometry, joints, targets, damping: float = 1.0) -> np.ndarray:
    miss = _miss(geometry, joints, targets)
    h = 1e-6
    columns = [
        (_miss(geometry, joints + h * unit, targets) - miss) / -h
        for unit in np.eye(joints.shape[1])
    ]
    slope = np.stack(columns, axis=2)
    normal = slope.transpose(0, 2, 1) @ slope + damping * np.eye(joints.shape[1])
    step = np.linalg.solve(normal, np.einsum("nij,ni->nj", slope, miss)[..., None])[..., 0]
    return np.clip(step, -0.4, 0.4)


def inverse(
    geometry, targets, start, limits, iterations: int = 40
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (n, J) near `start` (n, J), and (n,) whether target and limits are met.

    targets: (n, 4, 4) flange poses; limits: (J, 2). Damped Newton steps on all rows together; a row rests once a step
    is lost in rounding, and one that does not get within 0.01 mm counts as not reached.
    """
    joints = np.array(start, float)
    moving = np.arange(len(joints))
    for _ in range(iterations):
        step = _newton_step(geometry, joints[moving], targets[moving])
        joints[moving] += step
        moving = moving[np.abs(step).max(1) > _LEAST_STEP]
        if not len(moving):
            break
    joints = (joints + np.pi) % (2 * np.pi) - np.pi
    is_near = np.linalg.norm(_miss(geometry, joints, targets), axis=1) < 0.01
    is_within_limits = np.all((joints > limits[:, 0]) & (joints < limits[:, 1]), axis=1)
    return joints, is_near & is_within_limits


def looking_down(rng: np.random.Generator, n: int, tilt: float, roll: float) -> np.ndarray:
    """(n, 3, 3) orientations whose z axis points down, tilted and rolled by up to the given rad."""
    angle = tilt * np.sqrt(rng.random(n))
    side = rng.uniform(-np.pi, np.pi, n)
    axis = np.column_stack([np.cos(side), np.sin(side), np.zeros(n)])
    about_axis = Rotation.from_rotvec(angle[:, None] * axis)
    down = np.column_stack([np.full(n, np.pi), rng.uniform(-roll, roll, n)])
    return (about_axis * Rotation.from_euler("XZ", down)).as_matrix()


def scanning(
    rng,
    geometry,
    limits,
    balls_base,
    hand_eye,
    n,
    start,
    roll: float = np.pi,
    tilt: float = np.deg2rad(50),
    stand_off=(115.0, 135.0),
    half_field: float = 15.0,
):
    """Configurations that see the balls in the middle of the sensor's field.

    balls_base: (B, 3) mm; hand_eye: (4, 4) sensor in flange; start: (J,) posture
    near which the inverse starts. Returns joints (n, J) and ball index (n,).
    Views come from above, up to `tilt` rad off, with the ball `stand_off` mm along
    the sensor's axis and up to `half_field` mm off it each way; what is given
    here is how the sensor of Ye 2024 works. Raises ValueError where too few can be
    reached.
    """
    many = 8 * n
    ball = rng.integers(len(balls_base), size=many)
    view = np.tile(np.eye(4), (many, 1, 1))
    view[:, :3, :3] = looking_down(rng, many, tilt, roll)
    seen = np.column_stack(
        [rng.uniform(-half_field, half_field, (many, 2)), rng.uniform(*stand_off, many)]
    )
    view[:, :3, 3] = balls_base[ball] - np.einsum("nij,nj->ni", view[:, :3, :3], seen)
    targets = view @ np.linalg.inv(hand_eye)
    begin = start + rng.uniform(-0.3, 0.3, (many, len(start)))
    joints, good = inverse(geometry, targets, begin, limits)
    if good.sum() < n:
        raise ValueError(f"only {good.sum()} of the {n} wanted views can be reached")
    chosen = rng.permutation(_balanced(ball, np.flatnonzero(good))[:n])
    return joints[chosen], ball[chosen]


def _balanced(ball: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The rows again, the first view of every ball first, then the second of every ball ..."""
    visit = [np.sum(ball[rows[:i]] == ball[row]) for i, row in enumerate(rows)]
    return rows[np.argsort(visit, kind="stable")]
