"""Which revolution of a joint a target takes: the one nearest to the readings of the recording."""

import numpy as np

from robot_model.robot import Robot
from robot_model.state import reading_names, sliding
from workbench.files.solution_file import CalibratedArm

_TURN = 2 * np.pi


def recorded_middle(arm: CalibratedArm) -> np.ndarray:
    """(R,) rad, mm: the middle of the recorded range of every reading, else of its limits, else 0."""
    middle = np.nan_to_num(arm.robot.limits.mean(1))
    ranges = arm.fitted_range or {}
    for k, name in enumerate(reading_names(arm.robot)):
        if name in ranges:
            unit = 1.0 if name.endswith("mm") else np.pi / 180
            middle[k] = sum(ranges[name]) / 2 * unit
    return middle


def nearest_revolutions(robot: Robot, readings: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Readings (n, R) rad, mm, by whole revolutions next to `reference` (R,) or (n, R), as far as limits allow."""
    turned = readings + _TURN * np.round((reference - readings) / _TURN) * ~sliding(robot)
    low, high = robot.limits.T
    is_outside = (turned < low) | (turned > high)
    return np.where(is_outside, readings, turned)
