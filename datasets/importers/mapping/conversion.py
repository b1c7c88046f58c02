"""Columns of a recording (mm, deg, unit quaternions) from a table and a complete mapping."""

from collections.abc import Sequence

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.candidates import RotationConvention
from datasets.importers.mapping.columns.column_units import each_unit, unit_factors
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.spherical import is_spherical, points_of
from datasets.importers.mapping.joined_tables.joining import seconds_of
from datasets.importers.mapping.joined_tables.time_stamps import clock_origin, times_of_column
from datasets.importers.mapping.label_parts import with_recurring_part
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.mapping.rotations import quaternion_columns
from datasets.importers.source import RawTable
from datasets.importers.units import COVARIATE_UNITS, LENGTHS, degrees_of
from datasets.samples.columns import AXES


def complete_rows(table: RawTable, mapping: Mapping) -> tuple[RawTable, tuple[str, ...]]:
    """The rows without an empty cell in a mapped column, and a sentence on those that were left out.

    Raises InputError where a mapped column is missing or no row is complete.
    """
    kept = ~_placeholders(table, mapping)
    for quantity in ("joints", "point", "rotation", "axis", "flange_point", "flange_rotation"):
        group = getattr(mapping, quantity)
        for name in () if group is None else group.columns:
            check_column(table, name, quantity)
            kept &= np.isfinite(table.numbers(name))
    if kept.all():
        return table, ()
    if not kept.any():
        raise complaint(
            table.file, "rows with a number in every mapped column", "none", "map other columns"
        )
    lost = np.flatnonzero(~kept)
    named = ", ".join(str(table.lines[row]) for row in lost[:5])
    ellipsis = ", ..." if len(lost) > 5 else ""
    sentence = (
        f"{table.file}: {len(lost)} rows with an empty cell, or with three equal coordinates, which stand for a "
        f"missing measurement, are left out (rows {named}{ellipsis})."
    )
    return table.take(np.flatnonzero(kept)), (sentence,)


def _placeholders(table: RawTable, mapping: Mapping) -> np.ndarray:
    """(n,) bool: rows whose measured coordinates are one and the same number, such as 0 or -9999."""
    group = mapping.point
    if group is None or any(name not in table.columns for name in group.columns):
        return np.zeros(table.n, bool)
    points = np.stack([table.numbers(name) for name in group.columns])
    return (points == points[0]).all(0)


def check_column(table: RawTable, name: str, quantity: str) -> None:
    """Raise InputError where a mapping names a column that the table does not have."""
    if name not in table.columns:
        raise complaint(
            f"{table.file}, column {name} of [{quantity}]",
            f"one of {', '.join(list(table.columns)[:30])}",
            "no such column",
            "correct the mapping",
        )


def joint_columns(
    table: RawTable, group: Group, prismatic: Sequence[bool], length_unit: str
) -> dict[str, np.ndarray]:
    """q1_deg ... (qK_mm of a prismatic joint) in the units of a recording."""
    if group.counts_per_deg is not None:
        counted = zip(group.columns, prismatic, group.counts_per_deg)
        return {
            f"q{number}_{'mm' if slides else 'deg'}": table.numbers(name) / size
            for number, (name, slides, size) in enumerate(counted, 1)
        }
    columns = {}
    units = each_unit(group.unit, len(group.columns))
    for number, (name, slides, unit) in enumerate(zip(group.columns, prismatic, units), 1):
        cells = table.numbers(name)
        if slides:
            columns[f"q{number}_mm"] = LENGTHS[unit if unit in LENGTHS else length_unit] * cells
        else:
            columns[f"q{number}_deg"] = degrees_of(cells, unit)
    return columns


def point_columns(table: RawTable, group: Group, prefix: str = "") -> dict[str, np.ndarray]:
    """x_mm, y_mm, z_mm, a prefix in front of their names; spherical coordinates are converted."""
    values = np.stack([table.numbers(name) for name in group.columns])
    if is_spherical(group.convention):
        values = points_of(values, group.convention)
    factors = unit_factors(group.unit, len(values), LENGTHS)
    rows = factors[:, None] * values
    return {f"{prefix}{axis}_mm": row for axis, row in zip("xyz", rows)}


def rotation_columns(table: RawTable, group: Group, prefix: str = "") -> dict[str, np.ndarray]:
    """qw, qx, qy, qz, a prefix in front. Raises InputError where the numbers are no rotations."""
    try:
        return quaternion_columns(RotationConvention(group).matrices(table), prefix)
    except ValueError as problem:
        raise complaint(
            f"{table.file}, columns {', '.join(group.columns)}",
            str(problem),
            "it",
            "correct the mapping",
        ) from None


def axis_columns(table: RawTable, group: Group) -> dict[str, np.ndarray]:
    """nx, ny, nz or ox, oy, oz, of length 1."""
    values = np.stack([table.numbers(name) for name in group.columns], axis=1)
    lengths = np.linalg.norm(values, axis=1)
    if np.abs(lengths - 1).max() > 0.02:
        row = int(np.argmax(np.abs(lengths - 1)))
        raise complaint(
            f"{table.file}, row {table.lines[row]}, columns {', '.join(group.columns)}",
            "an axis of length 1",
            f"{lengths[row]:.4g}",
            "correct the row or the mapping",
        )
    names = AXES[1] if group.columns[0].lower().lstrip("_").startswith("o") else AXES[0]
    return dict(zip(names, (values / lengths[:, None]).T))


def other_columns(table: RawTable, mapping: Mapping) -> dict[str, np.ndarray]:
    """Columns that are taken over, and time_s from the first column with times."""
    columns = {}
    for name, target in mapping.columns.items():
        check_column(table, name, "columns")
        is_stamp = target == "time_s" and table.columns[name].dtype.kind != "f"
        convert = _seconds_of_stamps if is_stamp else _in_units_of_recording
        columns[target] = convert(table, name, target)
    if "reflector" in columns:
        columns["reflector"] = with_recurring_part(columns["reflector"])
    seconds = seconds_of(table)
    if seconds is not None and "time_s" not in columns and np.isfinite(seconds).all():
        columns["time_s"] = seconds - seconds.min()
    return columns


def time_origin(table: RawTable, mapping: Mapping) -> float | str | None:
    """The moment at which the times of `other_columns` are 0; None where the recording has none.

    Numbers that a mapping copies into time_s stay as they are.
    """
    copied = [name for name, target in mapping.columns.items() if target == "time_s"]
    if any(table.columns[name].dtype.kind == "f" for name in copied):
        return 0.0
    return clock_origin(table)


def _seconds_of_stamps(table: RawTable, name: str, target: str) -> np.ndarray:
    """Seconds since the first moment of a column of time stamps. Raises InputError where one cannot be read."""
    seconds, _ = times_of_column(table, name)
    if seconds is None:
        raise complaint(
            f"{table.file}, column {name}",
            f"seconds or time stamps such as 2026-09-14 08:12:05 for {target}",
            f"'{table.columns[name][0]}' in the first row",
            "write the times in one of these forms, or leave the column out of [columns]",
        )
    return seconds - seconds.min()


def _in_units_of_recording(table: RawTable, name: str, target: str) -> np.ndarray:
    """Cells of a column in the unit of its target, as far as the header or a row of units states another one.

    Raises InputError for a unit that the target cannot have.
    """
    cells = table.columns[name]
    unit = read_header(name, table.units.get(name)).unit
    known = COVARIATE_UNITS.get(target)
    if known is None or unit is None or cells.dtype.kind != "f":
        return cells
    if unit not in known:
        raise complaint(
            f"{table.file}, column {name}",
            f"a unit of {target} ({', '.join(known)})",
            unit,
            "correct the header, or leave the column out of [columns] in a mapping file for --map",
        )
    factor, addend = known[unit]
    return factor * cells + addend
