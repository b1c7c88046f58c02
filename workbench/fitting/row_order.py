"""Whether the order of the rows may be the order in time: a table that is sorted by a joint reading says nothing of it.

Drift, steps and warm-up are functions of time, and blocks of consecutive rows leave out spans of time. In a table that
is sorted by a joint they are functions of its reading, and the blocks are ranges of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import joint_columns, joint_number

_FEWEST = 12  # poses that are hardly in the order of one of six joints by chance
_DISTINCT = 0.5  # of the poses have readings of their own: the outer loop of a grid has fewer
_JUMPS = (
    0.5  # of the mean distance of random rows: neighbours of a motion are nearer to one another
)


def without_sorted_rows(recording: Recording) -> Recording:
    """The recording in a random order, always the same, with a warning, where its rows are sorted by a joint reading.

    As it is where times are recorded, or where neighbouring rows are near one another in other joints, as in a sweep.
    """
    joint = sorting_joint(recording)
    if joint is None:
        return recording
    shown = list(dict.fromkeys(recording.poses.tolist()))
    place = dict(zip(shown, np.random.default_rng(0).permutation(len(shown)).tolist()))
    rows = np.argsort([place[pose] for pose in recording.poses.tolist()], kind="stable")
    number = joint_number(joint)
    warning = (
        f"The rows are sorted by joint {number} ({joint}), and no times are recorded, so that the order of the rows is "
        f"no clock: a drift or a step would not be distinguishable from a function of joint {number}. The rows are "
        "used in a random order, in which no drift is found. If the rows are in the order of measurement, add the "
        "column time_s."
    )
    return replace(recording.select(rows), warnings=(*recording.warnings, warning))


def sorting_joint(recording: Recording) -> str | None:
    """Column of the joint reading by which the poses are sorted; None without one, and where times are recorded."""
    if "time_s" in recording.columns:
        return None
    first = np.unique(recording.poses, return_index=True)[1]
    first.sort()
    names = [c for c in joint_columns(recording.columns) if np.ptp(recording.columns[c]) > 0]
    if len(first) < _FEWEST or len(names) < 2:
        return None
    readings = {name: recording.columns[name][first] for name in names}
    for name in names:
        others = [values for other, values in readings.items() if other != name]
        if is_sorted_alone(readings[name], others):
            return name
    return None


def is_sorted_alone(values: np.ndarray, others: Sequence[np.ndarray]) -> bool:
    """Whether values (n,) ascend or descend while one of the other columns (n,) jumps, as of a sorted table."""
    return _is_sorted(values) and any(_jumps(other) for other in others)


def _is_sorted(values: np.ndarray) -> bool:
    """Whether readings (n,) ascend or descend, most of them different."""
    steps = np.diff(values)
    is_monotone = (steps >= 0).all() or (steps <= 0).all()
    return bool(is_monotone and len(np.unique(values)) > _DISTINCT * len(values))


def _jumps(values: np.ndarray) -> bool:
    """Whether neighbouring readings (n,) are about as far from one another as random ones."""
    ascending = np.sort(values)
    n = len(values)
    ranks = 2 * np.arange(n) - n + 1
    mean_distance = 2 * float(ranks @ ascending) / (n * (n - 1))  # Gini's mean difference
    return bool(np.abs(np.diff(values)).mean() > _JUMPS * mean_distance)


__all__ = ["is_sorted_alone", "sorting_joint", "without_sorted_rows"]
