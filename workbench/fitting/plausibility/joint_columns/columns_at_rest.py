"""Columns that do not vary as the others do: a stuck encoder, a column that was copied or sorted by mistake."""

import numpy as np

from datasets.samples.columns import POINT, joint_columns
from workbench.fitting.row_order import is_sorted_alone

_LEAST_RUN, _MAX_SHARE = 10, 0.7


def constant_columns(recording) -> list[str]:
    """Joint columns with one value only, where at least one other column varies."""
    names = joint_columns(recording.columns)
    constant = [name for name in names if np.ptp(recording.columns[name]) == 0]
    if len(constant) < len(names):
        return constant
    return []


def constant_coordinates(recording) -> list[str]:
    """Measured coordinates with one value only, where at least one other coordinate varies."""
    names = [name for name in POINT if name in recording.columns]
    constant = [name for name in names if np.ptp(recording.columns[name]) == 0]
    if len(constant) < len(names):
        return constant
    return []


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


def sorted_column(recording) -> str | None:
    """A joint column, or a measured coordinate, that ascends or descends while other columns jump; None without one."""
    first = np.sort(np.unique(recording.poses, return_index=True)[1])
    points = [name for name in POINT if name in recording.columns]
    for names, rows in (
        (joint_columns(recording.columns), first),
        (points, np.arange(recording.n)),
    ):
        values = {name: recording.columns[name][rows] for name in names}
        for name in names:
            others = [column for other, column in values.items() if other != name]
            if len(rows) >= _LEAST_RUN and is_sorted_alone(values[name], others):
                return name
    return None


def longest_run(recording) -> tuple[str, int, int] | None:
    """The longest run of poses in which one otherwise varying column stays while the others change.

    Returns the column and the first and last row number; None where no run has ten poses.
    """
    names = [
        name for name in joint_columns(recording.columns) if np.ptp(recording.columns[name]) > 0
    ]
    if len(names) < 2:
        return None
    steps = np.array([np.diff(recording.columns[name]) != 0 for name in names])
    moves = np.flatnonzero(
        steps.any(axis=0)
    )  # from one pose to the next; several rows may share a pose
    steps = steps[:, moves]
    best = None
    for k, name in enumerate(names):
        others = np.delete(steps, k, axis=0)
        stuck = ~steps[k] & (others.mean(axis=0) > _MAX_SHARE)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], stuck, [0]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2]):
            if end - start >= _LEAST_RUN and (best is None or end - start > best[3]):
                if end < len(moves):
                    last = moves[end]
                else:
                    last = recording.n - 1
                best = name, int(moves[start]), int(last), end - start
    return None if best is None else best[:3]
