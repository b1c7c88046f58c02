"""Limits of corrections that the measured errors of the nominal arm confirm."""

import numpy as np

from robot_model.postures.task_priority import Task, pose_difference, pose_sizes
from robot_model.state import reading_names, sliding
from workbench.files.solution_file import LARGEST_DEG, LARGEST_MM, CalibratedArm
from workbench.jobs.robot.compensation.compensate import actual_poses, nominal_poses

_POSES = 200
_MAX_FACTOR = 3.0  # times the usual limits, whatever is confirmed: a person then states a limit
_MARGIN = 1.5  # of corrections at targets over those at random poses, and of their RMS over that of measured errors


def largest_corrections(arm: CalibratedArm) -> tuple[float, float]:
    """Largest plausible correction of position (mm) and orientation (deg) of the flange, where nobody states it.

    10 mm and 1 deg, or the largest correction in the recorded ranges of the readings with a margin, where the
    measurements confirm it: the error of the nominal arm was measured, and it is as large as the model makes it once
    base and tool are fitted, as they were for the nominal arm. Never above 30 mm and 3 deg. A measured error that
    contains a base which moved in the recording confirms nothing of the arm.
    """
    measured_mm = (arm.keys.get("nominal") or {}).get("rms_mm")
    readings = _recorded_readings(arm)
    has_moved = any(e.of_session and e.where == "base" for e in arm.effects)
    if measured_mm is None or readings is None or has_moved:
        return LARGEST_MM, LARGEST_DEG
    middle = {name: sum(ends) / 2 for name, ends in arm.fitted_range.items()}
    actual = actual_poses(arm, readings, middle)
    nominal = nominal_poses(arm.robot, readings)
    point = Task.of(arm.robot, arm.values).point
    if _aligned_rms_mm(actual, nominal, point) > _MARGIN * measured_mm:
        return LARGEST_MM, LARGEST_DEG
    position, rotation = pose_sizes(pose_difference(actual, nominal))
    return (
        float(np.clip(_MARGIN * position.max(), LARGEST_MM, _MAX_FACTOR * LARGEST_MM)),
        float(np.clip(_MARGIN * rotation.max(), LARGEST_DEG, _MAX_FACTOR * LARGEST_DEG)),
    )


def _recorded_readings(arm: CalibratedArm) -> np.ndarray | None:
    """(n, R) rad, mm: random readings within the recorded ranges; None where a range is not known."""
    ranges = arm.fitted_range or {}
    names = reading_names(arm.robot)
    if not ranges.keys() >= set(names):
        return None
    low, high = np.array([ranges[name] for name in names]).T
    readings = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    return np.where(sliding(arm.robot), readings, np.deg2rad(readings))


def _aligned_rms_mm(actual: np.ndarray, nominal: np.ndarray, point: np.ndarray) -> float:
    """RMS distance of a point on the tool between poses (n, 4, 4), after a fit of base and tool, linearised."""
    tool = np.append(point, 1.0)
    actual_points = (actual @ tool)[:, :3]
    nominal_points = (nominal @ tool)[:, :3]
    centred = nominal_points - nominal_points.mean(0)
    shifts = np.broadcast_to(np.eye(3), (len(nominal_points), 3, 3))
    size = max(float(np.abs(centred).max()), 1.0)
    rotations = np.stack([np.cross(axis, centred) / size for axis in np.eye(3)], axis=2)
    columns = np.concatenate([shifts, rotations, nominal[:, :3, :3]], axis=2).reshape(-1, 9)
    error = (actual_points - nominal_points).ravel()
    remainder = error - columns @ np.linalg.lstsq(columns, error, rcond=1e-9)[0]
    return float(np.sqrt((remainder**2).sum() / len(nominal_points)))
