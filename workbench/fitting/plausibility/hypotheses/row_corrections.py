"""Mistakes in the order of rows: measurements, or a joint column, are shifted, reversed, or sorted as text."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from datasets.samples.columns import MEASURED, joint_columns
from workbench.fitting.plausibility.hypotheses.corrections import (
    LABELS,
    Correction,
    observed_columns,
)

ROWS = "rows"
_LAST_DIGIT = 9
"""Up to so many numbers, texts and numbers have one order."""


def row_corrections(recording) -> Iterator[Correction]:
    """Measured columns shifted or reversed, with and without the labels of what was measured."""
    if recording.measures == "distance" or not any(c in MEASURED for c in recording.columns):
        return
    labelled = [c for c in LABELS if c in recording.columns and np.ptp(recording.columns[c]) > 0]
    names = observed_columns(recording)
    bare = [c for c in names if c not in LABELS]
    step = _rows_per_pose(recording)
    for rows in shift_steps(recording):
        yield _shifted(names, rows)
        if labelled:
            yield _shifted(bare, rows)
    yield _reversed(names, 1)
    if step > 1 and recording.n % step == 0:
        yield _reversed(names, step)
    yield from _sorted_as_text(recording, names)
    for name in joint_columns(recording.columns):
        yield from (_column_late(name, rows) for rows in (step, -step))


def shift_steps(recording) -> tuple[int, ...]:
    """Rows by which measurements may be displaced: one or two rows, or one or two poses of several rows."""
    pose = _rows_per_pose(recording)
    return tuple(dict.fromkeys((1, -1, pose, -pose, 2, -2, 2 * pose, -2 * pose)))


def place_of_measurement(step: int) -> str:
    """Whose measurement a row holds if its own one is `step` rows below: "the row before" for 1."""
    where = "before" if step > 0 else "after"
    count = {1: "the row", 2: "the second row"}.get(abs(step), f"the row {abs(step)} rows")
    return f"{count} {where}"


def _rows_per_pose(recording) -> int:
    """The usual number of consecutive rows with equal joint readings."""
    if recording.n < 2:
        return 1
    new = np.flatnonzero(np.any(np.diff(recording.joints, axis=0) != 0, axis=1))
    if len(new) > 1:
        return int(np.median(np.diff(new)))
    return 1


def _shifted(names, step) -> Correction:
    """Measurements `step` rows late (or early, where negative); rows without a partner are left out."""

    def apply(robot, recording):
        n = recording.n
        kept_rows = np.arange(max(0, -step), n - max(0, step))
        columns = {
            c: v[kept_rows + step if c in names else kept_rows]
            for c, v in recording.columns.items()
        }
        return robot, replace(recording, columns=columns)

    return Correction(
        "rows-shifted",
        "rows",
        f"hold the measurement of {place_of_measurement(step)}",
        f"move the measured columns {'up' if step > 0 else 'down'} by {abs(step)} row{'s' * (abs(step) > 1)}",
        frozenset({ROWS}),
        apply,
    )


def _column_late(name: str, step: int) -> Correction:
    """One column of joint readings `step` rows late (or early, where negative) against all others."""

    def apply(robot, recording):
        n = recording.n
        kept_rows = np.arange(max(0, -step), n - max(0, step))
        columns = {
            c: v[kept_rows + step if c == name else kept_rows] for c, v in recording.columns.items()
        }
        return robot, replace(recording, columns=columns)

    rows = f"{abs(step)} row{'s' * (abs(step) > 1)}"
    return Correction(
        "column-shifted",
        f"column {name}",
        f"is {rows} {'late' if step > 0 else 'early'} against the other columns",
        f"move the cells of this column {'up' if step > 0 else 'down'} by {rows}",
        frozenset({name}),
        apply,
    )


def _reversed(names, step: int) -> Correction:
    """All rows in reverse order, or the poses of `step` rows each."""

    def apply(robot, recording):
        if recording.n % step:  # another correction has left rows out
            return robot, recording
        source = np.arange(recording.n).reshape(-1, step)[::-1].ravel()
        columns = {c: v[source] if c in names else v for c, v in recording.columns.items()}
        return robot, replace(recording, columns=columns)

    return Correction(
        "rows-reversed",
        "rows",
        "hold the measurements in reverse order",
        "reverse the measured columns",
        frozenset({ROWS}),
        apply,
    )


def _sorted_as_text(recording, names) -> Iterator[Correction]:
    """Numbers 1, 10, 11, ..., 2 (or 0, 1, 10, ...) of the poses, in the measured columns or in the readings alone."""
    step = _rows_per_pose(recording)
    count = recording.n // step
    if count * step != recording.n or count <= _LAST_DIGIT:
        return
    for first in (1, 0):
        labels = [str(number) for number in range(first, first + count)]
        order = np.array(sorted(range(count), key=labels.__getitem__))
        rank = np.argsort(order)
        in_order = ", ".join(labels[k] for k in order[:4])
        for poses, sorted_part, other in (
            (rank, "measurements", "joint readings"),
            (order, "joint readings", "measurements"),
        ):
            source = (step * poses[:, None] + np.arange(step)).ravel()
            yield _in_other_order(names, source, in_order, sorted_part, other)


def _in_other_order(names, source, in_order: str, sorted_part: str, other: str) -> Correction:
    """The measurement of each row is in the row `source` (n,); sorted_part: what is sorted as text, not the other."""

    def apply(robot, recording):
        if recording.n != len(source):  # another correction has left rows out
            return robot, recording
        columns = {c: v[source] if c in names else v for c, v in recording.columns.items()}
        return robot, replace(recording, columns=columns)

    return Correction(
        "rows-sorted-as-text",
        "rows",
        f"hold {sorted_part} whose numbers were sorted as text ({in_order} ...), next to {other} in the order of "
        "numbers",
        f"sort the {sorted_part} by number",
        frozenset({ROWS}),
        apply,
    )
