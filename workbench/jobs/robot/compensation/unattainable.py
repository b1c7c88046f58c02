"""Why a target has no corrected readings: its distance from the nearest attainable pose, and singular postures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from robot_model.postures.task_priority import LEVER_MM
from robot_model.state import sliding
from robot_model.tool_points import corrected_point_name
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import (
    actual_poses,
    negligible_mm,
    nominal_poses,
)
from workbench.jobs.robot.compensation.singularity import reading_words, singular_joint

_STEP_RAD = 1e-4
_MOST_TARGETS = 12
_BEYOND_MM, _BEYOND_DEG = 10.0, 1.0  # farther away than any error of a calibrated arm


@dataclass(frozen=True)
class Unattainable:
    """One target (index `row`) that the calibrated arm cannot take.

    `distance_mm`, `rotation_deg`: what remains at the nearest attainable pose. `joint`: number of the joint that is at
    its singular position there, None where no joint is; `reading`: its value with the unit. `allowed_mm`: what might
    remain, conditional on the uncertainty of the target.
    """

    row: int
    distance_mm: float
    rotation_deg: float
    joint: int | None
    reading: str = ""
    allowed_mm: float | None = None

    @property
    def sentence(self) -> str:
        """Message: fault and remedy."""
        shortfall = f"{self.distance_mm:.2g} mm and {self.rotation_deg:.2g} deg"
        if self.distance_mm > _BEYOND_MM or self.rotation_deg > _BEYOND_DEG:
            return (
                f"Target {self.row + 1} has no readings in corrected.csv: it is not attainable with the joints of the "
                f"arm, and the nearest attainable pose is {shortfall} away. Move it into the workspace of the arm."
            )
        found = (
            f"Target {self.row + 1} has no readings in corrected.csv: the calibrated arm differs from the nominal one, "
            f"and its nearest attainable pose is {shortfall} away{self._limit}."
        )
        if self.joint is None:
            return f"{found} Move the target into the workspace of the calibrated arm, or choose another posture."
        return (
            f"{found} There the posture is nearly singular (for example a stretched arm or aligned wrist axes): "
            f"joint {self.joint} is at {self.reading}, and the arm cannot move the flange in the missing direction. "
            f"Change the target so that joint {self.joint} is some degrees away from this position."
        )

    @property
    def _limit(self) -> str:
        if self.allowed_mm is None:
            return ""
        return (
            f"; up to {self.allowed_mm:.2g} mm would be accepted, since the uncertainty of the "
            "target is much larger"
        )


def unattainable_targets(
    arm, readings: np.ndarray, found, covariates: Mapping[str, np.ndarray] | None
) -> list[Unattainable]:
    """The first unattainable targets of a programme.

    readings (n, R) rad, mm: as programmed, or where the search began; found: the `Compensated` of the programme;
    covariates: as of `compensate`.
    """
    rows = np.flatnonzero(~found.reached & ~found.beyond_limits)[:_MOST_TARGETS]
    unattainable = []
    for row in rows:
        columns = _columns_of_row(covariates or {}, row, len(readings))
        explanation = _explained(arm, int(row), readings[row], found.poses[row], columns)
        allowed = float(negligible_mm(found.uncertainty_mm[row]))
        unattainable.append(replace(explanation, allowed_mm=allowed))
    return unattainable


def _columns_of_row(covariates: Mapping[str, np.ndarray], row: int, count: int) -> dict:
    """Covariates (count,), or the same for all rows, at one row: (1,) each."""
    return {
        name: np.atleast_1d(np.broadcast_to(values, count)[row])
        for name, values in covariates.items()
    }


def _explained(arm, row: int, start: np.ndarray, wanted: np.ndarray, covariates) -> Unattainable:
    def actual(readings):
        columns = {name: np.repeat(value, len(readings)) for name, value in covariates.items()}
        return actual_poses(arm, readings, columns)

    robot = arm.robot
    reading, error = _nearest(robot, lambda readings: nominal_poses(robot, readings), start, wanted)
    distance, degrees = _distances(error)
    if distance < 2 * _BEYOND_MM and degrees < 2 * _BEYOND_DEG:  # where the calibration may decide
        reading, error = _nearest(robot, actual, reading, wanted)
        distance, degrees = _distances(error)
    joint = singular_joint(robot, reading)
    words = "" if joint is None else reading_words(robot, reading, joint)
    return Unattainable(row, distance, degrees, joint, words)


def _nearest(robot, poses_at, start: np.ndarray, wanted: np.ndarray):
    """Readings (R,) of the attainable pose nearest to the wanted one (4, 4), and the error (6,) mm that remains.

    poses_at: function from readings (k, R) to poses (k, 4, 4). Error: position, and rotation at a lever's length.
    """
    from scipy.spatial.transform import Rotation

    scale = np.where(sliding(robot), LEVER_MM, 1.0)

    def residuals(readings):
        """(k, 6) mm of k readings."""
        poses = poses_at(readings)
        turns = Rotation.from_matrix(wanted[:3, :3].T @ poses[:, :3, :3]).as_rotvec()
        return np.concatenate([poses[:, :3, 3] - wanted[:3, 3], LEVER_MM * turns], axis=1)

    def derivative(reading):
        """(6, R) per rad, and per LEVER_MM of a slide; one call of the model for all steps."""
        steps = _STEP_RAD * np.diag(scale)
        ahead, backward = np.split(residuals(np.concatenate([reading + steps, reading - steps])), 2)
        return (ahead - backward).T / (2 * _STEP_RAD)

    nearest = least_squares(
        lambda move: residuals((start + scale * move)[None])[0],
        np.zeros(len(start)),
        jac=lambda move: derivative(start + scale * move),
        max_nfev=60,
    )
    return start + scale * nearest.x, nearest.fun


def _distances(error: np.ndarray) -> tuple[float, float]:
    """Distance, mm, and angle, deg, of an error (6,) of `_nearest`."""
    degrees = np.rad2deg(np.linalg.norm(error[3:]) / LEVER_MM)
    distance = float(np.linalg.norm(error[:3]))
    return distance, float(degrees)


def left_by_joints(arm: CalibratedArm, found) -> list[str]:
    """A sentence on what remains in the directions in which the joints cannot move the flange, or none."""
    if not found.is_deficient or not found.reached.any():
        return []
    position = found.position_left_mm[found.reached].max()
    rotation = found.rotation_left_deg[found.reached].max()
    point = corrected_point_name(arm.values)
    return [
        f"{arm.robot.mixing.shape[1]} joints do not move the tool in all six directions: the position of {point} is "
        f"corrected first, then the orientation. Up to {position:.3g} mm and {rotation:.3g} deg remain in directions "
        f"that the joints cannot move. All errors and uncertainties are those of {point}: another point of the tool, "
        f"at a distance of {LEVER_MM:g} mm from it, misses its target by up to "
        f"{LEVER_MM * np.radians(rotation):.2g} mm more."
    ]
