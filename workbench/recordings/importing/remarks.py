"""Remarks in the user's table: text columns that nothing is read from, such as "laser lost" in some rows.

They often explain why rows do not fit, so that the import names them where it refuses a table or doubts its rows.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable

_SHOWN, _LONGEST = 4, 60
_SHORTEST = 3  # letters of a remark
_LARGEST_SHARE = 0.5
"""Of the rows that may hold a remark: text in most rows names them."""


def remarks_sentence(table: RawTable | None, mapping: Mapping) -> str:
    """The remarks with their rows in the file; "" without any."""
    if table is None:
        return ""
    shown_remarks = [_shown(table, name, rows) for name, rows in _remarks(table, mapping)]
    if not shown_remarks:
        return ""
    return (
        f"The file has remarks, which may explain rows that do not fit: {'; '.join(shown_remarks)}."
    )


def unused_sentence(table: RawTable | None, unused: tuple[str, ...]) -> str:
    """The columns that nothing is read from, for a table that is refused; "" without any."""
    names = [name for name in unused if table is not None and name in table.columns]
    if not names:
        return ""
    shown = ", ".join(f"'{name}'" for name in names[: 2 * _SHOWN])
    if len(names) > 2 * _SHOWN:
        unlisted = f" and {len(names) - 2 * _SHOWN} more"
    else:
        unlisted = ""
    return f"Columns that are not used: {shown}{unlisted}."


def _remarks(table: RawTable, mapping: Mapping) -> Iterator[tuple[str, np.ndarray]]:
    """Column and rows whose text differs from the most frequent cell, which may be empty."""
    for name in unused_columns(table, mapping):
        cells = table.columns[name]
        if cells.dtype.kind == "f" or not len(cells):
            continue
        texts = np.array([str(cell).strip() for cell in cells])
        usual = Counter(texts.tolist()).most_common(1)[0][0]
        is_remark = np.array([text != usual and _is_said(text) for text in texts])
        if 0 < is_remark.mean() <= _LARGEST_SHARE:
            yield name, np.flatnonzero(is_remark)


def _is_said(text: str) -> bool:
    """Whether a cell holds words, and not a number, a date or the name of a row."""
    letters = sum(map(str.isalpha, text))
    return letters >= _SHORTEST and letters > sum(map(str.isdigit, text))


def _shown(table: RawTable, name: str, rows: np.ndarray) -> str:
    cells = table.columns[name]
    cells_of_rows = []
    for row in rows[:_SHOWN]:
        cells_of_rows.append(f"row {table.lines[row]} '{str(cells[row]).strip()[:_LONGEST]}'")
    if len(rows) > _SHOWN:
        unlisted = f" and {len(rows) - _SHOWN} more"
    else:
        unlisted = ""
    return f"'{name}': {', '.join(cells_of_rows)}{unlisted}"
