"""Configurations of the arm that see the balls, or that show their reflectors to an instrument."""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from datasets.makers import poses
from datasets.makers.blind import data_sheets

_POOL = 8000
_LEVER = 300.0  # mm that one rad of orientation counts as, as in `poses`


def limits(robot, mixing: np.ndarray) -> np.ndarray:
    """(J, 2) rad: what the joints' angles may be; those of a coupled joint follow from its own reading."""
    own_limits = (
        np.deg2rad([data_sheets.limits_deg(row) for row in robot["joint"]])
        * np.diag(mixing)[:, None]
    )
    return np.sort(own_limits, axis=1)


def views(
    rng: np.random.Generator,
    geometry,
    limits_of_joints,
    balls: np.ndarray,
    hand: np.ndarray,
    n: int,
):
    """Configurations (n, J) rad that see a ball in the sensor's field, ball (n,), and the plate in the base (4, 4).

    limits_of_joints: (J, 2) rad. balls: (B, 3) mm on the plate. The sensor looks down, tilted by up to 55 deg, from
    100 to 165 mm, with the ball up to 35 mm off its axis. Raises ValueError if too few are reachable.
    """
    pool = rng.uniform(*limits_of_joints.T, (_POOL, len(limits_of_joints)))
    seen_from = poses.forward_kinematics(geometry, pool) @ hand
    tree = cKDTree(_twelve(seen_from))
    reach = np.abs(geometry[:, 1:3]).sum()
    for _ in range(30):
        plate = _plate(rng, reach)
        ball, view = _wanted(rng, balls @ plate[:3, :3].T + plate[:3, 3], 3 * n)
        nearest = pool[tree.query(_twelve(view))[1]]
        is_reached = poses.inverse(
            geometry, view[:60] @ np.linalg.inv(hand), nearest[:60], limits_of_joints, 15
        )[1]
        if is_reached.mean() < 0.5:
            continue
        joints, good = poses.inverse(
            geometry, view @ np.linalg.inv(hand), nearest, limits_of_joints, 15
        )
        if good.sum() >= n:
            chosen = rng.permutation(np.flatnonzero(good))[:n]
            return joints[chosen], ball[chosen], plate
    raise ValueError("no place for the plate that this arm can see from enough sides")


def _plate(rng, reach) -> np.ndarray:
    """A plate in front of the arm, nearly level."""
    side = rng.uniform(-1.0, 1.0)
    distance = reach * rng.uniform(0.32, 0.6)
    plate = np.eye(4)
    plate[:3, :3] = Rotation.from_euler(
        "ZYX", [rng.uniform(-3, 3), *rng.normal(0, 0.05, 2)]
    ).as_matrix()
    plate[:3, 3] = (
        distance * np.cos(side),
        distance * np.sin(side),
        reach * rng.uniform(-0.05, 0.25),
    )
    return plate


def _wanted(rng, balls, many):
    """Ball (many,) and sensor pose (many, 4, 4) in the base that sees it."""
    ball = rng.integers(len(balls), size=many)
    view = np.tile(np.eye(4), (many, 1, 1))
    view[:, :3, :3] = poses.looking_down(rng, many, np.deg2rad(55), np.pi)
    seen = np.column_stack([rng.uniform(-35, 35, (many, 2)), rng.uniform(100, 165, many)])
    view[:, :3, 3] = balls[ball] - np.einsum("nij,nj->ni", view[:, :3, :3], seen)
    return ball, view


def _twelve(frames) -> np.ndarray:
    """(n, 12): place and axes, in mm, so that near means near in both."""
    return np.hstack([frames[:, :3, 3], _LEVER * frames[:, :3, :3].reshape(-1, 9) / np.sqrt(2)])


def in_sight(rng: np.random.Generator, geometry, joint_range, n: int) -> np.ndarray:
    """Configurations (n, J) rad with the flange above the floor and on the side of the instrument."""
    share = rng.uniform(0.6, 1.0)
    middle, half = (
        joint_range.mean(1),
        np.minimum(np.ptp(joint_range, axis=1) / 2, np.deg2rad(150)) * share,
    )
    reach, azimuth = np.abs(geometry[:, 1:3]).sum(), rng.uniform(-0.8, 0.8)
    found = np.empty((0, len(joint_range)))
    for _ in range(60):
        joints = rng.uniform(middle - half, middle + half, (4 * n, len(joint_range)))
        positions = poses.forward_kinematics(geometry, joints)[:, :3, 3]
        good = (positions[:, 2] > 0.05 * reach) & (
            positions[:, :2] @ [np.cos(azimuth), np.sin(azimuth)] > 0.1 * reach
        )
        found = np.vstack([found, joints[good]])
        if len(found) >= n:
            return found[:n]
    raise ValueError("this arm hardly ever shows its flange to the instrument")
