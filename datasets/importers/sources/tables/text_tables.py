"""Delimited text of any laboratory: separator, decimal sign, header and comments are found from the lines themselves.

Understood: comma, semicolon, tab, bar or spaces between cells; decimal point or decimal comma, column by column;
lines of comments (`#`, `//`, `%`, `!`); title lines before the header; a row of units below the header; text after the
last row. The file is read line by line, so that a log of many hours takes the memory of its numbers alone.
"""

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.words import accented_words, names_something
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.axis_rows import find_axis_rows
from datasets.importers.sources.tables.cells import labels_of, split_cells, whole_rows
from datasets.importers.sources.tables.packed_cells import list_in, unpacked
from datasets.importers.units import is_unit, length_unit_in_text

_SAMPLE_LINES = 400
_COMMENT = re.compile(r"\s*(#|//|%|!|[|+]?[ :]{0,9}-{3,}[\s|+:-]*$)")
"""Also the rules below the header of a table in Markdown or of a data base: |---|---|."""
_SEPARATORS = ("\t", ";", "|", ",", " ")
_POINT = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eEdD][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eEdD][+-]?\d+)?")
_EXPONENT = str.maketrans("dD", "eE")
"""Fortran writes the exponents of double precision with D."""
_GROUPED_POINT = re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d+")
_GROUPED_QUOTE = re.compile(r"[+-]?\d{1,3}(['’\u202f\u00a0\u2009 ]\d{3})+([.,]\d+)?")
_QUOTES = str.maketrans("", "", "'’\u202f\u00a0\u2009 ")
_GROUPED_COMMA = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_EMPTY = {
    *("", "-", "--", "---", "nan", "na", "n/a", "null", "none", "k.a."),
    *("inf", "+inf", "-inf", "infinity", "1.#qnan", "-1.#ind", "1.#inf", "-1.#inf", "-nan", "+nan"),
    *("#n/a", "#nv", "#wert!", "#value!", "#div/0!", "#num!", "#zahl!", "#ref!", "#bezug!"),
}
_BRACKETED = re.compile(r"\[[^\]]*\]|\([^)]*\)|<[^>]*>")
_TIME_FORMAT = re.compile(r"[dtmyhs]{1,4}([.:/ -]+[dtmyhs]{1,4})+(\.[sf0]+)?", re.IGNORECASE)
_FEWEST_COLUMNS = 2
_POINT_WIDTH = 3  # columns of a point
_MARKLESS_BYTES, _MOSTLY = 4096, 0.8
_EUROPEAN = ("cp1252", "cp1250")
"""Encodings with one byte for a character: of the west of Europe, which is the usual one, and of its middle."""


@dataclass(frozen=True)
class Layout:
    """Layout of a text file: separator, number of cells of a row, index of the first line with data.

    `by_axis`: the table has a row for each axis of a point, and a row without a number is one that was not measured.
    """

    separator: str
    width: int
    first: int
    by_axis: bool = False


def read_text_table(path: Path) -> RawTable:
    """The table of a text file.

    Raises InputError where no table is found, a row is cut off, or a column mixes decimal signs.
    """
    encoding = encoding_of(path)
    with path.open(encoding=encoding, errors="replace", newline=None) as file:
        sample = [line for _, line in islice(whole_rows(file), _SAMPLE_LINES)]
    layout = find_layout(sample, path)
    names, units = find_header(sample[: layout.first], layout)
    cells_above = [split_cells(line, layout.separator) for line in sample[: layout.first]]
    columns, lines, warnings = _read_rows(path, encoding, layout, cells_above)
    names = names_from_rows(names, columns, sample[layout.first], layout)
    names = names or names_without_header(path, layout.width)
    used = _used_columns(columns)
    table, stated = {}, {}
    for k in used:
        made = _typed_columns(names[k], columns[k], path.name, lines)
        table |= made
        stated |= {name: units[k] for name in made if units[k]}
    comment = " ".join(sample[: layout.first])
    unit = length_unit_in_text(comment)
    return RawTable(
        path.name,
        table,
        np.array(lines),
        units=stated,
        default_units={"length": unit} if unit else {},
        warnings=tuple(warnings),
    )


def names_from_rows(
    header: list[str] | None, columns: Sequence["_Column"], row: str, layout: Layout
) -> list[str] | None:
    """The header, or names from the rows themselves where it says nothing: "speed=5", or a word before a number.

    header: names above the data. row: the first line with data. The word before a number counts only where all rows
    have it.
    """
    labels = labels_of(row, layout.separator)
    is_known = header is not None and any(read_header(name).kind for name in header)
    if is_known or len(labels) != layout.width or not any(labels):
        return header
    for k in range(1, layout.width):
        before = columns[k - 1].texts or [""]
        if before[0].rstrip(":=") == labels[k] and len(set(before)) > 1:
            labels[k] = ""
    return _unique(labels) if any(labels) else header


def names_without_header(path: Path, width: int) -> list[str]:
    """Names of the columns of a file without header: by its own name where that says what it holds, else by number.

    "measured_joints.txt" holds "measured_joints 1", "measured_joints 2", ... One letter says nothing, and neither does
    the name of a point for columns that are not three.
    """
    stem = re.sub(r"[\s_-]*\d+$", "", path.stem)
    names = [f"{stem} {k + 1}" for k in range(width)]
    kinds = ("joint", "numbered", "qindex") if width == _POINT_WIDTH else ("joint", "qindex")
    is_known = len(stem) > 1 and all(read_header(name).kind in kinds for name in names)
    return names if is_known else [f"column {k + 1}" for k in range(width)]


def encoding_of(path: Path) -> str:
    """Name of the text encoding: UTF-16 and UTF-8 by their marks, else UTF-8 where it decodes.

    Of the other encodings, GB 18030 or Shift JIS where the text then holds a known word of Chinese or Japanese, else
    Windows-1252 or Windows-1250, by the known words with accents.
    """
    with path.open("rb") as file:
        head = file.read(1 << 20)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if b"\0" in head[:_MARKLESS_BYTES]:
        return _without_mark(head[:_MARKLESS_BYTES])
    try:
        head[: len(head) - 4].decode("utf-8") if len(head) > 8 else head.decode("utf-8")
    except UnicodeDecodeError:
        return _eight_bit_encoding(head)
    return "utf-8"


def _without_mark(head: bytes) -> str:
    """UTF-16 in the byte order by which most characters are those of ASCII; "utf-8" where neither is text."""
    zeros = [head[side::2].count(0) / max(len(head[side::2]), 1) for side in (0, 1)]
    if zeros[1] > _MOSTLY > zeros[0]:
        return "utf-16-le"
    return "utf-16-be" if zeros[0] > _MOSTLY > zeros[1] else "utf-8"


def _eight_bit_encoding(head: bytes) -> str:
    for name in ("gb18030", "cp932"):
        try:
            text = head[: len(head) - 4].decode(name) if len(head) > 8 else head.decode(name)
        except UnicodeDecodeError:
            continue
        if names_something(text):
            return name
    known = {name: accented_words(head.decode(name, errors="replace")) for name in _EUROPEAN}
    return max(_EUROPEAN, key=known.get)


def find_layout(lines: Sequence[str], path: Path) -> Layout:
    """The separator by which most cells of most lines are numbers in equally many columns.

    Raises InputError where no separator gives a table.
    """
    by_axis = find_axis_rows(lines)
    if by_axis is not None:
        return Layout(*by_axis, by_axis=True)
    best, best_score = None, 0.0
    for separator in _SEPARATORS:
        found = _layout_with(lines, separator)
        if found is None:
            continue
        layout, score = found
        if separator == " " and best is not None and _only_first_has_header(best, layout, lines):
            continue
        if score > best_score:
            best, best_score = layout, score
    if best is None:
        raise complaint(
            path.name,
            "a table of numbers with a separator between the cells",
            "no two lines that are divided alike",
            "export the table as CSV with one row per measurement",
        )
    return best


def _only_first_has_header(first: Layout, spaces: Layout, lines: Sequence[str]) -> bool:
    """Whether the line above the data has as many cells as the rows by tabs, but not by spaces: names with spaces."""
    if first.separator != "\t" or not first.first:
        return False
    header = lines[first.first - 1]
    widths = [len(split_cells(header, layout.separator)) for layout in (first, spaces)]
    return widths[0] == first.width and widths[1] != spaces.width


def _layout_with(lines: Sequence[str], separator: str) -> tuple[Layout, float] | None:
    """The layout with a separator, and the number of cells with numbers per line that it explains."""
    widths: Counter = Counter()
    numeric: dict[int, int] = {}
    first: dict[int, int] = {}
    total = 0
    for number, line in enumerate(lines):
        if not line.strip() or _COMMENT.match(line):
            continue
        total += 1
        cells = split_cells(line, separator)
        numbers = sum(map(_count_of_numbers, cells))
        is_row = len(cells) >= _FEWEST_COLUMNS or bool(list_in(cells[0]))
        if is_row and numbers >= max(2, len(cells) / 3):
            widths[len(cells)] += 1
            numeric[len(cells)] = numeric.get(len(cells), 0) + numbers
            first.setdefault(len(cells), number)
    if not widths:
        return None
    width = max(widths, key=lambda w: numeric[w])
    share = widths[width] / total
    return Layout(separator, width, first[width]), numeric[width] / widths[width] * share


def _count_of_numbers(cell: str) -> int:
    """1 for a number, the length of a list in brackets, 0 for anything else.

    A number with spaces between its thousands counts as often as spaces divide it, so that spaces explain no more.
    """
    return len(cell.split()) if is_number_text(cell) else len(list_in(cell))


def is_number_text(cell: str) -> bool:
    """Whether a cell is a number with decimal point or decimal comma."""
    return any(
        pattern.fullmatch(cell)
        for pattern in (_POINT, _COMMA, _GROUPED_POINT, _GROUPED_COMMA, _GROUPED_QUOTE)
    )


def find_header(lines: Sequence[str], layout: Layout) -> tuple[list[str] | None, list[str]]:
    """Names of the columns, None without a header, and the unit of each ("" where none is stated).

    The header is the last line before the data that has as many cells; a line of units may stand below it, and a
    line with the names of groups of columns above it.
    """
    units = [""] * layout.width
    for number in range(len(lines) - 1, -1, -1):
        cells = _divided(lines[number], layout)
        if cells is None:
            continue
        if is_unit_row(cells) and not any(units):
            units = [cell.strip("[]()<> ") for cell in cells]
            continue
        cells_above = _divided(lines[number - 1], layout) if number else None
        grouped = with_group_names(cells, cells_above)
        if sum(map(bool, grouped)) < max(1, layout.width - 1):
            continue
        if all(is_number_text(cell) for cell in cells if cell):
            continue
        return _unique(grouped), units
    return None, units


def _divided(line: str, layout: Layout) -> list[str] | None:
    """The cells of a line above the data, a comment sign removed; None where their number is another."""
    text = _COMMENT.sub("", line, count=1) if _COMMENT.match(line) else line
    for separator in dict.fromkeys((layout.separator, *_SEPARATORS)):
        cells = split_cells(text.strip(" \r\n"), separator)
        while len(cells) > layout.width and not cells[-1]:
            cells.pop()
        if len(cells) == layout.width - 1 and separator != " ":
            cells.append("")  # a separator at the end of the rows, but not of the header
        if len(cells) == layout.width and any(cells):
            return cells
    return None


def is_unit_row(cells: Sequence[str]) -> bool:
    """Whether a row holds units: every filled cell is a unit, a time format, or stands in brackets."""
    filled = [cell for cell in cells if cell.strip("[]()<> -")]
    has_unit = any(is_unit(cell.strip("[]()<> ")) for cell in filled)
    return has_unit and all(
        is_unit(cell.strip("[]()<> ")) or _BRACKETED.fullmatch(cell) or _TIME_FORMAT.fullmatch(cell)
        for cell in filled
    )


def with_group_names(cells: Sequence[str], cells_above: Sequence[str] | None) -> list[str]:
    """The header with the names of groups of columns, such as merged cells of a spreadsheet, in front of its cells.

    cells_above: the row over the header, None for none. A group reaches to the next filled cell. The row counts as one
    of groups only if the header needs it (empty cells, or names that stand twice) and at least two groups have names.
    """
    names = list(cells)
    filled = [cell for cell in names if cell]
    needs_groups = len(filled) < len(names) or len(set(filled)) < len(filled)
    labels = [cell for cell in cells_above or () if cell]
    if not needs_groups or len(labels) < 2 or any(map(is_number_text, labels)):
        return names
    group = ""
    for k, (label, cell) in enumerate(zip(cells_above, names)):
        group = label or group
        names[k] = f"{group} {cell}".strip()
        if label and not cell:  # a cell that reaches over both rows names its own column only
            group = ""
    return names


def _unique(cells: Sequence[str]) -> list[str]:
    """Names of columns: what is empty or stands twice gets its number."""
    counts = Counter(cells)
    seen: Counter = Counter()
    names = []
    for number, cell in enumerate(cells, 1):
        seen[cell] += 1
        plain = cell or f"column {number}"
        names.append(
            f"{plain} ({seen[cell]})" if cell and counts[cell] > 1 and seen[cell] > 1 else plain
        )
    return names


def _read_rows(path: Path, encoding: str, layout: Layout, cells_above: Sequence[list[str]]):
    """Columns of cells, line numbers, and sentences on lines that are no rows of the table.

    cells_above: cells of the lines above the data, which files that were joined repeat.
    """
    columns = [_Column() for _ in range(layout.width)]
    lines: list[int] = []
    foreign: list[int] = []
    repeated: list[int] = []
    for number, cells in _data_lines(path, encoding, layout):
        if cells in cells_above:
            repeated.append(number)
            continue
        is_row = layout.by_axis or any(map(_count_of_numbers, cells))
        if len(cells) != layout.width or not is_row:
            foreign.append(number)
            continue
        lines.append(number)
        for column, cell in zip(columns, cells):
            column.append(cell)
    foreign_inside = [number for number in foreign if lines and number < lines[-1]]
    if foreign_inside:
        raise complaint(
            f"{path.name}, row {foreign_inside[0]}",
            f"{layout.width} cells as in the other rows",
            "a row that is divided otherwise",
            "correct or remove the row",
        )
    warnings = []
    if repeated:
        remainder = f", as are {len(repeated) - 1} further rows" if len(repeated) > 1 else ""
        warnings.append(
            f"{path.name}: row {repeated[0]} repeats a line above the data and is left out{remainder}."
        )
    if foreign:
        warnings.append(
            f"{path.name}: rows {foreign[0]} to {foreign[-1]} after the table are not read."
        )
    return columns, lines, warnings


def _data_lines(path: Path, encoding: str, layout: Layout) -> Iterator[tuple[int, list[str]]]:
    with path.open(encoding=encoding, errors="replace", newline=None) as file:
        for place, (number, line) in enumerate(whole_rows(file)):
            if place < layout.first or not line.strip() or _COMMENT.match(line):
                continue
            cells = split_cells(line, layout.separator)
            while len(cells) > layout.width and not cells[-1]:
                cells.pop()
            if layout.by_axis:
                cells += [""] * (layout.width - len(cells))
            yield number, cells


class _Column:
    """Cells of one column: numbers as long as they have one decimal sign, else the text of all."""

    def __init__(self):
        self.numbers = array("d")
        self.sign = ""
        self.texts: list[str] | None = None

    def append(self, cell: str) -> None:
        if self.texts is None and self._appended(cell):
            return
        if self.texts is None:
            self.texts = [self._text(value) for value in self.numbers]
        self.texts.append(cell)

    def _appended(self, cell: str) -> bool:
        if cell.lower() in _EMPTY:
            self.numbers.append(np.nan)
            return True
        sign = "." if _POINT.fullmatch(cell) else "," if _COMMA.fullmatch(cell) else None
        if sign is None:
            return False
        if sign in cell:
            self.sign = self.sign or sign
            if self.sign != sign:
                return False
        self.numbers.append(float(cell.replace(",", ".").translate(_EXPONENT)))
        return True

    def _text(self, value: float) -> str:
        return "" if value != value else _shortest(value).replace(".", self.sign or ".")


def _shortest(value: float) -> str:
    is_whole = abs(value) < 1e15 and value == int(value)
    return str(int(value)) if is_whole else repr(value)


def _used_columns(columns: Sequence[_Column]) -> list[int]:
    """Indices of the columns with at least one cell that is filled."""
    used = []
    for k, column in enumerate(columns):
        filled = (
            any(column.texts) if column.texts is not None else any(v == v for v in column.numbers)
        )
        if filled:
            used.append(k)
    return used


def _typed_columns(name: str, column: _Column, file: str, lines: Sequence[int]) -> dict:
    """A column by its name: numbers where all cells are numbers with one decimal sign, else text.

    Several columns where its header names the several numbers of each cell.
    """
    if column.texts is None:
        return {name: np.array(column.numbers)}
    return columns_from_text(name, column.texts, file, lines)


def columns_from_text(
    name: str, texts: Sequence[str], file: str, lines: Sequence[int]
) -> dict[str, np.ndarray]:
    """One column of cells by its name, or several where its header names the several numbers of each cell.

    Raises InputError where cells may be one number or several, or mix decimal signs.
    """
    where = f"{file}, column {name}"
    filled = ["" if cell.lower() in _EMPTY else cell for cell in texts]
    several = unpacked(name, filled, where, lines)
    if several is None:
        return {name: numbers_from_text(texts, where, lines)}
    return {
        column: numbers_from_text(cells, f"{file}, column {column}", lines)
        for column, cells in zip(*several)
    }


def numbers_from_text(texts: Sequence[str], where: str, lines: Sequence[int]) -> np.ndarray:
    """(n,) numbers with a decimal comma, or with thousands separators; text where not all cells are numbers.

    Raises InputError where some cells have a decimal point and others a decimal comma.
    """
    filled = [cell for cell in texts if cell.lower() not in _EMPTY]
    if not all(map(is_number_text, filled)):
        return np.array(texts)
    if any(map(_GROUPED_QUOTE.fullmatch, filled)):
        texts = [cell.translate(_QUOTES) for cell in texts]
    commas = [
        k for k, cell in enumerate(texts) if "," in cell and not _GROUPED_POINT.fullmatch(cell)
    ]
    points = [
        k for k, cell in enumerate(texts) if "." in cell and not _GROUPED_COMMA.fullmatch(cell)
    ]
    if commas and points:
        raise complaint(
            where,
            "one decimal sign in the whole column",
            f"{texts[commas[0]]!r} in row {lines[commas[0]]} and {texts[points[0]]!r} in row {lines[points[0]]}",
            "export the table again with one decimal sign",
        )
    if commas:
        plain = [cell.replace(".", "").replace(",", ".") for cell in texts]
    else:
        plain = [cell.replace(",", "") for cell in texts]
    return np.array([_number(cell) for cell in plain])


def _number(cell: str) -> float:
    """The number of a cell with a decimal point, nan for an empty one."""
    return np.nan if cell.lower() in _EMPTY else float(cell.translate(_EXPONENT))
