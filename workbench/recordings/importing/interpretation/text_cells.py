"""Columns of numbers in which some cells are text, such as the dates that a spreadsheet makes of 1.3."""

import re

import numpy as np

from datasets.formats.table import is_number
from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.source import RawTable

_MAX_SHARE = 0.5
"""Share of the filled cells of a column of numbers that may be text."""
_DATE = re.compile(
    r"\d{1,4}[-./ ]?[^\W\d_]{3,}|[^\W\d_]{3,}[-./ ]?\d{1,4}|\d{1,2}[./-]\d{1,2}[./-]\d{2,4}"
)


def text_sentence(table: RawTable) -> str:
    """Sentence on cells of text in columns of joints, points or rotations, with the first of them; "" for none.

    Text in other columns, such as remarks, hides no quantity.
    """
    quantities = {name for columns in find_sets(table) for name in columns.names}
    found = {}
    for name, cells in table.columns.items():
        if cells.dtype.kind == "f" or name not in quantities:
            continue
        is_text = np.array([bool(cell) and not is_number(cell) for cell in cells])
        count_filled = np.count_nonzero(cells != "")
        if is_text.any() and is_text.sum() < _MAX_SHARE * count_filled:
            found[name] = np.flatnonzero(is_text)
    if not found:
        return ""
    name, rows = next(iter(found.items()))
    first = str(table.columns[name][rows[0]])
    count = sum(len(rows) for rows in found.values())
    columns = f"column{'s' * (len(found) > 1)} {', '.join(found)}"
    why = ": a spreadsheet makes dates of numbers such as 1.3" if _DATE.fullmatch(first) else ""
    return (
        f"{table.file}, row {table.lines[rows[0]]}, column {name}: expected a number as in most rows, found "
        f"{first!r}{why}; {count} cell{'s' * (count > 1)} of {columns} are text; format the columns as numbers in "
        "their source and export them again."
    )
