"""The configuration of an arm: which of the solutions of its inverse kinematics a set of joint readings belongs to.

An arm with six rotary joints reaches a pose in up to eight ways. Two of them are separated by a singular posture, where
one of three signs changes (Pieper 1968; Siciliano et al., Robotics, section 2.12):

shoulder: on which side of the plane through axis 1 and the direction of axis 2 the wrist lies, along z1 x z2;
elbow: z2 . ((p3 - p2) x (w - p3)), the sense in which the forearm is bent against the upper arm, about axis 2;
wrist: z5 . (z4 x z6), the sense in which axis 6 is bent against axis 4, about axis 5;

with z_k the direction of axis k, p_k a point on it, and w the point of axis 5 next to axis 4.
"""

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot
from robot_model.state import sliding

SIGNS = ("shoulder", "elbow", "wrist")
_JOINTS = 6
_PARALLEL = 0.99
_PERPENDICULAR = 0.1


def has_configurations(robot: Robot) -> bool:
    """Whether the three signs distinguish the solutions: six rotary joints, axis 2 across axis 1 and along axis 3."""
    if robot.joints != _JOINTS or sliding(robot).any():
        return False
    frames = forward(robot, np.full((_JOINTS, 1), 0.3))
    first, second, third = frames.z[:3, :, 0]
    return bool(abs(first @ second) < _PERPENDICULAR and abs(second @ third) > _PARALLEL)


def configuration_signs(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """(n, 3) in -1, 0, 1: signs of shoulder, elbow and wrist at readings (n, R) rad, 0 where a reading is nan.

    robot: one with `has_configurations`.
    """
    readings = np.asarray(readings, float)
    frames = forward(robot, robot.mixing @ readings.T)
    axes, points = frames.z, frames.z_origin
    wrist = _nearest_point(points[4], axes[4], points[3], axes[3])
    shoulder = _dot(np.cross(axes[0], axes[1], axis=0), wrist - points[0])
    bend = np.cross(points[2] - points[1], wrist - points[2], axis=0)
    tilt = np.cross(axes[3], axes[5], axis=0)
    values = np.stack([shoulder, _dot(axes[1], bend), _dot(axes[4], tilt)], axis=1)
    return np.sign(np.nan_to_num(values)).astype(int)


def configuration_name(signs) -> str:
    """In words: "shoulder +, elbow -, wrist +"."""
    marks = {-1: "-", 0: "singular", 1: "+"}
    return ", ".join(f"{name} {marks[int(sign)]}" for name, sign in zip(SIGNS, signs))


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) products of vectors (3, n)."""
    return (first * second).sum(0)


def _nearest_point(point, axis, other, other_axis) -> np.ndarray:
    """(3, n) the point of the line (point, axis) that is next to the line (other, other_axis); unit axes."""
    cosine = _dot(axis, other_axis)
    gap = other - point
    along = _dot(gap, axis) - cosine * _dot(gap, other_axis)
    return point + axis * (along / np.maximum(1 - cosine**2, 1e-9))
