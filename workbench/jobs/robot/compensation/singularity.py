"""Singular postures: which joint is at its singular position, from the singular vectors of the Jacobian."""

import numpy as np

from robot_model.postures.task_priority import LEVER_MM
from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.jobs.robot.compensation.compensate import nominal_poses

_STEP = 1e-4
_SINGULAR = 0.05  # smallest over largest singular value


def singular_joint(robot: Robot, reading: np.ndarray) -> int | None:
    """Number of the joint that is at its singular position, reading (R,) rad, mm; None away from singular postures.

    The smallest singular value sigma = u' J v changes by u' (dJ/dq) v with a joint reading q. The joint with the
    largest change leads out of the singularity: joint 5 of a spherical wrist whose axes 4 and 6 are aligned, although
    these two make the motion v that leaves the flange in place; the elbow of a stretched arm.
    """
    left_vectors, sizes, right = np.linalg.svd(_jacobian(robot, reading), full_matrices=False)
    if sizes[-1] > _SINGULAR * sizes[0]:
        return None
    steps = np.diag(_steps(robot))
    changes = [left_vectors[:, -1] @ _jacobian_change(robot, reading, s) @ right[-1] for s in steps]
    return int(np.argmax(np.abs(changes))) + 1


def _jacobian_change(robot: Robot, reading: np.ndarray, step: np.ndarray) -> np.ndarray:
    """(6, R) change of the Jacobian from a step below a reading to a step above it."""
    return _jacobian(robot, reading + step) - _jacobian(robot, reading - step)


def reading_words(robot: Robot, reading: np.ndarray, joint: int) -> str:
    """Value and unit of one joint's reading, as people read it."""
    value = reading[joint - 1]
    if sliding(robot)[joint - 1]:
        return f"{value:.4g} mm"
    return f"{np.rad2deg(value):.3g} deg"


def _steps(robot) -> np.ndarray:
    """(R,) rad, mm: small changes of the readings that move the flange alike at a lever's length."""
    return _STEP * np.where(sliding(robot), LEVER_MM, 1.0)


def _jacobian(robot, reading) -> np.ndarray:
    """(6, R) mm: motion of the flange, its rotation at a lever's length, per rad and per LEVER_MM of a slide."""
    steps = np.diag(_steps(robot))
    after = nominal_poses(robot, reading + steps)
    before = nominal_poses(robot, reading - steps)
    moved = after[:, :3, 3] - before[:, :3, 3]
    turned = _rotation_between(before, after)
    return np.concatenate([moved.T, LEVER_MM * turned.T]) / (2 * _STEP)


def _rotation_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n, 3) rad: rotation vectors, in the root frame, from poses (n, 4, 4) to others."""
    from scipy.spatial.transform import Rotation

    relative = after[:, :3, :3] @ before[:, :3, :3].transpose(0, 2, 1)
    return Rotation.from_matrix(relative).as_rotvec()
