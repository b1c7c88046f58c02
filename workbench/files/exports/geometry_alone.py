"""Geometry that replaces the complete model in formats that hold geometry alone.

Geometry and effects are estimated together, and their errors can cancel: a zero offset holds the opposite of a
transmission error, for example. The calibrated geometry without the effects is then worse than the geometry could be.
For such formats the geometry is fitted again, to the flange poses of the complete model within the recorded ranges.
"""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import ALPHA, BETA, A, D, forward, geometry_rotations, geometry_rows
from robot_model.measurements.closure import flange_matrices
from robot_model.postures.task_priority import LEVER_MM, Task, pose_difference
from robot_model.state import reading_names, sliding
from workbench.core.rigid import transform
from workbench.files.exports.mdh import NAMES, calibrated_geometry
from workbench.files.exports.python.module import arm_data, covariates_used, observed_effects
from workbench.files.exports.python.runtime import CorrectedArm
from workbench.files.solution_file import CalibratedArm

_POSES = 400
"""Poses of the fit: ten for each of the 30 parameters of six joints, and a third more."""
_UNRECORDED_DEG, _UNRECORDED_MM = 90.0, 100.0
"""Half of the range of a joint reading that an older solution.json does not state."""
_TYPICAL_MM, _TYPICAL_RAD = 1.0, 1e-3
"""Typical size of an error of geometry, by which lengths and angles are compared."""
_PRICE_MM = 1e-3
"""RMS position error that a change by one typical size must save: it keeps parameters that hardly act."""
_STEPS, _SMALL_STEP = 20, 1e-9


@dataclass(frozen=True)
class GeometryFit:
    """`arm`: the calibrated arm with the fitted geometry (its effects stay listed).

    `before_mm`: RMS distance of the calibrated geometry without effects from the complete model, at the tool.
    `rms_mm`, `largest_mm`: the same of the fitted geometry.
    """

    arm: CalibratedArm
    before_mm: float
    rms_mm: float
    largest_mm: float

    @property
    def sentence(self) -> str:
        """Limitation of a file with this geometry, for the user."""
        return (
            "This format holds geometry alone. The geometry was fitted to the complete model within the recorded "
            f"ranges and differs from it by {self.rms_mm:.3g} mm RMS (largest {self.largest_mm:.3g} mm) at the tool; "
            f"the calibrated geometry without the other terms would differ by {self.before_mm:.3g} mm. "
            "`--to python` holds all terms."
        )


def fit_geometry(arm: CalibratedArm, is_held: np.ndarray | None = None) -> GeometryFit | None:
    """The geometry whose flange poses are nearest to those of the complete model; None without effects.

    held (J, 5) bool: entries of theta, d, a, alpha, beta that the format can hold; None for all of them.
    Least squares of position at the tool (mm) and of rotation at a lever of 200 mm, with a weak penalty on changes,
    since some parameters have the same effect as others.
    """
    if not arm.acting_effects:
        return None
    readings = _readings(arm)
    start = calibrated_geometry(arm)
    problem = _Problem(arm, readings, _complete_poses(arm, readings))
    fitted = problem.fitted(start, np.ones(start.shape, bool) if is_held is None else is_held)
    before = problem.distances(start)
    after = problem.distances(fitted)
    values = dict(arm.values)
    for k, row in enumerate(fitted, 1):
        values |= {f"joint-{k}.{name}{k}": float(value) for name, value in zip(NAMES, row)}
    return GeometryFit(replace(arm, values=values), _rms(before), _rms(after), float(after.max()))


def held_by_ur_kinematics(arm: CalibratedArm) -> np.ndarray:
    """(J, 5) bool: all but length and twists between the last axis and the flange."""
    is_held = np.ones(arm.robot.geometry.shape, bool)
    is_held[-1, [A, ALPHA, BETA]] = False
    return is_held


@dataclass(frozen=True)
class _Problem:
    """Readings (n, R) in rad, mm; `wanted` (n, 4, 4) T_root_flange of the complete model."""

    arm: CalibratedArm
    readings: np.ndarray
    wanted: np.ndarray

    def fitted(self, start: np.ndarray, is_held: np.ndarray) -> np.ndarray:
        """(J, 5) by damped Gauss-Newton from `start`; only entries of `held` change."""
        port_indices = np.flatnonzero(is_held.ravel())
        scale = np.where(np.isin(port_indices % 5, (D, A)), _TYPICAL_MM, _TYPICAL_RAD)
        penalty = _PRICE_MM**2 * len(self.readings) * np.eye(len(port_indices))
        change = np.zeros(len(port_indices))
        for _ in range(_STEPS):
            rows, error = self._linearised(
                _moved(start, port_indices, change * scale), port_indices
            )
            rows = rows * scale
            normal = rows.T @ rows + penalty
            step = np.linalg.solve(normal, -rows.T @ error - penalty @ change)
            change += step
            if np.abs(step).max() < _SMALL_STEP:
                break
        return _moved(start, port_indices, change * scale)

    def distances(self, geometry: np.ndarray) -> np.ndarray:
        """(n,) mm between the tool of this geometry and that of the complete model."""
        error = pose_difference(_poses(self._frames(geometry)), self.wanted, self._point)
        return np.linalg.norm(error[:3], axis=0)

    @property
    def _point(self) -> np.ndarray:
        return Task.of(self.arm.robot, self.arm.values).point

    def _frames(self, geometry):
        return forward(self.arm.robot, self.arm.robot.mixing @ self.readings.T, geometry)

    def _linearised(self, geometry, port_indices):
        """(6 n, K) derivatives and (6 n,) errors: position (mm), then rotation at the lever (mm)."""
        frames = self._frames(geometry)
        shifts = geometry_rows(self.arm.robot, frames, frames.point(self._point), port_indices)
        rotations = LEVER_MM * geometry_rotations(frames, port_indices)
        rows = np.concatenate([shifts, rotations], 1).reshape(len(port_indices), -1)
        error = pose_difference(_poses(frames), self.wanted, self._point)
        return rows.T, np.concatenate([error[:3], LEVER_MM * error[3:]]).ravel()


def _moved(geometry: np.ndarray, port_indices: np.ndarray, change: np.ndarray) -> np.ndarray:
    moved = geometry.ravel().copy()
    moved[port_indices] += change
    return moved.reshape(geometry.shape)


def _readings(arm: CalibratedArm) -> np.ndarray:
    """(n, R) rad, mm: uniform over the recorded range of each joint reading."""
    slides = sliding(arm.robot)
    names = reading_names(arm.robot)
    recorded = arm.fitted_range or {}
    halves = np.where(slides, _UNRECORDED_MM, _UNRECORDED_DEG)
    ends = [recorded.get(name, (-half, half)) for name, half in zip(names, halves)]
    low, high = np.array(ends).T
    drawn = np.random.default_rng(0).uniform(low, high, (_POSES, len(names)))
    return np.where(slides, drawn, np.deg2rad(drawn))


def _complete_poses(arm: CalibratedArm, readings: np.ndarray) -> np.ndarray:
    """(n, 4, 4) T_root_flange with all effects, at the middle of the recorded range of every covariate."""
    model = CorrectedArm(arm_data(arm), arm.acting_effects, observed_effects(arm))
    ranges = arm.fitted_range or {}
    covariates = {name: sum(ranges.get(name, (0.0, 0.0))) / 2 for name in covariates_used(arm)}
    shown = np.where(sliding(arm.robot), readings, np.rad2deg(readings))
    return model.flange_poses(shown, covariates)


def _poses(frames) -> np.ndarray:
    return transform(flange_matrices(frames), frames.end_origin.T)


def _rms(distances: np.ndarray) -> float:
    return float(np.sqrt((distances**2).mean()))
