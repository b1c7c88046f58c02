"""Part of an effect orthogonal to the baseline, from an independent numerical baseline.

The derivative of the measured point with respect to every number of base, rows and tool is taken by finite
differences of an independent rigid kinematic model. A calibration absorbs everything in its span.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.makers import poses
from datasets.makers.blind.world import World

_STEP = 1e-5  # rad, and 1e-2 mm
_RANK = 1e-7


def basis(world: World) -> np.ndarray:
    """(3 n, R) orthonormal basis of the measurement changes that a fit of the baseline absorbs, to first order."""
    start = world.arm.geometry
    points_at_start = _points_at(world, start)
    columns = [
        (_points_at(world, *moved) - points_at_start).ravel() for moved in _moves(world, start)
    ]
    columns += list(_joint_compliances(world, points_at_start)) if world.elastic else []
    matrix = np.column_stack(columns)
    size = np.linalg.norm(matrix, axis=0)
    u, s, _ = np.linalg.svd(matrix[:, size > 0] / size[size > 0], full_matrices=False)
    return u[:, s > _RANK * s[0]]


def left(base: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(3 n,) the part of a change (n, 3) orthogonal to the baseline."""
    flat = change.ravel()
    return flat - base @ (base.T @ flat)


def rms(values: np.ndarray) -> float:
    """Root mean square over measured coordinates."""
    return float(np.sqrt(np.mean(np.square(values))))


def _points_at(world, geometry, station=None, hand=None, targets=None) -> np.ndarray:
    flange = poses.forward_kinematics(geometry, world.angles)
    hand, station = (
        (world.hand if hand is None else hand),
        (world.station if station is None else station),
    )
    return world.seen(
        flange, hand, (world.targets if targets is None else targets)[world.index], station
    )


def _moves(world, geometry) -> Iterator[tuple]:
    """Every number of the baseline moved by a step: geometry, station, hand, targets."""
    for k, c in np.ndindex(geometry.shape):
        moved = geometry.copy()
        moved[k, c] += _STEP * (1e3 if c in (1, 2) else 1)
        yield moved, None, None, None
    for twist in _twists():
        yield geometry, twist @ world.station, None, None
    if world.measures == "ball-centre":
        for twist in _twists():
            yield geometry, None, world.hand @ twist, None
        return
    for place in np.ndindex(world.targets.shape):
        moved = world.targets.copy()
        moved[place] += _STEP * 1e3
        yield geometry, None, None, moved


def _twists() -> Iterator[np.ndarray]:
    for k in range(6):
        twist = np.eye(4)
        if k < 3:
            twist[k, 3] = _STEP * 1e3
        else:
            twist[:3, :3] = Rotation.from_rotvec(_STEP * np.eye(3)[k - 3]).as_matrix()
        yield twist


def _joint_compliances(world, points_at_start) -> Iterator[np.ndarray]:
    """Joint compliance of every joint, which is part of the baseline if the arm is elastic."""
    for k in range(world.joints):
        geometry, angles = world.arm.geometry, world.angles.copy()
        angles[:, k] += _STEP * world.torque[:, k]
        if np.ptp(world.torque[:, k]) < 1e-3:
            continue
        flange = poses.forward_kinematics(geometry, angles)
        yield (
            world.seen(flange, world.hand, world.targets[world.index], world.station)
            - points_at_start
        ).ravel()
