"""Names of measured points, each different, of which one part recurs: the 2 of SMR2_17 may name the reflector."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

_MOST_LABELS = 12
_ROWS_OF_LABEL = 3
"""Rows for each label, on average: three coordinates of its point are estimated from them."""
_PART = re.compile(r"\d+|[^\W\d_]+")


def are_labels(values: Sequence) -> bool:
    """Whether values (n) divide the rows into a few groups, each of two rows or more."""
    counts = Counter(values)
    is_few = 1 < len(counts) <= _MOST_LABELS and len(values) >= _ROWS_OF_LABEL * len(counts)
    return is_few and min(counts.values()) > 1


def with_recurring_part(cells: np.ndarray) -> np.ndarray:
    """The part of names (n) that recurs, where all names differ and one part does; the cells as they are otherwise.

    Of several parts the one with the fewest values counts: a tool has fewer reflectors than there are poses.
    """
    if cells.dtype.kind == "f" or len(set(cells.tolist())) < len(cells):
        return cells
    rows = [_PART.findall(str(cell)) for cell in cells]
    if len({len(row) for row in rows}) != 1:
        return cells
    recurring = [column for column in zip(*rows) if are_labels(column)]
    recurring.sort(key=lambda column: len(set(column)))
    if not recurring or _are_two_divisions(recurring[:2]):
        return cells
    words = recurring[0]
    if all(map(str.isdecimal, words)):
        return np.array([float(word) for word in words])
    return np.array(words)


def _are_two_divisions(columns: Sequence[Sequence[str]]) -> bool:
    """Whether two parts with equally many values divide the rows differently."""
    if len(columns) < 2:
        return False
    sizes = [len(set(column)) for column in columns]
    return sizes[0] == sizes[1] != len(set(zip(*columns)))
