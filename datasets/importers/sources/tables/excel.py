"""Excel workbooks (.xlsx, .xlsm) through openpyxl, read row by row."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import (
    Layout,
    columns_from_text,
    find_header,
    is_number_text,
)
from datasets.importers.units import length_unit_in_text

_TITLE_ROWS = 60
_SHOWN_ROWS, _SHOWN_TEXT = 6, 40


def read_excel(path: Path) -> list[RawTable]:
    """One table per sheet that holds one.

    Raises InputError where the file is no workbook or no sheet holds a table, ModuleNotFoundError without openpyxl.
    """
    import openpyxl

    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    except Exception as problem:  # the library raises whatever the ZIP and XML readers raise
        raise complaint(
            path.name,
            "an Excel workbook",
            f"a file that cannot be read ({problem})",
            "save it again as .xlsx",
        ) from None
    tables = [_sheet_table(path, sheet) for sheet in book.worksheets]
    found = [table for table in tables if table is not None]
    if not found:
        raise complaint(
            path.name, "a sheet with a table of numbers", "none", "put one measurement in each row"
        )
    return found


def _sheet_table(path: Path, sheet) -> RawTable | None:
    """The table of a sheet, None where it holds fewer than two rows of numbers."""
    rows = [list(row) for row in sheet.iter_rows(values_only=True)]
    filled = [row for row in rows if sum(map(_is_number, row)) >= 2]
    if len(filled) < 2:
        return None
    width = max(len(row) for row in filled)
    first = next(k for k, row in enumerate(rows) if sum(map(_is_number, row)) >= 2)
    titles = [_as_line(row, width) for row in rows[max(0, first - _TITLE_ROWS) : first]]
    names, units = find_header(titles, Layout("\t", width, first))
    names = names or [f"column {k + 1}" for k in range(width)]
    data = [
        (number, row)
        for number, row in enumerate(rows, 1)
        if number > first and any(map(_is_number, row))
    ]
    lines = [number for number, _ in data]
    skipped = [
        (number, row)
        for number, row in enumerate(rows, 1)
        if number > first
        and not any(map(_is_number, row))
        and any(cell is not None for cell in row)
    ]
    called = f"{path.name}, sheet {sheet.title}"
    columns, stated = {}, {}
    for k, name in enumerate(names):
        cells = [row[k] if k < len(row) else None for _, row in data]
        if any(cell is not None for cell in cells):
            made = _typed(name, cells, called, lines)
            columns |= made
            stated |= {column: units[k] for column in made if units[k]}
    unit = length_unit_in_text(" ".join(titles))
    return RawTable(
        path.name,
        columns,
        np.array(lines),
        units=stated,
        default_units={"length": unit} if unit else {},
        warnings=_without_numbers(called, skipped),
        sheet=sheet.title,
    )


def _without_numbers(called: str, rows: Sequence[tuple[int, Sequence]]) -> tuple[str, ...]:
    """A sentence on rows below the first sample that hold text only."""
    if not rows:
        return ()
    shown = [
        f"{number} ({_text(next(cell for cell in row if cell is not None))[:_SHOWN_TEXT]!r})"
        for number, row in rows[:_SHOWN_ROWS]
    ]
    remainder = f" and {len(rows) - _SHOWN_ROWS} more" if len(rows) > _SHOWN_ROWS else ""
    is_one = len(rows) == 1
    return (
        f"{called}: {'row' if is_one else 'rows'} {', '.join(shown)}{remainder} {'holds' if is_one else 'hold'} no "
        f"number, and {'is' if is_one else 'are'} left out.",
    )


def _is_number(cell) -> bool:
    if isinstance(cell, bool):
        return False
    return isinstance(cell, int | float) or (isinstance(cell, str) and is_number_text(cell.strip()))


def _as_line(row: Sequence, width: int) -> str:
    cells = ["" if cell is None else str(cell).replace("\t", " ") for cell in row[:width]]
    return "\t".join(cells)


def _typed(name: str, cells: Sequence, called: str, lines: Sequence[int]) -> dict:
    """Columns by name: numbers as they are; numbers that were typed as text are read like those of a text file."""
    if all(cell is None or (_is_number(cell) and not isinstance(cell, str)) for cell in cells):
        return {name: np.array([np.nan if cell is None else float(cell) for cell in cells])}
    texts = ["" if cell is None else _text(cell) for cell in cells]
    return columns_from_text(name, texts, called, lines)


def _text(cell) -> str:
    return (
        cell.isoformat(sep=" ")
        if hasattr(cell, "isoformat") and hasattr(cell, "year")
        else str(cell).strip()
    )
