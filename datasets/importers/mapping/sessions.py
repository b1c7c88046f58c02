"""Tables with the same columns, such as those of two days, whose rows stand below each other in one recording."""

from collections.abc import Sequence

import numpy as np

from datasets.errors import InputError
from datasets.importers.mapping.conversion import (
    axis_columns,
    joint_columns,
    other_columns,
    point_columns,
    rotation_columns,
)
from datasets.importers.mapping.headers import Header
from datasets.importers.mapping.joining import seconds_of
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.mapping.proposal import propose
from datasets.importers.mapping.sets import find_sets, headers_of
from datasets.importers.source import RawTable

APPEND = "append"
"""Value of `by` under [join] by which rows of several tables stand below each other."""
SESSION = "session"
"""Column of a recording that counts the tables, from 1."""
_DISTINCT = ("pose", "repeat", "pair")
"""Groups whose numbers or names begin again in every table."""
_TIMES = ("time", "date")
_FEWEST_UNKNOWN = 5


def are_sessions(tables: Sequence[RawTable], stated: Mapping) -> bool:
    """Whether each table holds whole samples (joint readings and a measurement) in the same columns.

    stated: what the user's mapping says. Tables without any known header are sessions where all headers agree.
    """
    if len(tables) < 2 or len({_signature(table) for table in tables}) > 1:
        return False
    if all(_holds_samples(table, stated) for table in tables):
        return True
    known = any(find_sets(table) for table in tables)
    return not known and len(tables[0].columns) >= _FEWEST_UNKNOWN


def _signature(table: RawTable) -> frozenset:
    """The columns of a table without their units."""
    return frozenset(_key(header) for header in headers_of(table).values())


def _key(header: Header) -> tuple:
    return (header.words, header.kind, header.label, header.core)


def _holds_samples(table: RawTable, stated: Mapping) -> bool:
    try:
        mapping = stated.merged(propose(table).mapping)
    except InputError:
        return False
    return mapping.joints is not None and mapping.measures is not None


def appended(tables: Sequence[RawTable]) -> RawTable:
    """The rows of tables with the same columns below each other, under the headers of the first one."""
    columns = {}
    for name, header in headers_of(tables[0]).items():
        parts = [_cells_of(table, _key(header)) for table in tables]
        columns[name] = _joined(parts)
    first = tables[0]
    return RawTable(
        " + ".join(dict.fromkeys(table.file for table in tables)),
        columns,
        np.concatenate([table.lines for table in tables]),
        first.units,
        first.conventions,
        first.default_units,
        tuple(dict.fromkeys(said for table in tables for said in table.warnings)),
    )


def _cells_of(table: RawTable, key: tuple) -> np.ndarray:
    return next(
        table.columns[name] for name, header in headers_of(table).items() if _key(header) == key
    )


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    if all(part.dtype.kind == "f" for part in parts):
        return np.concatenate(parts)
    return np.concatenate([part.astype(str) for part in parts])


def in_recording_units(
    tables: Sequence[RawTable], mappings: Sequence[Mapping], sliding: Sequence[bool]
) -> tuple[RawTable, Mapping, tuple[str, ...]]:
    """One table of several in the units of a recording, its mapping, and a sentence where times are left out.

    mappings: complete, of each table. sliding (R,): which joint readings are lengths. The column `session` counts the
    tables. Numbers and names of poses, which begin again in every table, are made distinct.
    """
    made = [_converted(table, own, sliding) for table, own in zip(tables, mappings)]
    columns = {name: np.concatenate([one[name] for one in made]) for name in made[0]}
    mapping = _mapping_of_recording(mappings[0], columns)
    others, said = _other_columns(tables, mappings)
    columns |= others
    copied = {target: target for target in others}
    sizes = [table.n for table in tables]
    columns[SESSION] = np.repeat(np.arange(1.0, len(tables) + 1), sizes)
    copied[SESSION] = SESSION
    times, timed = _times(tables)
    if times is not None:
        columns["time_s"] = times
        copied["time_s"] = "time_s"
    lines = [f"{line} of {table.file}" for table in tables for line in table.lines]
    file = " + ".join(dict.fromkeys(table.file for table in tables))
    mapping = Mapping(**{**vars(mapping), "columns": copied})
    return RawTable(file, columns, np.array(lines)), mapping, (*said, *timed)


def _converted(table: RawTable, mapping: Mapping, sliding: Sequence[bool]) -> dict[str, np.ndarray]:
    """Joint readings, point, rotation or axis as the columns of a recording."""
    point = mapping.point
    unit = None if point is None else point.unit
    length = (unit[0] if isinstance(unit, tuple) else unit) or "mm"
    columns = joint_columns(table, mapping.joints, sliding, length)
    if point is not None:
        columns |= point_columns(table, point)
    if mapping.rotation is not None and mapping.rotation.convention:
        columns |= rotation_columns(table, mapping.rotation)
    elif mapping.axis is not None:
        columns |= axis_columns(table, mapping.axis)
    return columns


def _other_columns(tables: Sequence[RawTable], mappings: Sequence[Mapping]):
    """Covariates and groups of all tables, and a sentence on those that only some of them have."""
    parts = [other_columns(table, own) for table, own in zip(tables, mappings)]
    every = dict.fromkeys(name for part in parts for name in part if name != "time_s")
    shared = [name for name in every if all(name in part for part in parts)]
    lost = [name for name in every if name not in shared]
    made = {}
    for name in shared:
        cells = [part[name] for part in parts]
        made[name] = _distinct(cells) if name in _DISTINCT else _joined(cells)
    if not lost:
        return made, ()
    return made, (
        f"Only some of the tables have {', '.join(lost)}, which the recording leaves out.",
    )


def _mapping_of_recording(mapping: Mapping, columns) -> Mapping:
    """The mapping of columns that `_converted` made."""
    readings = [name for name in columns if name.startswith("q") and name[1].isdigit()]
    units = tuple("mm" if name.endswith("_mm") else "deg" for name in readings)
    made = {"joints": Group(tuple(readings), units if "mm" in units else "deg")}
    if "x_mm" in columns:
        made["point"] = Group(("x_mm", "y_mm", "z_mm"), "mm")
    made["rotation"] = None
    if "qw" in columns:
        made["rotation"] = Group(("qw", "qx", "qy", "qz"), None, "quaternion wxyz")
    axis = tuple(name for name in ("nx", "ny", "nz", "ox", "oy", "oz") if name in columns)
    made["axis"] = Group(axis) if axis else None
    return Mapping(**{**vars(mapping), **made})


def _distinct(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Names of groups with the number of their table, so that no group has rows of two tables."""
    return np.concatenate(
        [
            np.array([f"{number}: {_text(cell)}" for cell in part])
            for number, part in enumerate(parts, 1)
        ]
    )


def _text(cell) -> str:
    return cell if isinstance(cell, str) else f"{float(cell):.12g}"


def _times(tables: Sequence[RawTable]) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """(n,) s since the first row where the times of the tables follow each other, and a sentence where they do not."""
    parts = [seconds_of(table) for table in tables]
    if all(part is None for part in parts):
        return None, ()
    names = " and ".join(table.file for table in tables)
    if any(part is None or not np.isfinite(part).all() for part in parts):
        return None, (f"Only some of {names} have times, which the recording leaves out.",)
    ordered = sorted(parts, key=np.min)
    overlap = any(a.max() >= b.min() for a, b in zip(ordered, ordered[1:]))
    if overlap:
        said = (
            f"The times of {names} overlap, as those of clocks that start again; the recording leaves times out. "
            "Times with a date keep the order of all rows."
        )
        return None, (said,)
    joined = np.concatenate(parts)
    return joined - joined.min(), ()


__all__ = ["APPEND", "SESSION", "appended", "are_sessions", "in_recording_units"]
