"""Division of the rows of a table into segments that need different readings of its columns.

A block of rows that fits a robot under one reading determines base, tool and geometry (an anchor). Every row is then
compared under every reading at these values. The division with the least cost has a penalty for every change
(optimal partitioning; Jackson et al., IEEE Signal Processing Letters 12, 2005). Rows that fit no reading of the first
anchor may have an anchor of their own: the instrument or the target was set up again.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import Fit, fit_recording, row_mismatch
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.sampling import even_rows
from workbench.recordings.importing.interpretation.fits import compare_readings

_FEWEST_ROWS = 10
_BLOCK_COUNTS = (1, 2, 3, 4, 6)
_MOST_ANCHORS = 3
_REFINED = 2
_FIT_ROWS = 100
_FITTING, _FITTING_SHARE = 3.0, 0.95
_MOST_OFF_SHARE = 0.2
_MOST_COST = 9.0
_PREFERRED = 0.99
_CHANGE_COST = 8.0
"""Of a change from one reading to another: a segment has at least two rows at an end, three between others."""

Screen = Callable[[np.ndarray], Sequence[int]]
"""Indices of the readings that rows (k,) may have."""


@dataclass(frozen=True)
class Segment:
    """Rows `first` to `last` (both included) under the reading `reading`, with the frames of anchor `anchor`."""

    first: int
    last: int
    reading: int
    anchor: int


@dataclass(frozen=True)
class _Anchor:
    """A reading that fits a block of rows, with base, tool and geometry of the block."""

    reading: int
    fit: Fit


def find_segments(
    robot: Robot,
    readings: Sequence[tuple[str, Recording]],
    variants: Callable[[int], Sequence[Recording]],
    screen: Screen | None = None,
) -> tuple[list[Segment], list[Recording]]:
    """Segments that fit the robot, and the recordings that `Segment.reading` counts; () and [] where none are found.

    readings: title and recording of all rows, of every unit and convention. variants: further recordings of a reading,
    such as one with an inverted column, which are tested for single segments only. screen: the readings that
    a block of rows may have; None for all.
    """
    count = readings[0][1].n
    recordings: list[Recording] = []
    costs: list[np.ndarray] = []
    anchors: list[_Anchor] = []
    open_rows = np.arange(count)
    while len(anchors) < _MOST_ANCHORS and len(open_rows) >= _FEWEST_ROWS:
        anchor = _find_anchor(robot, readings, open_rows, screen)
        if anchor is None:
            break
        if not anchors:
            recordings = [reading for _, reading in readings] + list(variants(anchor.reading))
        anchors.append(anchor)
        costs.append(_row_costs(robot, recordings, anchor))
        open_rows = _longest_open(np.min(np.concatenate(costs), axis=0) >= _PREFERRED * _MOST_COST)
    if not anchors:
        return [], []
    labels = least_cost_labels(np.concatenate(costs))
    segments = segments_of(labels, len(recordings))
    if len(segments) < 2 or not _is_explained(robot, recordings, segments):
        return [], []
    return segments, recordings


def least_cost_labels(costs: np.ndarray, change: float = _CHANGE_COST) -> np.ndarray:
    """(n,) label of each row with the least sum of costs (k, n) and of `change` for every change of label."""
    labels, count = costs.shape
    total = costs[:, 0].copy()
    came_from = np.zeros((labels, count), int)
    for row in range(1, count):
        best = int(total.argmin())
        stays = total <= total[best] + change
        came_from[:, row] = np.where(stays, np.arange(labels), best)
        total = np.where(stays, total, total[best] + change) + costs[:, row]
    path = np.empty(count, int)
    path[-1] = int(total.argmin())
    for row in range(count - 1, 0, -1):
        path[row - 1] = came_from[path[row], row]
    return path


def _find_anchor(robot: Robot, readings, rows: np.ndarray, screen) -> _Anchor | None:
    """The reading that fits some block of rows, the largest block first; None where none fits."""
    for block in _blocks(rows):
        candidates = range(len(readings)) if screen is None else screen(block)
        block_readings = [(readings[k][0], readings[k][1].select(block)) for k in candidates]
        for place, found in compare_readings(robot, block_readings, _REFINED, is_good_only=True)[
            :1
        ]:
            if not found.is_good:
                continue
            chosen = block_readings[place][1]
            fit = fit_recording(robot, chosen.select(even_rows(chosen, _FIT_ROWS)))
            # the robust fit of a block may be good although half of the rows are wrong
            is_off = row_mismatch(robot, chosen, fit) > _FITTING * good_scale(robot, chosen)
            if is_off.mean() <= _MOST_OFF_SHARE:
                return _Anchor(int(candidates[place]), fit)
    return None


def _blocks(rows: np.ndarray) -> Iterator[np.ndarray]:
    """Neighbouring rows: all, halves, thirds and smaller parts, as far as they can be fitted."""
    for block_count in _BLOCK_COUNTS:
        if len(rows) // block_count >= _FEWEST_ROWS:
            yield from np.array_split(rows, block_count)


def _row_costs(robot: Robot, recordings: Sequence[Recording], anchor: _Anchor) -> np.ndarray:
    """(k, n) squared mismatch of the rows under every reading, in units of that of a sound arm, bounded.

    The reading of the anchor costs a little less, so that it is kept where readings agree.
    """
    good = good_scale(robot, recordings[anchor.reading])
    costs = np.full((len(recordings), recordings[0].n), _MOST_COST)
    for k, recording in enumerate(recordings):
        try:
            mismatch = row_mismatch(robot, recording, anchor.fit)
        except (np.linalg.LinAlgError, InputError, ValueError):
            continue
        costs[k] = np.minimum((mismatch / good) ** 2, _MOST_COST)
    costs[anchor.reading] *= _PREFERRED
    return costs


def _longest_open(is_open: np.ndarray) -> np.ndarray:
    """The longest run of neighbouring rows that fit nothing, as row numbers."""
    places = np.flatnonzero(is_open)
    runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return max(runs, key=len)


def segments_of(labels: np.ndarray, count: int) -> list[Segment]:
    """Runs of equal labels; count: of the recordings of one anchor."""
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    ends = [*(starts[1:] - 1), len(labels) - 1]
    return [
        Segment(int(first), int(last), int(labels[first] % count), int(labels[first] // count))
        for first, last in zip(starts, ends)
    ]


def _is_explained(robot: Robot, recordings, segments: Sequence[Segment]) -> bool:
    """Whether nearly all rows of every anchor fit the robot together, each segment under its reading."""
    for anchor in {segment.anchor for segment in segments}:
        segments_of_anchor = [segment for segment in segments if segment.anchor == anchor]
        joined = joined_segments(recordings, segments_of_anchor)
        good = good_scale(robot, joined)
        try:
            fit = fit_recording(robot, joined.select(even_rows(joined, _FIT_ROWS)))
            is_close = row_mismatch(robot, joined, fit) < _FITTING * good
        except (np.linalg.LinAlgError, InputError, ValueError):
            return False
        if fit.core > good or is_close.mean() < _FITTING_SHARE:
            return False
    return True


def joined_segments(recordings: Sequence[Recording], segments: Sequence[Segment]) -> Recording:
    """The rows of segments, each under its reading."""
    segments_of_rows = [
        recordings[segment.reading].select(np.arange(segment.first, segment.last + 1))
        for segment in segments
    ]
    names = [
        name
        for name in segments_of_rows[0].columns
        if all(name in part.columns for part in segments_of_rows)
    ]
    columns = {
        name: np.concatenate([part.columns[name] for part in segments_of_rows]) for name in names
    }
    return replace(segments_of_rows[0], columns=columns)
