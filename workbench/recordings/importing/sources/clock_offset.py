"""The offset between the clocks of a joint log and of an instrument, estimated from the motion of the arm.

A point measured at time t of one clock belongs to the joint readings at t + tau of the other clock. The residual of the
static fit (base, tool, geometry with its prior) is linear in a small tau: r = tau v, where v is the velocity of the
measured point, J qdot. Weighted least squares gives tau together with corrections of all parameters of the fit and a
backlash of each joint; the rows are then interpolated again at the new offset (Gauss-Newton).

Residuals of neighbouring rows are correlated wherever an effect is not modelled. The standard deviation of tau is
therefore cluster-robust, with blocks of consecutive rows as clusters (Cameron & Miller, A practitioner's guide to
cluster-robust inference, J. Human Resources 50 (2015), eq. 9).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import joint_columns
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import (
    Fit,
    fit_recording,
    geometry_prior,
    nominal_scale,
    row_residual,
)
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.sampling import even_rows

_SIGMAS = 3.0
_BLOCKS = 25
_LEAST_ROWS = 25
_MOST_STEPS, _HALVINGS = 12, 4
_CONVERGED = 0.05  # of the standard deviation
_SMALL = 2.0
_MOVING = 1e-3  # of the range of a joint, over two sampling intervals
_STEP_RAD, _STEP_MM = 1e-4, 1e-1  # of a reading; columns are per _STEP_RAD either way
_CAUCHY = 2.5
MOST_SCANNED_S = 2.0
_SCANNED_S = np.linspace(-MOST_SCANNED_S, MOST_SCANNED_S, 41)
_SCANNED_ROWS = 100
_SCAN_GAIN = 0.5


@dataclass(frozen=True)
class TimedRows:
    """A recording (n rows) at one offset, and the numbers (n,) of its rows in the table that keeps its times."""

    recording: Recording
    lines: np.ndarray

    def take(self, lines: np.ndarray) -> Recording:
        """The rows with the given numbers, which all exist."""
        return self.recording.select(np.flatnonzero(np.isin(self.lines, lines)))


RowsAt = Callable[[float], TimedRows]
"""The rows at an offset in s. Raises InputError where the clocks do not overlap."""


@dataclass(frozen=True)
class OffsetEstimate:
    """The estimated offset and what it changes; all RMS values are of the length of a row's position residual.

    `seconds`: to add to the times of the shorter table; `sigma_s`: standard deviation, inf where the arm stands still.
    `effect_mm`: RMS displacement of the points by the change of the offset. `before_mm`, `after_mm`: RMS of the best
    90 % of the residuals at the offset of the start and at the estimate.
    """

    start_s: float
    seconds: float
    sigma_s: float
    effect_mm: float
    before_mm: float
    after_mm: float

    @property
    def change_s(self) -> float:
        """Estimated offset less that of the start, s."""
        return self.seconds - self.start_s

    @property
    def is_significant(self) -> bool:
        """Whether the change of the offset is larger than three standard deviations."""
        return abs(self.change_s) > _SIGMAS * self.sigma_s

    @property
    def is_visible(self) -> bool:
        """Whether it is significant and displaces the points by more than the residuals that remain."""
        return self.is_significant and self.effect_mm > self.after_mm


@dataclass(frozen=True)
class _State:
    """The robust fit of the rows at one offset."""

    seconds: float
    rows: TimedRows
    fit: Fit

    @property
    def misfit(self) -> float:
        return float(self.fit.mismatch.mean())


def estimate_offset(
    candidates: Sequence[tuple[Robot, RowsAt]], start_s: float, step_s: float
) -> OffsetEstimate | None:
    """The offset under the robot and the units that fit best; None where nothing fits or rows are too few.

    candidates: robots with the rows under one reading of the columns each. start_s: offset to start from; step_s:
    median sampling interval of the log, over which its slope is taken.
    """
    try:
        robot, rows_at = min(candidates, key=lambda candidate: _quick(*candidate, start_s))
        return _Estimator(robot, rows_at, step_s).estimate(start_s)
    except (np.linalg.LinAlgError, InputError):
        return None


def _quick(robot: Robot, rows_at: RowsAt, seconds: float) -> float:
    """mm of misfit with the nominal geometry at an offset; inf where it cannot be computed."""
    try:
        recording = rows_at(seconds).recording
        thinned = recording.select(even_rows(recording, _SCANNED_ROWS))
        return nominal_scale(robot, thinned)
    except (np.linalg.LinAlgError, InputError):
        return np.inf


@dataclass(frozen=True)
class _Estimator:
    robot: Robot
    rows_at: RowsAt
    step_s: float

    def estimate(self, start_s: float) -> OffsetEstimate | None:
        first = self.state(start_s, None)
        if len(first.rows.lines) < _LEAST_ROWS:
            return None
        state = first
        if first.fit.core > good_scale(self.robot, first.rows.recording):
            state = self.state(self.scanned(start_s), None)
        state, sigma, speed = self.refined(state)
        if state.fit.core > good_scale(self.robot, state.rows.recording):
            return None
        effect = abs(state.seconds - start_s) * speed
        seconds = state.seconds if np.isfinite(sigma) else start_s
        return OffsetEstimate(
            start_s, seconds, sigma, effect, first.fit.position_mm, state.fit.position_mm
        )

    def state(self, seconds: float, values: np.ndarray | None) -> _State:
        rows = self.rows_at(seconds)
        return _State(seconds, rows, fit_recording(self.robot, rows.recording, values))

    def scanned(self, start_s: float) -> float:
        """The offset of a coarse scan that fits clearly best, for clocks that differ by up to seconds."""
        offsets = start_s + _SCANNED_S
        misfits = [_quick(self.robot, self.rows_at, offset) for offset in offsets]
        quick = _quick(self.robot, self.rows_at, start_s)
        is_clear = min(misfits) < _SCAN_GAIN * quick
        if is_clear:
            return float(offsets[int(np.argmin(misfits))])
        return start_s

    def refined(self, state: _State) -> tuple[_State, float, float]:
        """Gauss-Newton: the last state, the standard deviation of its offset in s, and the speed in mm/s."""
        change, sigma, speed = self.regress(state)
        for _ in range(_MOST_STEPS):
            if not np.isfinite(sigma) or abs(change) < _CONVERGED * sigma:
                break
            moved = self.improved(state, change, speed)
            if moved is None:
                break
            state = moved
            change, sigma, speed = self.regress(state)
        return state, sigma, speed

    def improved(self, state: _State, change: float, speed: float) -> _State | None:
        """The state after the change, or after a half, quarter ... of it; None where the misfit does not fall.

        A change that displaces the points by less than twice the residual is taken: the regression is linear there, and
        the misfit may rise, because the fit of the state holds no backlash.
        """
        is_small = abs(change) * speed < _SMALL * state.fit.position_mm
        for _ in range(_HALVINGS):
            moved = self.state(state.seconds + change, state.fit.parameters.values)
            if is_small or moved.misfit < state.misfit:
                return moved
            change /= 2
        return None

    def regress(self, state: _State) -> tuple[float, float, float]:
        """Change of the offset (s), its standard deviation (s), and RMS speed that no parameter explains (mm/s)."""
        shifted_rows = [self.rows_at(state.seconds + side * self.step_s) for side in (-1, 1)]
        lines = reduce(np.intersect1d, [state.rows.lines, *(rows.lines for rows in shifted_rows)])
        first, last = (rows.take(lines) for rows in shifted_rows)
        before, after = (
            row_residual(self.robot, recording, state.fit) for recording in (first, last)
        )
        velocity = (after - before) / (2 * self.step_s)
        rows_of_lines = np.flatnonzero(np.isin(state.rows.lines, lines))
        backlash = _direction_columns(
            self.robot,
            state.rows.recording.select(rows_of_lines),
            state.fit,
            last.joints - first.joints,
        )
        return _offset_of(
            self.robot, state.rows.recording, state.fit, rows_of_lines, _Motion(velocity, backlash)
        )


@dataclass(frozen=True)
class _Motion:
    """Derivatives of the residual by the offset, (m, n) mm/s, and by an error of each joint in the direction of its
    motion, (R, m, n) mm/rad."""

    velocity: np.ndarray
    backlash: np.ndarray


def _direction_columns(robot, recording, fit: Fit, moves: np.ndarray) -> np.ndarray:
    """(R, m, n) derivatives by readings that are off in the direction of motion; moves (n, R) of the readings.

    Such an error, as of backlash, is nearly proportional to the speed where speeds are alike. Without these columns it
    would pass for an offset of the clocks.
    """
    min_move = _MOVING * np.maximum(np.ptp(recording.joints, axis=0), 1e-12)
    directions = np.where(np.abs(moves) > min_move, np.sign(moves), 0.0)
    names = joint_columns(recording.columns)
    residual = row_residual(robot, recording, fit)
    columns = []
    for name, direction in zip(names, directions.T):
        step = _STEP_MM if name.endswith("_mm") else np.rad2deg(_STEP_RAD)
        shifted = {**recording.columns, name: recording.columns[name] + step * direction}
        moved = row_residual(robot, replace(recording, columns=shifted), fit)
        columns.append((moved - residual) / _STEP_RAD)
    return np.array(columns)


def _offset_of(
    robot, recording, fit: Fit, rows_of_lines, motion: _Motion
) -> tuple[float, float, float]:
    """`_Estimator.regress` of the kept rows (n,) of a fit."""
    velocity = motion.velocity
    free = fit.parameters.mask
    prior = geometry_prior(robot, recording, fit.parameters)[free]
    residual, columns = fit.model.linearise(fit.parameters)
    residual = residual[:, rows_of_lines]
    columns = columns[:, :, rows_of_lines]
    squares = (residual**2).sum(0)
    size = float(np.median(squares)) / len(residual)
    if size == 0 or not velocity.any():
        return 0.0, np.inf, 0.0
    weight = 1 / (size + squares / (len(residual) * _CAUCHY**2))
    number = len(motion.backlash)
    precision = np.concatenate([prior**-2.0, np.zeros(number)])
    weighted = _Weighted(np.concatenate([columns, motion.backlash]), weight, precision)
    apparent = weighted.projected(velocity)
    information = float((weight * apparent * velocity).sum())
    if information <= 0:
        return 0.0, np.inf, 0.0
    deviation = fit.deviations * np.where(np.isfinite(prior), prior, 0.0)
    pull = np.concatenate([prior**-2.0 * deviation, np.zeros(number)])
    pulled = weighted.slopes(velocity) @ pull
    change = -float((weight * apparent * residual).sum() - pulled) / information
    remainder = weighted.projected(residual + change * velocity)
    scores = (weight * apparent * remainder).sum(0)
    sigma = _clustered(scores) / information
    moved = _Weighted(columns, weight, prior**-2.0).projected(velocity)
    speed = float(np.sqrt((moved**2).sum(0).mean()))
    return change, sigma, speed


@dataclass(frozen=True)
class _Weighted:
    """Derivatives (F, m, n) of the residual with weights (n,) and prior precisions (F,) of the parameters."""

    columns: np.ndarray
    weight: np.ndarray
    precision: np.ndarray

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """(F,) coefficients of the columns that explain values (m, n) best."""
        flat = self.columns.reshape(len(self.columns), -1)
        root = np.broadcast_to(np.sqrt(self.weight), values.shape).ravel()
        scaled = flat * root
        normal = scaled @ scaled.T + np.diag(self.precision)
        scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-12))
        right = scaled @ (root * values.ravel())
        return (
            scale * np.linalg.lstsq(normal * np.outer(scale, scale), scale * right, rcond=1e-12)[0]
        )

    def projected(self, values: np.ndarray) -> np.ndarray:
        """(m, n) values less what the columns explain."""
        return values - np.tensordot(self.slopes(values), self.columns, 1)


def _clustered(scores: np.ndarray) -> float:
    """Standard deviation of the sum of scores (n,): the larger of that of blocks and that of independent rows."""
    blocks = [block.sum() for block in np.array_split(scores, min(_BLOCKS, len(scores)))]
    correction = len(blocks) / (len(blocks) - 1)
    of_blocks = correction * np.sum(np.square(blocks))
    return float(np.sqrt(max(of_blocks, np.sum(scores**2))))
