"""Several reflectors in one row: a set of point columns for each of them; the rows become one for each reflector."""

import json
import os
import re
from collections.abc import Mapping as Keys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable

REFLECTOR, POSE = "reflector", "pose"
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SEPARATORS = " _-.:/([,"


def with_reflectors(mapping: Mapping) -> Mapping:
    """The mapping with the columns that `stacked` makes, where it states columns; headers propose them otherwise."""
    if not mapping.reflectors or not mapping.columns:
        return mapping
    columns = dict(mapping.columns)
    for name in (REFLECTOR, POSE):
        if name not in columns.values():
            columns[name] = name
    return replace(mapping, columns=columns)


def stacked(table: RawTable, mapping: Mapping) -> RawTable:
    """The table with a row for each reflector of each row, and the columns `reflector` and `pose`.

    The coordinates stand under the headers of the first reflector. Rows where a reflector has no number are left out.
    Raises InputError for columns that the table lacks or whose headers state different units.
    """
    column_sets = mapping.reflectors
    if not column_sets or not any(
        set(names) & set(table.columns) for names in column_sets.values()
    ):
        return table
    _check(table, column_sets)
    points = {
        name: np.stack([table.numbers(n) for n in names]) for name, names in column_sets.items()
    }
    is_seen = np.stack([np.isfinite(part).any(axis=0) for part in points.values()], axis=1)
    rows, places = np.nonzero(is_seen)
    named = {name for names in column_sets.values() for name in names}
    kept = {name: cells[rows] for name, cells in table.columns.items() if name not in named}
    values = np.stack(list(points.values()))[places, :, rows]
    first = next(iter(column_sets.values()))
    kept |= dict(zip(first, values.T))
    if POSE not in mapping.columns.values() or mapping.columns.get(POSE) == POSE:
        kept.setdefault(POSE, rows + 1.0)
    kept[REFLECTOR] = np.array(list(column_sets))[places]
    sentences = _missing_sentences(table, list(column_sets), is_seen)
    return replace(
        table, columns=kept, lines=table.lines[rows], warnings=(*table.warnings, *sentences)
    )


def _missing_sentences(table: RawTable, names: list[str], is_seen: np.ndarray) -> list[str]:
    """A sentence on the reflectors that some rows do not hold; is_seen: (n, reflectors)."""
    counts = [
        f"{name} in {count} of {table.n}"
        for name, count in zip(names, is_seen.sum(axis=0))
        if count < table.n
    ]
    if not counts:
        return []
    return [f"{table.file}: rows hold the reflector {', '.join(counts)}; empty cells are left out."]


def _check(table: RawTable, column_sets: Keys[str, Sequence[str]]) -> None:
    """Raise InputError for a column that the table lacks, and for reflectors in different units."""
    units = {}
    for reflector, names in column_sets.items():
        for name in names:
            if name not in table.columns:
                raise complaint(
                    f"{table.file}, [point.{quoted_key(reflector)}]",
                    f"the column {name}",
                    f"{', '.join(table.columns)}",
                    "correct the name in the mapping file",
                )
        units[reflector] = [read_header(n, table.units.get(n)).unit for n in names]
    first = next(iter(units.values()))
    for reflector, unit in units.items():
        if unit != first:
            raise complaint(
                f"{table.file}, [point.{quoted_key(reflector)}]",
                f"the units of the first reflector ({first})",
                f"{unit}",
                "correct the headers",
            )


def reflector_lines(column_sets: Sequence[Sequence[str]]) -> str:
    """The lines of a mapping file that keep all of several sets of point columns as reflectors, on one line."""
    names = [_common_name(columns) for columns in column_sets]
    if len(set(names)) < len(names) or not all(names):
        names = [str(number) for number in range(1, len(column_sets) + 1)]
    lines = [
        f"[point.{quoted_key(name)}] columns = [{', '.join(map(json.dumps, columns))}]"
        for name, columns in zip(names, column_sets)
    ]
    return ", ".join(lines)


def _common_name(columns: Sequence[str]) -> str:
    """Common name in the headers of one point: "SMR1" of "SMR1 X", "SMR1 Y", "SMR1 Z"."""
    return os.path.commonprefix(list(columns)).strip(_SEPARATORS)


def quoted_key(name: str) -> str:
    """A key of TOML."""
    return name if _BARE.fullmatch(name) else json.dumps(name, ensure_ascii=False)
