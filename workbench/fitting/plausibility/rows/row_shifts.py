"""Measurements that are late or early against the joint readings from some row on.

One of the two halves of the rows has a single shift, wherever the change lies. It determines base, tool and geometry;
every row is then compared under every shift, and the change is where the sum of the mismatches is smallest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.fitting.plausibility.fitting import FAILURES, fit_recording, row_mismatch
from workbench.fitting.plausibility.hypotheses.corrections import observed_columns
from workbench.fitting.plausibility.hypotheses.row_corrections import (
    place_of_measurement,
    shift_steps,
)
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.suspicion import Suspicion

_ROWS = 100
_FEWEST_ROWS = 10
_FITTING = 3.0
_NEARLY_ALL = 0.95
_LEAST_PART = 3
_SAME_COST = 0.3
"""A row that does not fit costs 1."""


@dataclass(frozen=True)
class _Change:
    """Rows below `row` have their measurement `before` rows below, the others `after` rows below."""

    row: int
    before: int
    after: int


def row_shift_suspicions(robot, recording, scale_of_good_fit: float) -> list[Suspicion]:
    """A suspicion that names the row at which measurements begin to be displaced; [] where nothing does.

    good: mm of a good fit.
    """
    names = observed_columns(recording)
    if recording.measures == "distance" or not names or recording.n < 2 * _FEWEST_ROWS:
        return []
    steps = (0, *shift_steps(recording))
    moved = [_displaced(recording, names, step) for step in steps]
    for half in np.array_split(np.arange(recording.n), 2):
        for shifted in moved:
            change = _change_from(robot, moved, steps, shifted.select(half), scale_of_good_fit)
            if change is not None:
                return [_suspicion(recording, change)]
    return []


def _displaced(recording, names: Sequence[str], step: int):
    """The recording with the measurements of `step` rows below; the rows at the end keep that of the last row."""
    source = np.clip(np.arange(recording.n) + step, 0, recording.n - 1)
    columns = {c: v[source] if c in names else v for c, v in recording.columns.items()}
    return replace(recording, columns=columns)


def _change_from(
    robot, moved, steps: Sequence[int], half, scale_of_good_fit: float
) -> _Change | None:
    """The change that makes nearly all rows fit with the frames and the geometry of one half; None where none does."""
    try:
        fit = fit_recording(robot, half.select(even_rows(half, _ROWS)))
        if not fit.core <= scale_of_good_fit:
            return None
        mismatch = np.array([row_mismatch(robot, shifted, fit) for shifted in moved])
    except FAILURES:
        return None
    costs = np.minimum(mismatch / (_FITTING * scale_of_good_fit), 1.0) ** 2
    change = _least_cost_change(costs, steps)
    if change.before == change.after:
        return None
    first = steps.index(change.before)
    last = steps.index(change.after)
    fits = np.concatenate([costs[first, : change.row], costs[last, change.row :]]) < 1.0
    sections = (fits[: change.row], fits[change.row :])
    is_proven = all(len(part) >= _LEAST_PART and part.mean() > 0.5 for part in sections)
    if is_proven and fits.mean() >= _NEARLY_ALL:
        return change
    return None


def _least_cost_change(costs: np.ndarray, steps: Sequence[int]) -> _Change:
    """The change with the least sum of costs (K, n).

    A measurement that stands in two rows fits both sides of the change: the row that fits as it stands keeps it.
    """
    before = np.concatenate([np.zeros((len(costs), 1)), costs.cumsum(axis=1)], axis=1)
    after = before[:, -1:] - before
    total = before.min(axis=0) + after.min(axis=0)
    close = np.flatnonzero(total < total.min() + _SAME_COST)
    is_first_part_sound = steps[int(before[:, close[-1]].argmin())] == 0
    row = int(close[-1] if is_first_part_sound else close[0])
    return _Change(row, steps[int(before[:, row].argmin())], steps[int(after[:, row].argmin())])


def _suspicion(recording, change: _Change) -> Suspicion:
    ids = recording.sample_ids
    sections = (
        (f"samples {ids[0]} to {ids[change.row - 1]}", change.before),
        (f"samples {ids[change.row]} to {ids[-1]}", change.after),
    )
    sentences = [
        f"{rows} {f'hold the measurement of {place_of_measurement(step)}' if step else 'fit as they are'}"
        for rows, step in sections
    ]
    late = change.after - change.before
    rows = f"{abs(late)} row{'s' * (abs(late) > 1)}"
    return Suspicion(
        f"samples.csv of recording '{recording.name}': {' and '.join(sentences)}. From sample {ids[change.row]} on the "
        f"measurements are {rows} {'late' if late > 0 else 'early'} against the joint readings: "
        f"{'joint readings' if late > 0 else 'measurements'} of {rows} are missing there, or "
        f"{'measurements' if late > 0 else 'joint readings'} are too many; move the measured columns of one part by "
        f"{rows}, or remove the rows in between.",
        True,
        "rows-shifted",
        rows=(change.row,),
    )
