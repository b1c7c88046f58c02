"""Comma-separated values that every reader splits alike, and in which no text cell is run as a formula.

Quoting follows RFC 4180. A spreadsheet runs a text cell that begins with `=`, `+`, `-`, `@`, a tab or a line end as a
formula, quoted or not (OWASP, "CSV Injection"). Such a cell is written with one apostrophe in front, which
`unprotect_cell` removes again. Text that already has apostrophes before such a character gets one more, so that every
text is read back as it was. Cells that are numbers stay as they are.
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import TextIO

_APOSTROPHE = "'"
# The full-width forms count too: spreadsheets of East Asian locales take them for the plain characters.
_FORMULA = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|nan)", re.ASCII)


def protect_cell(cell: object) -> object:
    """The cell as it is written: a text that a spreadsheet would run as a formula gets an apostrophe in front.

    Anything but text, and text that is a number, is returned as it is.
    """
    if not isinstance(cell, str) or not _FORMULA.match(cell) or _NUMBER.fullmatch(cell):
        return cell
    return _APOSTROPHE + cell


def unprotect_cell(cell: str) -> str:
    """The text that `protect_cell` was given."""
    is_protected = cell.startswith(_APOSTROPHE) and _FORMULA.match(cell)
    return cell[1:] if is_protected else cell


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """CSV text of a header and rows of cells, lines ended by a line feed."""
    file = io.StringIO()
    write_rows(file, [list(header)])
    write_rows(file, rows)
    return file.getvalue()


def write_rows(file: TextIO, rows: Iterable[Iterable[object]]) -> None:
    """Write rows of cells; open the file with newline="" so that line ends inside cells stay what they are."""
    writer = csv.writer(file, lineterminator="\n")
    quoted = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for row in rows:
        cells = [protect_cell(cell) for cell in row]
        # Python before 3.13 leaves a cell with a lone carriage return unquoted, and readers end the row there.
        has_return = any(isinstance(cell, str) and "\r" in cell for cell in cells)
        (quoted if has_return else writer).writerow(cells)


def protect_text_columns(table):
    """The pyarrow table with every text cell protected, for pyarrow's own CSV writer; names of columns included."""
    import pyarrow

    columns = [_protect_column(column) for column in table.columns]
    names: Sequence[str] = [str(protect_cell(name)) for name in table.column_names]
    return pyarrow.table(columns, names=names)


def _protect_column(column):
    import pyarrow
    from pyarrow import types

    if not (types.is_string(column.type) or types.is_large_string(column.type)):
        return column
    return pyarrow.array([protect_cell(cell) for cell in column.to_pylist()], column.type)
