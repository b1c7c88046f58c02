"""Joint columns that stay constant while the arm moves: an encoder that is stuck, a column copied by mistake."""

import numpy as np

from datasets.columns import joint_columns

_LEAST_RUN = 10


def constant_columns(recording) -> list[str]:
    """Joint columns with one value only, where at least one other column varies."""
    names = joint_columns(recording.columns)
    still = [name for name in names if np.ptp(recording.columns[name]) == 0]
    return still if len(still) < len(names) else []


def equal_columns(recording) -> list[tuple[str, str]]:
    """Pairs of varying joint columns with the same values: one was copied over the other."""
    names = [
        name for name in joint_columns(recording.columns) if np.ptp(recording.columns[name]) > 0
    ]
    values = recording.columns
    return [
        (a, b)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
        if np.array_equal(values[a], values[b])
    ]


def longest_run(recording) -> tuple[str, int, int] | None:
    """The longest run of rows in which one otherwise varying column stays while all others change.

    Returns the column and the first and last row number; None where no run has ten rows.
    """
    names = [
        name for name in joint_columns(recording.columns) if np.ptp(recording.columns[name]) > 0
    ]
    steps = np.array([np.diff(recording.columns[name]) != 0 for name in names])
    best = None
    for k, name in enumerate(names):
        others = np.delete(steps, k, axis=0)
        stuck = ~steps[k] & others.any(axis=0) & (others.mean(axis=0) > 0.7)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], stuck, [0]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2]):
            if end - start >= _LEAST_RUN and (best is None or end - start > best[2] - best[1]):
                best = name, int(start), int(end)
    return best
