"""Inverse kinematics of arms that cannot move their flange in all six directions: position first, then orientation.

A SCARA, a palletiser or an arm with five joints reaches a position and keeps some error of orientation that its joints
cannot move. The orientation is corrected in the null space of the position, by least squares (Nakamura, Hanafusa &
Yoshikawa 1987, "Task-priority based redundancy control of robot manipulators").
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot
from robot_model.state import sliding
from robot_model.tool_points import calibrated_points

# lever (mm) that makes a rotation comparable to a shift, and a slide (mm) comparable to a radian
LEVER_MM = 200.0
# a direction counts as movable where its singular value is above this part of the largest one
_MOVABLE = 1e-4
_CONFIGURATIONS = 16
_FULL = 6
# damping of the inverse near singular postures, relative to the square of the largest singular value
_DAMPING = 1e-9


@dataclass(frozen=True)
class Task:
    """Task of an arm: the components of a pose that must be reached.

    `point` (3,) mm in the flange frame: the point whose position comes first. `ranks`: number of directions of its
    position (0 to 3), and then of the orientation while it stands still, in which the readings move the tool; (3, 3)
    for an arm with six joints. `is_fixed` (R,) bool: readings that no correction may change.
    """

    point: np.ndarray
    ranks: tuple
    is_fixed: np.ndarray

    @classmethod
    def of(cls, robot, values, ranges=None):
        """The task of an arm: its first calibrated point on the tool, or the origin of the flange.

        values: parameters by key. ranges: column of samples.csv -> lowest and highest recorded value. The ranks are
        the largest of the nominal arm's over random configurations, so that a singular posture does not count.
        """
        points = list(calibrated_points(values).values())
        point = np.array(points[0] if points else [0.0, 0.0, 0.0])
        is_fixed = held_readings(robot, ranges or {})
        return cls(point, _movable_ranks(robot, point, is_fixed), is_fixed)

    @property
    def is_deficient(self) -> bool:
        """Whether there are directions in which the joints cannot move the tool, or joints that no drive moves."""
        return sum(self.ranks) < _FULL or bool(self.is_fixed.any())


def held_readings(robot: Robot, ranges) -> np.ndarray:
    """(R,) bool: readings of joints without a drive, such as the hand of a palletiser, which a linkage keeps level.

    Such a joint is coupled to another one, and its own reading stayed at one value throughout the recording.
    """
    is_fixed = np.zeros(robot.mixing.shape[1], bool)
    if robot.mixing.shape[0] != robot.mixing.shape[1]:
        return is_fixed  # mimic joints of a URDF have no readings
    for k, slides in enumerate(sliding(robot)):
        low, high = ranges.get(f"q{k + 1}_{'mm' if slides else 'deg'}", (-np.inf, np.inf))
        is_fixed[k] = np.count_nonzero(robot.mixing[k]) > 1 and high == low
    return is_fixed


def _movable_ranks(robot: Robot, point, is_fixed: np.ndarray) -> tuple[int, int]:
    low, high = robot.limits.T
    ends = np.where(sliding(robot), LEVER_MM, np.pi)
    low = np.where(np.isnan(low), -ends, low)
    high = np.where(np.isnan(high), ends, high)
    readings = np.random.default_rng(0).uniform(low, high, (_CONFIGURATIONS, len(low)))
    jacobian = (
        _reading_jacobian(robot, forward(robot, robot.mixing @ readings.T), point) * ~is_fixed
    )
    _, moved, directions = np.linalg.svd(jacobian[:, :3])
    place = int((moved > _MOVABLE * moved.max()).sum(1).max())
    null_space = np.swapaxes(directions[:, place:], 1, 2)
    rotations = np.linalg.svd(jacobian[:, 3:] @ null_space, compute_uv=False)
    return place, int((rotations > _MOVABLE).sum(1).max(initial=0))


def _reading_jacobian(robot: Robot, frames, point) -> np.ndarray:
    """(n, 6, R) change of a point (mm) and of the orientation (rad), by radian or by LEVER_MM of a slide."""
    jacobian = geometric_jacobian(robot, frames, point) @ robot.mixing
    return jacobian * np.where(sliding(robot), LEVER_MM, 1.0)


def geometric_jacobian(robot: Robot, frames, point) -> np.ndarray:
    """(n, 6, J) change of a point (mm, flange frame) and of the orientation (rad) by each joint variable (rad, mm)."""
    axes = frames.z
    lever = frames.point(point) - frames.z_origin
    slides = robot.prismatic[:, None, None]
    moved = np.where(slides, axes, np.cross(axes, lever, axis=1))
    rotated = np.where(slides, 0.0, axes)
    return np.concatenate([moved, rotated], 1).transpose(2, 1, 0)


def joint_part(robot, frames, error, task, weights=1.0) -> tuple:
    """(n, R) change of the readings (rad, mm) that makes an error, and (n,) mm: what of it the joints can move.

    frames: of the arm, root frame. error (6, n): of `pose_difference` at the point of the task. weights (R,): how
    readily a reading takes part where there is a choice.
    """
    scale = np.where(sliding(robot), LEVER_MM, 1.0) * weights * ~task.is_fixed
    jacobian = geometric_jacobian(robot, frames, task.point) @ robot.mixing * scale
    step, movable = priority_step(jacobian, error, task.ranks)
    return step * scale, movable


def pose_difference(actual, target, point=(0.0, 0.0, 0.0)) -> np.ndarray:
    """(6, n) mm and rad: shift of a point and rotation vector that take wanted poses (n, 4, 4) to the actual ones.

    point (3,) mm in the frame that the poses place; shift and rotation vector are in the frame that they refer to.
    """
    rotation = actual[:, :3, :3] @ target[:, :3, :3].transpose(0, 2, 1)
    axis = np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ]
    )
    sine = np.sqrt((axis**2).sum(0)) / 2
    cosine = (np.trace(rotation, axis1=1, axis2=2) - 1) / 2
    angle = np.arctan2(sine, cosine)
    scale = np.where(sine > 1e-9, angle / np.maximum(2 * sine, 1e-300), 0.5)
    shift = ((actual - target)[:, :3] @ np.append(point, 1.0)).T
    return np.concatenate([shift, axis * scale])


def pose_sizes(error) -> tuple:
    """(n,) mm and (n,) deg: the sizes of both parts of an error (6, n) in mm and rad."""
    rotation = np.rad2deg(np.sqrt((error[3:] ** 2).sum(0)))
    position = np.sqrt((error[:3] ** 2).sum(0))
    return position, rotation


def priority_step(jacobian: np.ndarray, error: np.ndarray, ranks: tuple[int, int]) -> tuple:
    """(n, R) change of the readings that makes the error, and (n,) mm: what of the error the joints can move.

    jacobian (n, 6, R), error (6, n) mm and rad. The position is changed first, the orientation in its null space, each
    in as many directions as `ranks` says. The rest is the larger of the two parts, the rotation at a lever of 200 mm;
    it is zero at the optimum.
    """
    place = error[:3].T
    rotation = error[3:].T
    inverse, null_space, movable = _ranked(jacobian[:, :3], ranks[0])
    first = _times(inverse, place)
    inner, _, turnable = _ranked(jacobian[:, 3:] @ null_space, ranks[1])
    remaining = rotation - _times(jacobian[:, 3:], first)
    step = first + _times(null_space, _times(inner, remaining))
    position_error = np.linalg.norm(_times(movable, place), axis=1)
    rest_rotation = np.linalg.norm(_times(turnable, rotation), axis=1)
    return step, np.maximum(position_error, LEVER_MM * rest_rotation)


def _ranked(matrix, rank: int) -> tuple:
    """Pseudo-inverse (n, c, r) of matrices (n, r, c) of a known rank, their null space (n, c, c - rank), and the rows
    (n, rank, r) that project on their range."""
    u, s, vt = np.linalg.svd(matrix)
    v = np.swapaxes(vt, 1, 2)
    rows = np.swapaxes(u, 1, 2)[:, :rank]
    null_space = v[:, :, rank:]
    retained = s[:, :rank]
    largest = s[:, :1]
    gains = retained / (retained**2 + _DAMPING * largest**2 + 1e-300)
    inverse = (v[:, :, :rank] * gains[:, None]) @ rows
    return inverse, null_space, rows


def _times(matrix, vector) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]
