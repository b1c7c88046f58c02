"""Which units and rotation conventions the columns may have, as far as headers and format leave them open."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from datasets.importers.mapping.columns.column_units import (
    ColumnUnits,
    completed_units,
    unit_words,
)
from datasets.importers.mapping.columns.sets import AXES_OF_SET, find_sets
from datasets.importers.mapping.columns.spherical import completions, is_spherical
from datasets.importers.mapping.model import Group
from datasets.importers.mapping.rotations import (
    EULER,
    MATRIX,
    QUATERNIONS,
    SEQUENCES,
    TAIT_BRYAN,
    VECTOR,
    has_unit,
    rotation_matrices,
)
from datasets.importers.source import RawTable
from datasets.importers.units import ANGLE_NAMES, DMS, LENGTHS, degrees_of, may_be_dms

LENGTH_UNITS = ("mm", "m", "in", "cm")
ANGLE_UNITS = ("deg", "rad", "gon")
ANGLE_WORDS = {
    "deg": "degrees",
    "rad": "radians",
    "gon": "gon",
    "mrad": "milliradians",
    "arcmin": "arc minutes",
    "arcsec": "arc seconds",
    DMS: "degrees with minutes and seconds as decimals",
}
LENGTH_WORDS = {
    "mm": "millimetres",
    "m": "metres",
    "in": "inches",
    "cm": "centimetres",
    "um": "micrometres",
    "ft": "feet",
    "mil": "thousandths of an inch",
}
_SAME_DECIMALS = 8


@dataclass(frozen=True)
class RotationConvention:
    """One reading of rotation columns: their order, convention, unit of angles, and whether they are transposed."""

    group: Group

    @property
    def title(self) -> str:
        """In words: "intrinsic XYZ in degrees"."""
        unit = ""
        if has_unit(self.group.convention):
            unit = f" in {unit_words(self.group.unit, self.group.columns, ANGLE_WORDS.get)}"
        return f"{self.group.convention}{unit}{', inverse rotation' if self.group.inverse else ''}"

    def matrices(self, table: RawTable) -> np.ndarray:
        """(n, 3, 3) rotations. Raises ValueError where the numbers cannot be this."""
        values = np.stack([table.numbers(name) for name in self.group.columns], axis=1)
        unit = self.group.unit
        if isinstance(unit, tuple):
            columns = [degrees_of(cells, word) for cells, word in zip(values.T, unit)]
            values, unit = np.stack(columns, axis=1), "deg"
        return rotation_matrices(values, self.group.convention, unit, self.group.inverse)


def length_units(group: Group, stated_only: bool = True) -> tuple[ColumnUnits, ...]:
    """Units that a point may have: the stated ones, or all."""
    return completed_units(group.unit, LENGTH_UNITS, LENGTHS) if stated_only else LENGTH_UNITS


def point_readings(group: Group, stated_only: bool = True) -> Iterator[tuple[str, Group]]:
    """(words, group) of every unit of a point and, of spherical coordinates, every convention."""
    conventions = [group.convention]
    if is_spherical(group.convention):
        conventions = completions(group.convention, stated_only)
    for unit in length_units(group, stated_only):
        for convention in conventions:
            words = unit_words(unit, group.columns, LENGTH_WORDS.get)
            words += f" ({convention})" if convention else ""
            yield words, replace(group, unit=unit, convention=convention)


def angle_units(group: Group, stated_only: bool = True) -> tuple[ColumnUnits, ...]:
    """Units that angles may have: the stated ones, or all. Lengths of sliding joints stay as they are stated."""
    known = (*ANGLE_NAMES, *LENGTHS) if isinstance(group.unit, tuple) else ANGLE_NAMES
    return completed_units(group.unit, ANGLE_UNITS, known) if stated_only else ANGLE_UNITS


def rotation_candidates(
    group: Group, table: RawTable, stated_only: bool = True
) -> list[RotationConvention]:
    """All readings of rotation columns that differ in some row, the stated or usual ones first.

    stated_only: keep to the convention and unit that the group states, as far as it does.
    """
    conventions = (
        [(group.columns, group.convention)]
        if group.convention and stated_only
        else _conventions(group, table)
    )
    candidates: list[RotationConvention] = []
    seen: set[bytes] = set()
    for columns, convention in conventions:
        units = _rotation_units(group, table, stated_only) if has_unit(convention) else (None,)
        for unit in units:
            for inverse in (group.inverse,) if group.convention and stated_only else (False, True):
                candidate = RotationConvention(
                    Group(tuple(columns), _in_order(unit, group, columns), convention, inverse)
                )
                try:
                    key = _rounded(candidate, table)
                except ValueError:
                    continue
                if key not in seen:
                    seen.add(key)
                    candidates.append(candidate)
    return sorted(
        candidates, key=lambda candidate: (candidate.group.inverse, candidate.group.unit == "gon")
    )


def _rotation_units(group: Group, table: RawTable, stated_only: bool) -> tuple[ColumnUnits, ...]:
    """Units of the angles of a rotation, with minutes and seconds as decimals where the digits allow it."""
    units = angle_units(group, stated_only)
    values = np.concatenate([table.numbers(name) for name in group.columns])
    return (*units, DMS) if "deg" in units and may_be_dms(values) else units


def reordered_candidates(group: Group, table: RawTable) -> list[RotationConvention]:
    """All readings of rotation columns in other orders than the stated one, that differ in some row.

    They keep to the convention of the group where it states one.
    """
    candidates: dict[bytes, RotationConvention] = {}
    for columns in list(permutations(group.columns))[1:] if len(group.columns) < 5 else ():
        unit = _in_order(group.unit, group, columns)
        for candidate in rotation_candidates(replace(group, columns=columns, unit=unit), table):
            candidates.setdefault(_rounded(candidate, table), candidate)
    return list(candidates.values())


def _rounded(candidate: RotationConvention, table: RawTable) -> bytes:
    """The rotations of a reading, equal for readings that differ by rounding."""
    # adding 0 makes -0 and 0 the same bytes
    return (np.round(candidate.matrices(table), _SAME_DECIMALS) + 0.0).tobytes()


def _in_order(unit: ColumnUnits, group: Group, columns: Sequence[str]) -> ColumnUnits:
    """Units of the columns of a group in another order of the columns."""
    if not isinstance(unit, tuple):
        return unit
    unit_of_column = dict(zip(group.columns, unit, strict=True))
    return tuple(unit_of_column[name] for name in columns)


def _conventions(group: Group, table: RawTable) -> Iterator[tuple[Sequence[str], str]]:
    """Orders of the columns with a convention each; those that the headers suggest first."""
    if len(group.columns) == 9:
        yield group.columns, MATRIX
    elif len(group.columns) == 4:
        for convention in QUATERNIONS:
            yield group.columns, convention
    else:
        yield from _labelled(group, table)
        yield group.columns, VECTOR
        for convention in EULER:
            yield group.columns, convention


def _labelled(group: Group, table: RawTable) -> Iterator[tuple[Sequence[str], str]]:
    """Each angle about the axis that its header names, in every order of the three rotations."""
    same = [
        column_set for column_set in find_sets(table) if set(column_set.names) == set(group.columns)
    ]
    axes = AXES_OF_SET.get(same[0].labels) if same else None
    if axes is None:
        return
    by_axis = dict(zip(axes, same[0].names))
    for sequence in TAIT_BRYAN:
        yield [by_axis[axis] for axis in sequence], f"intrinsic {sequence}"


__all__ = [
    "SEQUENCES",
    "RotationConvention",
    "angle_units",
    "length_units",
    "point_readings",
    "reordered_candidates",
    "rotation_candidates",
]
