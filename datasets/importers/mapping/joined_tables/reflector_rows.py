"""A table with several rows for each row of another one, which nothing numbers: one for each reflector of a pose.

Reflectors on one tool keep their distances from one another. Either the reflectors of a pose stand below each other, or
the poses of a reflector do: the order is the one that keeps the distances.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from datasets.importers.mapping.columns.reflectors import POSE, REFLECTOR
from datasets.importers.source import RawTable

_FEWEST_POSES = 4
_MOST_REFLECTORS = 12
_RIGID = 0.01
"""Median change of a distance, as a share of the scatter of the points, below which reflectors are on one tool."""
_CLEARLY = 5.0
_ONE_POINT = 1e-3
"""Distance, as a share of the scatter of the points, below which the rows are repeats of one reflector."""


def with_rows_of_reflectors(
    shorter: RawTable, longer: RawTable
) -> tuple[RawTable, RawTable, tuple[str, ...]] | None:
    """Both tables with a row for each reflector of each pose, and a sentence; None for other tables.

    shorter: one row for each pose. longer: a whole multiple of as many rows.
    """
    count, remainder = divmod(longer.n, max(shorter.n, 1))
    if remainder or not 2 <= count <= _MOST_REFLECTORS or shorter.n < _FEWEST_POSES:
        return None
    poses, reflectors = np.arange(shorter.n), np.arange(count)
    orders = [
        (
            np.repeat(poses, count),
            np.tile(reflectors, shorter.n),
            "of a pose stand below each other",
        ),
        (np.tile(poses, count), np.repeat(reflectors, shorter.n), "follow one another as a whole"),
    ]
    changes = [
        _change_of_distances(longer, np.argsort(pose * count + reflector), count)
        for pose, reflector, _ in orders
    ]
    best = int(np.argmin([change for change, _ in changes]))
    change, distance = changes[best]
    if not change < _RIGID or changes[1 - best][0] < _CLEARLY * change:
        return None
    pose, reflector, words = orders[best]
    columns = dict(longer.columns)
    columns.setdefault(POSE, pose + 1.0)
    if distance > _ONE_POINT:
        columns.setdefault(REFLECTOR, reflector + 1.0)
    reading = f"{count} reflectors on one tool" if distance > _ONE_POINT else f"{count} repeats"
    note = (
        f"{longer.file} has {count} rows for each row of {shorter.file}, read as {reading}: the rows {words}, since "
        "the distances between the points then stay the same."
    )
    return shorter.take(pose), replace(longer, columns=columns), (note,)


def _change_of_distances(table: RawTable, order: np.ndarray, count: int) -> tuple[float, float]:
    """Median change of the distances between the points of a pose, and their median, as shares of the scatter.

    order: rows of the table, pose by pose. Of the triples of neighbouring columns of numbers the most constant counts.
    """
    found = [(np.inf, np.inf)]
    for points in _points(table):
        by_pose = points[order].reshape(-1, count, 3)
        scatter = float(np.linalg.norm(np.nanstd(by_pose[:, 0], axis=0)))
        pairs = combinations(range(count), 2)
        lengths = np.stack(
            [np.linalg.norm(by_pose[:, i] - by_pose[:, j], axis=1) for i, j in pairs], axis=1
        )
        if not scatter > 0 or not np.isfinite(lengths).all():
            continue
        middle = np.median(lengths, axis=0)
        change = np.median(np.abs(lengths - middle), axis=0).max()
        found.append((float(change) / scatter, float(middle.max()) / scatter))
    return min(found)


def _points(table: RawTable) -> Iterator[np.ndarray]:
    """(n, 3) of each three neighbouring columns of numbers."""
    numbers = [cells for cells in table.columns.values() if cells.dtype.kind == "f"]
    for triple in zip(numbers, numbers[1:], numbers[2:]):
        yield np.stack(triple, axis=1)
