"""Rows with a mistake from some row on, or up to it: two sessions with different conventions were joined.

One half of the rows is free of the change, wherever it lies, or the first or the last third is as recorded. The
hand-eye transform of such a part tells for each other row whether it fits as recorded, or under each mistake undone;
the change is where most rows fit.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.checks.alternatives import Alternative
from sensors.hand_eye.checks.pose_data import PoseData, PoseFit
from sensors.hand_eye.checks.pose_fit import fit_poses

_FEWEST_ROWS = 5
_LEAST_PART = 3
_FITTING = 4.0
"""Times the misfit of the part, or of a plausible arm: rows below it fit."""
_SHARE = 0.9
_PLAUSIBLE_MM = 3.0
_FITTED = 3


@dataclass(frozen=True)
class CorrectedData:
    """All rows with one mistake undone: cause, symptom and remedy as of `Alternative`."""

    cause: str
    symptom: str
    do: str
    data: PoseData


def session_alternatives(
    data: PoseData, corrected: Iterable[CorrectedData], names
) -> Iterator[Alternative]:
    """Alternatives in which one part of the rows is as recorded and the other has a mistake undone; the best few.

    names (P,): of the rows, for the sentences.
    """
    if data.count < 2 * _FEWEST_ROWS:
        return
    versions = list(corrected)
    found = []
    for part in _sections(data.count):
        fit = fit_poses(_rows_of(data, part))
        if fit.trimmed_rms > _PLAUSIBLE_MM:
            continue
        limit = _FITTING * max(fit.trimmed_rms, _PLAUSIBLE_MM / _FITTING)
        recorded = _costs(data, fit, limit)
        for version in versions:
            change = _change(recorded, _costs(version.data, fit, limit))
            if change is not None:
                found.append((change, version))
    found.sort(key=lambda pair: pair[0].cost)
    for change, version in found[:_FITTED]:
        later = np.arange(data.count) >= change.row
        is_wrong = later if change.is_later else ~later
        moved = np.where(is_wrong[:, None, None], version.data.moved, data.moved)
        seen = np.where(is_wrong[:, None, None], version.data.seen, data.seen)
        misfit = fit_poses(replace(data, moved=moved, seen=seen)).trimmed_rms
        rows = np.flatnonzero(is_wrong)
        symptom = f"in {names[rows[0]]} to {names[rows[-1]]} alone, {version.symptom}"
        yield Alternative(version.cause, symptom, f"{version.do}, in these rows alone", misfit, 1)


def _sections(count: int) -> Iterator[np.ndarray]:
    """Row numbers of the halves, and of the outer thirds where they have enough rows."""
    rows = np.arange(count)
    yield from np.array_split(rows, 2)
    first, _, last = np.array_split(rows, 3)
    if len(last) >= _FEWEST_ROWS:
        yield from (first, last)


@dataclass(frozen=True)
class _Change:
    """First row of the later part, whether the later part is wrong, and the cost."""

    row: int
    is_later: bool
    cost: float


def _change(recorded: np.ndarray, corrected: np.ndarray) -> _Change | None:
    """The change with the least sum of costs (P,) in 0..1; None where it leaves rows that do not fit."""
    count = len(recorded)
    rows = np.arange(_LEAST_PART, count - _LEAST_PART + 1)
    before = np.concatenate([[0.0], np.cumsum(recorded)])
    before_corrected = np.concatenate([[0.0], np.cumsum(corrected)])
    later_wrong = before[rows] + before_corrected[-1] - before_corrected[rows]
    earlier_wrong = before_corrected[rows] + before[-1] - before[rows]
    costs = np.stack([later_wrong, earlier_wrong])
    side, place = np.unravel_index(int(costs.argmin()), costs.shape)
    cost = float(costs[side, place])
    if cost > (1 - _SHARE) * count or before[-1] - cost < _LEAST_PART:
        return None
    return _Change(int(rows[place]), side == 0, cost)


def _costs(data: PoseData, fit: PoseFit, limit: float) -> np.ndarray:
    """(P,) 0 for rows that lie where the fit has them, 1 for those beyond the limit in mm."""
    placed = data.moved @ fit.sensor[0] @ data.seen
    where = placed[..., :3, :3] @ data.corners + placed[..., :3, 3:]
    target = fit.board[0][:3, :3] @ data.corners + fit.board[0][:3, 3:]
    squares = ((where - target) ** 2).sum((2, 3)) / data.corners.shape[1]
    return np.minimum(squares.min(0) / limit**2, 1.0)


def _rows_of(data: PoseData, rows: np.ndarray) -> PoseData:
    return PoseData(data.moved[rows], data.seen[:, rows], data.corners)
