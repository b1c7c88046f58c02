"""Tables in other shapes as one row per sample: rows of axes or of lengths, or a column for each sample.

Measuring software writes a line for each controlled dimension (PolyWorks: Name, Control, Nom, Meas, ...), and scripts
write transposed tables. Both are recognised by their cells, whatever file they come from.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.sets import find_sets, headers_of
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.axis_rows import AXES, rows_of_axes
from datasets.importers.sources.tables.length_pairs import two_rows_per_length
from workbench.core.errors import InputError

_MOST_QUANTITIES = 2000
_ACTUAL = frozenset("meas measured measurement actual act ist istwert value wert".split())


def one_row_per_sample(table: RawTable) -> RawTable:
    """The table with a row for each sample; the same table where it has that shape already.

    Raises InputError for a table with more columns than quantities can have: reading their headers would take minutes.
    """
    if len(table.columns) > _MOST_QUANTITIES:
        return _transposed(table) or _refuse_width(table)
    of_lengths = two_rows_per_length(table)
    if of_lengths is not None or find_sets(table):
        return of_lengths or table
    return _unstacked(table) or _transposed(table) or table


def _refuse_width(table: RawTable) -> RawTable:
    raise InputError(
        f"{table.file}: expected one column for each quantity (at most {_MOST_QUANTITIES}), found "
        f"{len(table.columns)} columns; write one row for each sample"
    )


def _unstacked(table: RawTable) -> RawTable | None:
    """Columns X, Y, Z of a table with one row for each of them; None for another table."""
    for name, cells in table.columns.items():
        if cells.dtype.kind == "f":
            continue
        rows = rows_of_axes([str(cell).strip().lower() for cell in cells])
        if rows is not None:
            kept = table.take(np.array(rows))
            value = _value_column(kept)
            return None if value is None else _points(kept, name, value)
    return None


def _value_column(table: RawTable) -> str | None:
    """The column of measured values: the one that is named so, or the only column of numbers."""
    numeric = [name for name, cells in table.columns.items() if cells.dtype.kind == "f"]
    named = [name for name in numeric if _ACTUAL & set(_words(name))]
    if len(named) == 1:
        return named[0]
    return numeric[0] if len(numeric) == 1 else None


def _words(name: str) -> Sequence[str]:
    header = read_header(name)
    return (*header.words, header.core)


def _points(table: RawTable, axis: str, value: str) -> RawTable:
    """One row for each point: its name, and its three values."""
    rows = slice(0, None, len(AXES))
    columns: dict[str, np.ndarray] = {}
    for name, header in headers_of(table).items():
        if name != axis and header.kind in ("name", "sample", "pose"):
            columns[name] = table.columns[name][rows]
    points = table.columns[value].reshape(-1, len(AXES))
    unit = read_header(value, table.units.get(value)).unit
    units = {letter.upper(): unit for letter in AXES if unit}
    columns |= {letter.upper(): points[:, k] for k, letter in enumerate(AXES)}
    return replace(table, columns=columns, lines=table.lines[rows], units=units)


def _transposed(table: RawTable) -> RawTable | None:
    """A table whose first column holds the headers, as one with these headers; None for another table."""
    names = list(table.columns)
    if len(names) < 3:
        return None
    labels, numbers = table.columns[names[0]], [table.columns[name] for name in names[1:]]
    if labels.dtype.kind == "f" or len(set(labels.tolist())) < len(labels):
        return None
    if any(cells.dtype.kind != "f" for cells in numbers):
        return None
    values = np.stack(numbers, axis=1)
    columns = {str(label).strip(): row for label, row in zip(labels, values)}
    lines = np.arange(2, len(numbers) + 2)
    made = replace(table, columns=columns, lines=lines, units={})
    return made if find_sets(made) else None
