"""CSV and Parquet tables as named columns, with every wrong cell named by row and column."""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from datasets.errors import InputError, complaint
from datasets.files import check_file, read_text
from workbench.core.text.csv_text import unprotect_cell

_AT_A_TIME = 5_000  # rows of a CSV file
_MOST_COLUMNS = 2_000
_LONGEST_TEXT, _LONGEST_NUMBER = (
    2_000,
    100,
)  # characters of a cell; numpy gives every cell this room


@dataclass(frozen=True, eq=False)
class UserColumns:
    """The columns of a table as its user wrote them, in their order and units, where `Table.columns` are converted.

    `joints`: column and size of its unit, deg or mm, of each joint reading; () where the table has none.
    """

    columns: Mapping[str, np.ndarray]
    joints: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file: (n,) float64 where numeric, (n,) str where the column is text."""

    called: str
    columns: dict[str, np.ndarray]
    rows: np.ndarray
    """(n,) row numbers as a spreadsheet shows them: the header of a CSV file is row 1."""
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Columns of groups that hold names: name k stands for the number k + 1 in the column."""
    origin: UserColumns | None = None
    """Of a table of targets in other columns than those of the recording format; None elsewhere."""
    time_origin: float | str | None = None
    """Of such a table: the moment of time_s = 0, s of a numeric clock or an ISO 8601 time stamp; None without times."""

    def where(self, index: int, column: str) -> str:
        """Place of one cell for an error sentence."""
        sample = self.columns.get("sample")
        known = sample is not None and sample.dtype.kind == "f" and column != "sample"
        named = f" (sample {sample[index]:.0f})" if known and np.isfinite(sample[index]) else ""
        return f"{self.called}, row {self.rows[index]}{named}, column {column}"


def read_table(
    path: Path,
    called: str,
    text: tuple[str, ...] = (),
    blanks: bool = False,
    groups: tuple[str, ...] = (),
) -> Table:
    """The table at `path`, CSV or Parquet by its suffix; columns named in `text` stay text.

    blanks: an empty cell of a CSV file is nan, and every other one a finite number. groups: columns whose
    cells are all numbers or all names; names become numbers in the order in which they first occur. Raises
    InputError, which names row and column, for everything that is no such table.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        table = number_groups(_read_csv(path, called, text + groups, blanks), groups)
    elif suffix in (".parquet", ".pq"):
        table = number_groups(_read_parquet(path, called, text, groups), groups)
    else:
        raise complaint(
            called, "a .csv or .parquet file", f"the ending {suffix or 'none'!r}", "save it as one"
        )
    if not len(table.rows):
        raise complaint(
            called, "at least one row below the header", "none", "record samples or export it again"
        )
    return table


def number_groups(table: Table, groups: tuple[str, ...]) -> Table:
    """The table with names of groups replaced by numbers 1, 2, ... in the order in which they first occur."""
    columns, names = dict(table.columns), {}
    for group in groups:
        values = columns.get(group)
        if values is None or values.dtype.kind == "f":
            continue
        if any(is_number(cell) for cell in values):
            columns[group] = _numbers(group, values.tolist(), table.rows, table.called)
            continue
        if (values == "").any():
            row = table.rows[int(np.argmax(values == ""))]
            raise complaint(
                f"{table.called}, row {row}, column {group}",
                "a name or a number",
                "an empty cell",
                "fill it, or delete the row or the whole column",
            )
        found, first, number = np.unique(values, return_index=True, return_inverse=True)
        rank = np.argsort(np.argsort(first))
        columns[group] = rank[number].astype(float) + 1
        names[group] = tuple(found[np.argsort(first)].tolist())
    return replace(table, columns=columns, names=names)


def _read_csv(path: Path, called: str, text: tuple[str, ...], blanks: bool) -> Table:
    """Some rows at a time: a cell as text takes ten times the room of a number."""
    lines = _lines(read_text(path, called), called)
    first = next(lines, None)
    if first is None:
        raise complaint(
            called, "a header row with column names", "no text at all", "export it again"
        )
    header = _check_header([_text_of(cell) for cell in first[1]], called)
    blocks = [_part((), header, called, text, blanks)]
    while body := list(islice(lines, _AT_A_TIME)):
        blocks.append(_part(body, header, called, text, blanks))
    row_blocks = blocks[1:] or blocks
    return Table(
        called,
        {name: np.concatenate([part[1][name] for part in row_blocks]) for name in header},
        np.concatenate([part[0] for part in row_blocks]),
    )


def _part(body, header, called, text, blanks) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Row numbers (m,) and columns (m,) of some numbered rows of cells."""
    for number, row in body:
        _check_width(row, header, number, called)
    rows = np.array([number for number, _ in body], int)
    columns = {}
    for k, name in enumerate(header):
        cells = [row[k] for _, row in body]
        columns[name] = _column(name, cells, rows, called, name in text, blanks)
    return rows, columns


def _lines(content: str, called: str) -> Iterator[tuple[int, list[str]]]:
    """Numbers and cells of the rows that hold something."""
    number = 0
    try:
        for number, cells in enumerate(csv.reader(_split(content), strict=True), 1):
            if any(cell.strip() for cell in cells):
                yield number, cells
    except csv.Error as problem:
        raise complaint(
            f"{called}, row {number + 1}",
            "comma-separated values",
            f"a row that breaks off ({problem})",
            "mind the quotes, or export it again",
        ) from None


def _split(content: str) -> Iterator[str]:
    """Its lines with their ends; io.StringIO would hold four bytes a letter."""
    return (found.group() for found in re.finditer(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+$", content))


def _check_header(header: list[str], called: str) -> list[str]:
    where = f"{called}, row 1"
    if any("\0" in cell for cell in header):
        raise complaint(
            where,
            "UTF-8 text",
            "zero bytes, as in UTF-16 text or a binary file",
            'save it as "CSV UTF-8 (comma delimited)"',
        )
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) < 3 and any(mark in cell for cell in header):
            raise complaint(
                where,
                "columns separated by commas",
                f"columns separated by {name}",
                'save it as "CSV UTF-8 (comma delimited)", numbers with a decimal point',
            )
    if "" in header:
        raise complaint(
            f"{where}, column {header.index('') + 1}",
            "a column name",
            "an empty cell",
            "name the column or delete it",
        )
    _check_column_count(len(header), called)
    for name, count in Counter(header).items():
        if count > 1:
            raise complaint(
                f"{where}, column {name}",
                "every column once",
                f"it {count} times",
                "delete or rename one of them",
            )
    return header


def _check_column_count(found: int, called: str) -> None:
    if found > _MOST_COLUMNS:
        raise complaint(
            called,
            f"at most {_MOST_COLUMNS} columns",
            f"{found}",
            "delete the columns that are not needed, or transpose the table",
        )


def _check_width(row: list[str], header: list[str], number: int, called: str) -> None:
    if len(row) == len(header):
        return
    has_more = len(row) > len(header)
    do = (
        "write numbers with a decimal point, not a comma"
        if has_more
        else "fill the missing cells or delete the row"
    )
    raise complaint(
        f"{called}, row {number}, column {header[min(len(row), len(header)) - 1]}",
        f"{len(header)} cells as in the header",
        f"{len(row)} cells",
        do,
    )


def _column(
    name: str, cells: list[str], rows: np.ndarray, called: str, text: bool, blanks: bool
) -> np.ndarray:
    if text:
        return _texts(name, cells, rows, called)
    cells = [cell.strip() for cell in cells]
    if blanks:
        return _with_blanks(name, cells, rows, called)
    return _numbers(name, cells, rows, called)


def _check_lengths(
    name: str, cells: list[str], rows: np.ndarray, called: str, longest: int
) -> None:
    """Raise InputError for a cell with more than `longest` characters."""
    for number, cell in zip(rows, cells):
        if len(cell) > longest:
            raise complaint(
                f"{called}, row {number}, column {name}",
                f"at most {longest} characters",
                f"{len(cell)}",
                "shorten the cell, or keep long notes in a file of their own",
            )


def _texts(name: str, cells: list[str], rows: np.ndarray, called: str) -> np.ndarray:
    _check_lengths(name, cells, rows, called, _LONGEST_TEXT)
    for number, cell in zip(rows, cells):
        if "\0" in cell:
            raise complaint(
                f"{called}, row {number}, column {name}",
                "text",
                "a zero byte in it",
                "correct the cell",
            )
    return np.array([_text_of(cell) for cell in cells], dtype=str)


def _text_of(cell: str) -> str:
    """The text of a cell, without the apostrophe that protects a formula; spaces around any other text are dropped."""
    plain = unprotect_cell(cell)
    return plain if plain != cell else cell.strip()


def _with_blanks(name: str, cells: list[str], rows: np.ndarray, called: str) -> np.ndarray:
    filled = np.array([bool(cell) for cell in cells], bool)
    values = np.full(len(cells), np.nan)
    values[filled] = _numbers(name, [cell for cell in cells if cell], rows[filled], called)
    if (wrong := filled & ~(np.abs(values) < 1e12)).any():
        k = int(np.argmax(wrong))
        raise complaint(
            f"{called}, row {rows[k]}, column {name}",
            "a finite number or an empty cell",
            cells[k],
            "correct the cell",
        )
    return values


def _numbers(name: str, cells: list[str], rows: np.ndarray, called: str) -> np.ndarray:
    _check_lengths(name, cells, rows, called, _LONGEST_NUMBER)
    try:
        return np.array(cells, dtype=str).astype(float)
    except ValueError:
        bad = next(k for k, cell in enumerate(cells) if not is_number(cell))
    cell, where = cells[bad], f"{called}, row {rows[bad]}, column {name}"
    if not cell:
        raise complaint(
            where, "a number", "an empty cell", "fill it, or delete the row or the whole column"
        )
    if is_number(cell.replace(",", ".")):
        raise complaint(
            where,
            "a number with a decimal point",
            f"the decimal comma of {cell!r}",
            "write a point",
        )
    raise complaint(
        where,
        "a number",
        repr(cell)[:40],
        'correct it, delete the row, or move text into a column named "note"',
    )


def is_number(cell: str) -> bool:
    """Whether a cell of text is a number; nan and inf are."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_parquet(
    path: Path, called: str, text: tuple[str, ...], groups: tuple[str, ...] = ()
) -> Table:
    import pyarrow.parquet

    check_file(path, called, ".parquet")
    checked = dict(memory_map=False, page_checksum_verification=True)
    with parquet_errors(called), pyarrow.parquet.ParquetFile(path, **checked) as file:
        found = file.read()
        named = tuple(
            name
            for name in groups
            if name in found.column_names and _holds_text(found.column(name))
        )
        return arrow_table(found, called, text + named)


@contextmanager
def parquet_errors(called: str) -> Iterator[None]:
    """InputError where pyarrow cannot read a file, or a name in it is not UTF-8."""
    import pyarrow

    try:
        yield
    except InputError:
        raise
    except UnicodeDecodeError as problem:
        shown = problem.object.decode("utf-8", "backslashreplace")[:60]
        raise complaint(
            f"{called}, column {shown}",
            "column names in UTF-8",
            "another encoding",
            "rename the column",
        ) from None
    except (pyarrow.ArrowException, OSError, ValueError, TypeError, KeyError) as problem:
        why = str(problem).partition("\n")[0][:90]
        raise complaint(
            called,
            "a Parquet file",
            f"one that cannot be read ({why})",
            "write it again, or save the samples as samples.csv",
        ) from None


def arrow_table(found, called: str, text: tuple[str, ...] = (), first_row: int = 1) -> Table:
    """Columns of a pyarrow table or record batch whose first row is row `first_row` of the file; InputError where one
    cannot be."""
    names = _arrow_names(found, called)
    rows = np.arange(first_row, first_row + found.num_rows)
    columns = {}
    for k, name in enumerate(names):
        columns[name] = _arrow_column(found.column(k), name, called, name in text)
    return Table(called, columns, rows)


def _arrow_names(found, called: str) -> list[str]:
    """Names of the columns, without spaces around them; InputError where one is no text, empty, or there twice."""
    names = [name.strip() for name in found.column_names]
    _check_column_count(len(names), called)
    for k, name in enumerate(names, 1):
        if not name:
            raise complaint(
                f"{called}, column {k}",
                "a column name",
                "an empty one",
                "name the column or delete it",
            )
        if names.count(name) > 1:
            raise complaint(
                f"{called}, column {name}", "every column once", "it twice", "rename one of them"
            )
    return names


def _holds_text(column) -> bool:
    from pyarrow import types

    kind = column.type.value_type if types.is_dictionary(column.type) else column.type
    return types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind)


def _arrow_column(column, name: str, called: str, text: bool) -> np.ndarray:
    import pyarrow
    from pyarrow import types

    if types.is_dictionary(column.type):  # pandas writes its categories so
        column = column.cast(column.type.value_type)
    where, kind = f"{called}, column {name}", column.type
    is_text = _holds_text(column)
    numeric = types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
    if not (is_text if text else numeric):
        raise complaint(
            where,
            "text" if text else "numbers",
            f"the column type {kind}",
            "convert the column, or delete it",
        )
    try:
        values = column.to_pylist() if text else column.cast(pyarrow.float64(), safe=False)
    except UnicodeDecodeError:
        raise complaint(
            where, "text in UTF-8", "a cell in another encoding", "write the column again as UTF-8"
        ) from None
    if column.null_count:
        row = int(np.flatnonzero(column.is_null().to_numpy())[0]) + 1
        raise complaint(
            f"{called}, row {row}, column {name}",
            "a value",
            "none (null)",
            "fill it, or delete the row or the whole column",
        )
    if text:
        _check_lengths(name, values, np.arange(1, len(values) + 1), called, _LONGEST_TEXT)
        return np.array(values, dtype=str)
    return values.to_numpy().astype(float)
