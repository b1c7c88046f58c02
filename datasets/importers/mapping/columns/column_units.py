"""The unit of a quantity whose columns may have units of their own: one word for all, or one word for each column.

An empty word stands for a column whose unit nothing states.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

ColumnUnits = str | tuple[str, ...] | None
"""One unit for all columns, one for each of them, or None where nothing states any."""

OPEN = ""


def joined_units(units: Sequence[str | None]) -> ColumnUnits:
    """The units of columns as one word where they agree, None where none is stated."""
    if len(set(units)) == 1:
        return units[0]
    return tuple(unit or OPEN for unit in units)


def each_unit(unit: ColumnUnits, count: int) -> tuple[str, ...]:
    """(count,) units, one for each column; OPEN where nothing states it."""
    return unit if isinstance(unit, tuple) else (unit or OPEN,) * count


def completed_units(
    unit: ColumnUnits, usual: Sequence[str], known: Collection[str]
) -> tuple[ColumnUnits, ...]:
    """Possible units of the columns: those without a unit of their own share one of `usual`.

    known: units that the quantity can have; a word outside them states nothing.
    """
    if not isinstance(unit, tuple):
        return (unit,) if unit in known else tuple(usual)
    if all(word in known for word in unit):
        return (unit,)
    stated = [word for word in usual if word in unit]
    ordered = [*stated, *(word for word in usual if word not in stated)]
    filled = [
        tuple(word if word in known else usual_unit for word in unit) for usual_unit in ordered
    ]
    return tuple(joined_units(words) for words in filled)


def unit_factors(unit: ColumnUnits, count: int, sizes: Mapping[str, float]) -> np.ndarray:
    """(count,) size of the unit of each column in the unit of a recording. Raises KeyError for an unknown unit."""
    return np.array([sizes[word] for word in each_unit(unit, count)])


def unit_words(unit: ColumnUnits, columns: Sequence[str], word: Callable[[str], str]) -> str:
    """In words: "radians", or "radians, 'Eje 4' in degrees", the most common unit first."""
    if not isinstance(unit, tuple):
        return word(unit)
    common = Counter(unit).most_common(1)[0][0]
    others = [
        f"'{name}' in {word(of_column)}"
        for name, of_column in zip(columns, unit, strict=True)
        if of_column != common
    ]
    return ", ".join([word(common), *others])


def unit_toml(unit: ColumnUnits) -> str:
    """The value of the key `unit` of a mapping file: "rad", or ["rad", "deg"]."""
    if isinstance(unit, tuple):
        return "[" + ", ".join(f'"{word}"' for word in unit) + "]"
    return f'"{unit}"'
