"""Rows in which a single value is wrong: one column, or how far the arm had come when its joints were read.

One unknown a row is estimated along a path of joint readings, or one measured coordinate is left out. The other
components of the residual then have to vanish, which they do not by chance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.samples.columns import POINT, joint_columns
from workbench.fitting.plausibility.fitting import FAILURES, Fit, row_residual
from workbench.fitting.plausibility.rows.group_corrections import LEAST_ROWS, RowsWithTargets
from workbench.fitting.plausibility.rows.row_groups import MIN_SHARE, Reason

_TURN = np.arange(-180.0, 180.0, 10.0)
_SHARES = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7])
_LARGEST_SHARE = 0.8
"""Nearer to the neighbouring pose a row holds the readings of that pose."""
_STEPS, _SWEEPS, _SMALL = 8, 4, 1e-4
_HALF_TURN_DEG = 0.5
_CONSTANT = 0.02
"""Median deviation of the corrections, relative to their size, below which they are one correction of all rows."""


def wrong_coordinate(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The rows fit but for one measured coordinate.

    rows: numbers of the outlying rows. limit: mismatch in mm below which a row fits.
    """
    if not set(POINT) <= set(recording.columns) or len(rows) < LEAST_ROWS:
        return None
    residual = row_residual(robot, recording, fit)[:, rows]
    for k, name in enumerate(POINT):
        others = np.delete(residual, k, axis=0)
        fits = np.sqrt((others**2).sum(0)) < limit
        if fits.mean() > MIN_SHARE and not _is_constant(residual[k, fits]):
            values = recording.columns[name]
            return Reason(
                f"they fit but for column {name}{_pattern(values, rows, recording)}; the other columns of these rows "
                "fit",
                "column-values",
            )
    return None


def wrong_reading(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The rows fit with another reading of one joint."""
    if len(rows) < LEAST_ROWS:
        return None
    selection = RowsWithTargets.of(recording, rows)
    for name in joint_columns(recording.columns):
        if not name.endswith("_deg"):
            continue
        solved = _solved(robot, selection, fit, _along_column(selection.recording, name), _TURN)
        if solved is None:
            continue
        fits = solved.mismatch < limit
        if not fits.mean() > MIN_SHARE:
            continue
        if _is_half_turn(solved.values[fits]) or not _is_absorbed(robot, name, solved.values[fits]):
            return _of_readings(recording, rows, name, solved, fits)
    return None


def moving_arm(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The readings of the rows lie on the way from or to a neighbouring pose: they were read while the arm moved."""
    if len(rows) < LEAST_ROWS:
        return None
    for step, words in ((-1, "before the arm had arrived"), (1, "after the arm had left")):
        corrected = _arrived(robot, recording, fit, rows, step)
        if corrected is None:
            continue
        solved, has_neighbour = corrected
        fits = (solved.mismatch < limit) & has_neighbour & (solved.values > 0)
        if fits.mean() > MIN_SHARE:
            left = 100 * solved.values[fits]
            neighbour = "from the pose before" if step < 0 else "to the next pose"
            return Reason(
                f"their joint readings lie on the way {neighbour}, {left.min():.2g} to {left.max():.2g} % of it from "
                f"their own pose: they were recorded {words}; record them while the arm stands still",
                "moving-arm",
            )
    return None


@dataclass(frozen=True)
class _Solved:
    """Value of the unknown and the mismatch in mm that it leaves, (k,) each, of the rows that are asked for."""

    values: np.ndarray
    mismatch: np.ndarray


def _along_column(recording, name: str) -> Callable[[np.ndarray], object]:
    """The recording with a number of degrees added to one joint column."""
    return lambda added: replace(
        recording, columns={**recording.columns, name: recording.columns[name] + added}
    )


def _solved(
    robot, selection: RowsWithTargets, fit: Fit, moved: Callable, grid: Sequence[float]
) -> _Solved | None:
    """The unknown of each row, least squares: the best of a grid, then Gauss-Newton steps that lower the mismatch."""
    try:
        residuals = np.array(
            [row_residual(robot, moved(np.full(selection.recording.n, s)), fit) for s in grid]
        )
        best = (residuals**2).sum(1).argmin(0)
        columns = np.arange(selection.recording.n)
        values = np.asarray(grid, float)[best]
        residual = residuals[best, :, columns].T
        for _ in range(_STEPS):
            slope = (row_residual(robot, moved(values + _SMALL), fit) - residual) / _SMALL
            step = -(residual * slope).sum(0) / np.maximum((slope**2).sum(0), 1e-12)
            tried = row_residual(robot, moved(values + step), fit)
            is_better = (tried**2).sum(0) < (residual**2).sum(0)
            values = np.where(is_better, values + step, values)
            residual = np.where(is_better, tried, residual)
    except FAILURES:
        return None
    mismatch = np.sqrt((residual**2).sum(0))
    return _Solved(values[selection.is_asked], mismatch[selection.is_asked])


def _arrived(robot, recording, fit: Fit, rows, step: int) -> tuple[_Solved, np.ndarray] | None:
    """The share of the way to the neighbouring pose at which each row was read, and which rows have a neighbour.

    The neighbour may itself have been read on its way, so that shares and poses are estimated in turn.
    """
    source = _neighbouring_pose(recording, step)
    names = joint_columns(recording.columns)
    readings = _readings(recording, names)
    places, solved = readings.copy(), None
    selection = RowsWithTargets.of(recording, rows)
    chosen = np.flatnonzero(np.isin(recording.sample_ids, selection.recording.sample_ids))
    for _ in range(_SWEEPS):
        start, end = readings[:, chosen], places[:, source[chosen]]

        def moved(share, start=start, end=end):
            kept = np.clip(share, 0.0, _LARGEST_SHARE)
            places_of_rows = (start - kept * end) / (1 - kept)
            columns = {**selection.recording.columns, **dict(zip(names, places_of_rows))}
            return replace(selection.recording, columns=columns)

        solved = _solved(robot, selection, fit, moved, _SHARES)
        if solved is None:
            return None
        share = np.clip(solved.values, 0.0, _LARGEST_SHARE)
        places[:, rows] = (readings[:, rows] - share * places[:, source[rows]]) / (1 - share)
    return solved, source[rows] != rows


def _readings(recording, names: Sequence[str]) -> np.ndarray:
    """(J, n) in the units of the columns."""
    return np.stack([recording.columns[name] for name in names])


def _neighbouring_pose(recording, step: int) -> np.ndarray:
    """(n,) row of the pose before or after each row; the row itself where there is none."""
    is_new = np.any(np.diff(recording.joints, axis=0) != 0, axis=1)
    pose = np.concatenate([[0], np.cumsum(is_new)])
    first = np.searchsorted(pose, np.arange(pose[-1] + 1))
    wanted = pose + step
    has_neighbour = (wanted >= 0) & (wanted <= pose[-1])
    return np.where(has_neighbour, first[np.clip(wanted, 0, pose[-1])], np.arange(recording.n))


def _is_constant(corrections: np.ndarray) -> bool:
    """Whether the rows have one correction in common: another station or tool does that to a coordinate, too."""
    middle = float(np.median(corrections))
    return float(np.median(np.abs(corrections - middle))) <= _CONSTANT * abs(middle)


def _is_absorbed(robot, name: str, corrections: np.ndarray) -> bool:
    """Whether a common correction of a joint is another pose of base or tool: of the first and of the last joint."""
    number = int(name[1:].partition("_")[0])
    return number in (1, robot.mixing.shape[1]) and _is_constant(corrections)


def _is_half_turn(corrections: np.ndarray) -> bool:
    """Whether all corrections in degrees are half a turn, which another tool or station is by chance only."""
    from_half = (corrections % 360.0) - 180.0
    return bool(np.abs(from_half).max() < _HALF_TURN_DEG)


def _of_readings(recording, rows, name: str, solved: _Solved, fits: np.ndarray) -> Reason:
    """One correction of all rows is a zero that has moved, which is no mistake of the table; others are."""
    added = solved.values[fits]
    if _is_half_turn(added):
        sentence = (
            f"they fit with 180 deg added to column {name}: its readings are folded into half a turn, or tool or "
            "target were mounted turned by half a turn in these rows"
        )
        return Reason(sentence, "joint-offset")
    if _is_constant(added):
        sentence = (
            f"they fit with {np.median(added):+.4g} deg added to column {name}: the zero of this joint is another one "
            "in these rows"
        )
        return Reason(sentence, "moved", False)
    pattern = _pattern(recording.columns[name], rows, recording)
    sentence = f"they fit with other values in column {name} alone{pattern}; the other columns of these rows fit"
    return Reason(sentence, "column-values")


def _pattern(values: np.ndarray, rows, recording) -> str:
    """What the values (n,) of a column look like in some rows; "" where nothing stands out."""
    first = int(rows[0])
    last = int(rows[-1])
    block = values[first : last + 1]
    ids = recording.sample_ids
    where = f"from sample {ids[first]} to {ids[last]}"
    if len(block) < LEAST_ROWS + 1:
        return ""
    size = max(float(np.abs(block).max()), 1e-9)
    if np.ptp(block) <= 1e-9 * size:
        return f", which holds one value {where}, as of a copied cell"
    if np.abs(np.diff(block, 2)).max() <= 1e-5 * size:
        return f", whose values {where} have equal steps, as of a cell that was dragged in a spreadsheet"
    return ""


__all__ = ["moving_arm", "wrong_coordinate", "wrong_reading"]
