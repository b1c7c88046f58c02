"""Rows below a table that summarise it: sums, means, extreme values. They are no samples.

Spreadsheets end with such rows, with or without a word in front. They are recognised by their numbers: each equals
the same statistic of the cells above it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import numbers_from_text

_MOST_ROWS, _FEWEST_SAMPLES, _FEW_CELLS = 8, 8, 3
_SAME = 1e-3
"""Of the standard deviation of a column: rounding of a mean to the digits of the column, or to a few less."""
_STATISTICS = {
    "the mean": np.nanmean,
    "the sum": np.nansum,
    "the median": np.nanmedian,
    "the smallest value": np.nanmin,
    "the largest value": np.nanmax,
    "the range": lambda cells, axis: np.nanmax(cells, axis) - np.nanmin(cells, axis),
    "the standard deviation": lambda cells, axis: np.nanstd(cells, axis, ddof=1),
    "the standard deviation (n)": np.nanstd,
}


def without_summary_rows(table: RawTable) -> RawTable:
    """The table without the last rows that are statistics of the rows above, and a sentence on them."""
    cells = np.array([_numbers(column) for column in table.columns.values()])
    for count in range(min(_MOST_ROWS, table.n - _FEWEST_SAMPLES), 0, -1):
        meanings = _meanings(cells[:, :-count], cells[:, -count:])
        if None not in meanings:
            return _shortened(table, meanings)
    return table


def _numbers(column: np.ndarray) -> np.ndarray:
    """(n,) numbers of a column, nan for its text and for columns that begin with text."""
    if column.dtype.kind == "f":
        return column
    if np.isnan(_number(column[0])):
        return np.full(len(column), np.nan)
    return np.array([_number(cell) for cell in column])


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _meanings(rows_above: np.ndarray, rows_below: np.ndarray) -> list[str | None]:
    """Statistic of the rows `rows_above` (k, n) that each of the rows `rows_below` (k, m) states; None if it is no
    statistic.
    """
    varies = np.array([np.isfinite(row).sum() > 1 and np.nanstd(row) > 0 for row in rows_above])
    if not varies.any():
        return [None]
    rows_above, rows_below = rows_above[varies], rows_below[varies]
    tolerance = _SAME * np.nanstd(rows_above, axis=1)
    known = {name: statistic(rows_above, axis=1) for name, statistic in _STATISTICS.items()}
    made = []
    for row in rows_below.T:
        filled = np.isfinite(row)
        close = np.abs(rows_above - row[:, None])[filled] <= tolerance[filled, None]
        is_copy = bool(
            close.all(axis=0).any()
        )  # an arm that has come to rest at the end of a sweep
        made.append(None if is_copy else _meaning(row, known, tolerance))
    return made


def _meaning(row: np.ndarray, known: dict, tolerance: np.ndarray) -> str | None:
    filled = np.isfinite(row)
    count = filled.sum()
    wanted = count - (count > _FEW_CELLS)  # the number in front of the rows may go on counting
    for name, values in known.items():
        is_same = np.abs(row - values) <= tolerance
        if count and is_same[filled].sum() >= wanted:
            return name
    return None


def _shortened(table: RawTable, meanings: Sequence[str]) -> RawTable:
    kept = table.n - len(meanings)
    columns = {
        name: _typed(cells[:kept], f"{table.file}, column {name}", table.lines)
        for name, cells in table.columns.items()
    }
    named = ", ".join(_named(table, kept, meanings))
    is_one = len(meanings) == 1
    sentence = (
        f"{table.file}: {'row' if is_one else 'rows'} {named} of the rows above, and "
        f"{'is' if is_one else 'are'} left out."
    )
    warnings = (*table.warnings, sentence)
    return replace(table, columns=columns, lines=table.lines[:kept], warnings=warnings)


def _named(table: RawTable, kept: int, meanings: Sequence[str]) -> Iterator[str]:
    """Each row with its label and its meaning: "86 ('Mittelwert') is the mean"."""
    texts = [cells for cells in table.columns.values() if cells.dtype.kind != "f"]
    for row, meaning in enumerate(meanings, kept):
        words = [cells[row] for cells in texts if cells[row] and not _is_number(cells[row])]
        label = f" ({str(words[0])!r})" if words else ""
        yield f"{table.lines[row]}{label} is {meaning}"


def _is_number(cell: str) -> bool:
    return not np.isnan(_number(cell))


def _typed(cells: np.ndarray, where: str, lines: np.ndarray) -> np.ndarray:
    """Cells of a text column as numbers where only the rows left out had text."""
    return cells if cells.dtype.kind == "f" else numbers_from_text(cells.tolist(), where, lines)
