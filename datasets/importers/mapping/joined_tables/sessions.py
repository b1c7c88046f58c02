"""Tables with the same columns, such as those of two days, whose rows stand below each other in one recording."""

import re
from collections.abc import Sequence

import numpy as np

from datasets.errors import InputError
from datasets.importers.mapping.columns.headers import Header
from datasets.importers.mapping.columns.sets import find_sets, headers_of
from datasets.importers.mapping.conversion import (
    axis_columns,
    joint_columns,
    other_columns,
    point_columns,
    rotation_columns,
)
from datasets.importers.mapping.joined_tables.joining import seconds_of
from datasets.importers.mapping.joined_tables.time_stamps import clock_origin
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable

APPEND = "append"
"""Value of `by` under [join] by which rows of several tables stand below each other."""
SESSION = "session"
"""Column of a recording that counts the tables, from 1."""
_DISTINCT = ("pose", "repeat", "pair")
"""Groups whose numbers or names begin again in every table."""
_TIMES = ("time", "date")
_FEWEST_UNKNOWN = 5


def session_groups(tables: Sequence[RawTable], stated: Mapping) -> list[list[RawTable]]:
    """The tables of each session; [] where the tables are those of one.

    A session is a table with whole samples (joint readings and a measurement), or several tables that hold them
    together, such as a joint log and a table of the instrument. The columns are the same in all sessions. stated: what
    the user's mapping says.
    """
    tables_by_signature: dict[frozenset, list[RawTable]] = {}
    for table in tables:
        tables_by_signature.setdefault(signature(table), []).append(table)
    kinds = list(tables_by_signature.values())
    count = len(kinds[0]) if kinds else 0
    if count < 2 or any(len(kind) != count for kind in kinds):
        return []
    if len(kinds) == 1:
        return [[table] for table in tables] if _are_sessions(tables, stated) else []
    if any(_holds_samples(kind[0], stated) for kind in kinds):
        return []
    first, *others = kinds
    ordered = [_in_order_of(first, other) for other in others]
    return [[table, *(other[k] for other in ordered)] for k, table in enumerate(first)]


def _in_order_of(first: Sequence[RawTable], others: Sequence[RawTable]) -> list[RawTable]:
    """Tables in the order of those that they belong to: by words that their names share, else as they are named."""
    shared = [[len(_own_words(a, first) & _own_words(b, others)) for b in others] for a in first]
    chosen = [row.index(max(row)) for row in shared]
    is_clear = all(row.count(max(row)) == 1 and max(row) > 0 for row in shared)
    return (
        [others[k] for k in chosen]
        if is_clear and len(set(chosen)) == len(chosen)
        else list(others)
    )


def _own_words(table: RawTable, kind: Sequence[RawTable]) -> set[str]:
    """Words and numbers of the name of a table, and of its folder, that not all tables of its kind have."""
    words = [set(re.findall(r"[a-z]+|\d+", _place(member).lower())) for member in (table, *kind)]
    return words[0] - set.intersection(*words[1:])


def _place(table: RawTable) -> str:
    return f"{table.folder.name if table.folder else ''} {table.stem}"


def _are_sessions(tables: Sequence[RawTable], stated: Mapping) -> bool:
    """Whether each table holds whole samples; tables without any known header do where all headers agree."""
    if all(_holds_samples(table, stated) for table in tables):
        return True
    known = any(find_sets(table) for table in tables)
    return not known and len(tables[0].columns) >= _FEWEST_UNKNOWN


def signature(table: RawTable) -> frozenset:
    """The columns of a table without their units."""
    return frozenset(_key(header) for header in headers_of(table).values())


def _key(header: Header) -> tuple:
    return (header.words, header.kind, header.label, header.core)


def _holds_samples(table: RawTable, stated: Mapping) -> bool:
    try:
        mapping = stated.merged(propose(table, stated=stated).mapping)
    except InputError:
        return False
    return mapping.joints is not None and mapping.measures is not None


def appended(tables: Sequence[RawTable]) -> RawTable:
    """The rows of tables with the same columns below each other, under the headers of the first one."""
    columns = {}
    for name, header in headers_of(tables[0]).items():
        cells_of_tables = [_cells_of(table, _key(header)) for table in tables]
        columns[name] = _joined(cells_of_tables)
    first = tables[0]
    return RawTable(
        " + ".join(dict.fromkeys(table.file for table in tables)),
        columns,
        np.concatenate([table.lines for table in tables]),
        first.units,
        first.conventions,
        first.default_units,
        tuple(dict.fromkeys(sentence for table in tables for sentence in table.warnings)),
    )


def _cells_of(table: RawTable, key: tuple) -> np.ndarray:
    return next(
        table.columns[name] for name, header in headers_of(table).items() if _key(header) == key
    )


def _joined(cell_arrays: Sequence[np.ndarray]) -> np.ndarray:
    if all(part.dtype.kind == "f" for part in cell_arrays):
        return np.concatenate(cell_arrays)
    return np.concatenate([part.astype(str) for part in cell_arrays])


def in_recording_units(
    tables: Sequence[RawTable], mappings: Sequence[Mapping], sliding: Sequence[bool]
) -> tuple[RawTable, Mapping, tuple[str, ...]]:
    """One table of several in the units of a recording, its mapping, and a sentence where times are left out.

    mappings: complete, of each table. sliding (R,): which joint readings are lengths. The column `session` counts the
    tables. Numbers and names of poses, which begin again in every table, are made distinct.
    """
    made = [
        _converted(table, mapping_of_table, sliding)
        for table, mapping_of_table in zip(tables, mappings)
    ]
    columns = {name: np.concatenate([converted[name] for converted in made]) for name in made[0]}
    mapping = _mapping_of_recording(mappings[0], columns)
    others, sentences = _other_columns(tables, mappings)
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
    return RawTable(file, columns, np.array(lines)), mapping, (*sentences, *timed)


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
    columns_of_tables = [other_columns(table, mapping) for table, mapping in zip(tables, mappings)]
    all_names = dict.fromkeys(
        name for part in columns_of_tables for name in part if name != "time_s"
    )
    shared = [name for name in all_names if all(name in part for part in columns_of_tables)]
    lost = [name for name in all_names if name not in shared]
    made = {}
    for name in shared:
        cells = [part[name] for part in columns_of_tables]
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


def _distinct(name_arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Names of groups with the number of their table, so that no group has rows of two tables."""
    return np.concatenate(
        [
            np.array([f"{number}: {_text(cell)}" for cell in part])
            for number, part in enumerate(name_arrays, 1)
        ]
    )


def _text(cell) -> str:
    return cell if isinstance(cell, str) else f"{float(cell):.12g}"


def sessions_origin(tables: Sequence[RawTable]) -> float | str | None:
    """The moment at which the times of `in_recording_units` are 0; None where its table has none."""
    if _times(tables)[0] is None:
        return None
    origins = [clock_origin(table) for table in tables]
    is_one_clock = len({type(origin) for origin in origins}) == 1
    return min(origins) if is_one_clock else None


def _times(tables: Sequence[RawTable]) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """(n,) s since the first row where the times of the tables follow each other, and a sentence where they do not."""
    times_of_tables = [seconds_of(table) for table in tables]
    if all(part is None for part in times_of_tables):
        return None, ()
    names = " and ".join(table.file for table in tables)
    if any(part is None or not np.isfinite(part).all() for part in times_of_tables):
        return None, (f"Only some of {names} have times, which the recording leaves out.",)
    ordered = sorted(times_of_tables, key=np.min)
    overlap = any(a.max() >= b.min() for a, b in zip(ordered, ordered[1:]))
    if overlap:
        sentence = (
            f"The times of {names} overlap, as those of clocks that start again; the recording leaves times out. "
            "Times with a date keep the order of all rows."
        )
        return None, (sentence,)
    joined = np.concatenate(times_of_tables)
    return joined - joined.min(), ()


__all__ = [
    "APPEND",
    "SESSION",
    "appended",
    "in_recording_units",
    "session_groups",
    "sessions_origin",
    "signature",
]
