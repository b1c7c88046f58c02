"""The configuration of an arm: which of the solutions of its inverse kinematics a set of joint readings belongs to.

An arm with six rotary joints reaches a pose in up to eight ways. Two of them are separated by a singular posture, where
one of three signs changes (Pieper 1968; Siciliano et al., Robotics, section 2.12):

shoulder: on which side of the plane through axis 1 and the direction of axis 2 the wrist lies, along z1 x z2;
elbow: z2 . ((p3 - p2) x (w - p3)), the sense in which the forearm is bent against the upper arm, about axis 2;
wrist: z5 . (z4 x z6), the sense in which axis 6 is bent against axis 4, about axis 5;

with z_k the direction of axis k, p_k a point on it, and w the point of axis 5 next to axis 4. The three expressions are
scaled to sines: of the bend of elbow and wrist, and of the wrist's distance from the plane per length of the arm.
Below a sine of 0.01 the sign is 0, "singular": there a joint turns more than 100 times as far as the flange, and a
correction or a rounding error decides on which side the arm is.
"""

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot
from robot_model.state import sliding

SIGNS = ("shoulder", "elbow", "wrist")
_JOINTS = 6
_PARALLEL = 0.99
_PERPENDICULAR = 0.1
_TINY = 1e-9
_SINGULAR = 0.01  # sine; a joint turns 100 times as far as the flange


def has_configurations(robot: Robot) -> bool:
    """Whether the three signs distinguish the solutions: six rotary joints, axis 2 across axis 1 and along axis 3."""
    if robot.joints != _JOINTS or sliding(robot).any():
        return False
    frames = forward(robot, np.full((_JOINTS, 1), 0.3))
    first, second, third = frames.z[:3, :, 0]
    return bool(abs(first @ second) < _PERPENDICULAR and abs(second @ third) > _PARALLEL)


def configuration_signs(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """(n, 3) in -1, 0, 1: signs of shoulder, elbow and wrist at readings (n, R) rad; 0 next to a singular posture, and
    where a reading is nan.

    robot: one with `has_configurations`.
    """
    readings = np.asarray(readings, float)
    frames = forward(robot, robot.mixing @ readings.T)
    axes = frames.z
    points = frames.z_origin
    wrist = _nearest_point(points[4], axes[4], points[3], axes[3])
    upper = _perpendicular(points[2] - points[1], axes[1])
    forearm = _perpendicular(wrist - points[2], axes[1])
    lengths = np.linalg.norm(upper, axis=0), np.linalg.norm(forearm, axis=0)
    shoulder = _dot(np.cross(axes[0], axes[1], axis=0), wrist - points[0])
    bend = _dot(axes[1], np.cross(upper, forearm, axis=0))
    tilt = _dot(axes[4], np.cross(axes[3], axes[5], axis=0))
    scales = np.stack(
        [lengths[0] + lengths[1], lengths[0] * lengths[1], np.ones_like(tilt)], axis=1
    )
    sines = np.stack([shoulder, bend, tilt], axis=1) / np.maximum(scales, _TINY)
    sines = np.nan_to_num(sines)
    return np.where(np.abs(sines) < _SINGULAR, 0, np.sign(sines)).astype(int)


def configuration_name(signs) -> str:
    """In words: "shoulder +, elbow -, wrist +"."""
    marks = {-1: "-", 0: "singular", 1: "+"}
    return ", ".join(f"{name} {marks[int(sign)]}" for name, sign in zip(SIGNS, signs))


def _perpendicular(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(3, n) the parts of vectors that are perpendicular to unit axes."""
    return vectors - _dot(vectors, axes) * axes


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) products of vectors (3, n)."""
    return (first * second).sum(0)


def _nearest_point(point, axis, other, other_axis) -> np.ndarray:
    """(3, n) the point of the line (point, axis) that is next to the line (other, other_axis); unit axes."""
    cosine = _dot(axis, other_axis)
    gap = other - point
    distance = _dot(gap, axis) - cosine * _dot(gap, other_axis)
    return point + axis * (distance / np.maximum(1 - cosine**2, 1e-9))
