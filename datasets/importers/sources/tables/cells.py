"""Cells of a line of text: divided at a separator, but not inside quotes or inside a list of numbers in brackets."""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence

from datasets.importers.sources.tables.packed_cells import list_in
from datasets.importers.units import is_unit

_WITH_UNIT = re.compile(
    r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*(?:°|º|deg|grad|rad|gon|mm|cm|m|in|\"|s|ms)", re.IGNORECASE
)
_SEXAGESIMAL = re.compile(
    r"([+-]?)(\d{1,3})\s*[°º]\s*(\d{1,2})\s*['′’](?:\s*(\d{1,2}(?:[.,]\d+)?)\s*(?:\"|″|”|''))?"
)
_IN_BRACKETS = re.compile(r"[\[({][^\[\](){}]*[\])}]")
_LABELLED = re.compile(
    r"([A-Za-z]\w*)(?:(?:\s*=\s*|:\s+)([-+.\d]\S*)|\s*[=:]\s*([A-Za-z]{0,4}[\[({].*))"
)
"""Without a space behind it, a colon may be part of a name, as in A:1."""
_NUMBERED = re.compile(r"\s*([A-Za-z_]+\d+)\s*[:=]\s*(?=[A-Za-z]{0,4}[\[({])")
"""A name with a number in front of a list in brackets, as in "P17: {": it names the row, not the column."""
_SPACED_SIGN = re.compile(r"(?<=[A-Za-z\d])[ \t]{0,40}=[ \t]{1,40}(?=[-+.\d])")
_COUNTED = re.compile(r"([+-]?\d+):")
_BETWEEN_LISTS = re.compile(r"(?<=[\])}])\s*(?=[\[({])")
"""The place between two lists in brackets that nothing divides, as in "[1, 2, 3][0, 0, 1, 0]"."""
_NUMBER_OF_LIST = re.compile(r"^(\s*\d+)\s*(?=[\[({])")
"""A number in front of a list, as in "17[1, 2, 3]"."""
_OPENED = re.compile(r'(?:^|[,;\t|])\s*"')
_MOST_LINES = 40
_KEPT = "\ue000"
"""Stands for a separator inside brackets while a line is divided; no text has this character of private use."""


def whole_rows(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """(number of the first line, text) of each row; a quoted cell may go on over several lines (RFC 4180).

    A quotation mark that no later line closes, such as that of an inch, ends nothing.
    """
    waiting: list[tuple[int, str]] = []
    for number, line in enumerate(lines, 1):
        is_odd = line.count('"') % 2 == 1
        if not waiting and not (is_odd and _OPENED.search(line)):
            yield number, line
            continue
        waiting.append((number, line))
        if len(waiting) > 1 and is_odd:
            yield waiting[0][0], " ".join(text.rstrip("\r\n") for _, text in waiting)
            waiting = []
        elif len(waiting) > _MOST_LINES:
            yield from waiting
            waiting = []
    yield from waiting


def split_cells(line: str, separator: str) -> list[str]:
    """Cells of a line, stripped; double quotes, and brackets around numbers, enclose cells with separators in them.

    A cell "speed=5" is the number 5, and "12:" is 12: `labels_of` has the words.
    """
    return [_plain(cell) for cell in _divided(line, separator)]


def labels_of(line: str, separator: str) -> list[str]:
    """Labels in front of the numbers of a line: "x" of "x=1.5", and the word before a cell, as in "pose 1".

    "" where nothing does, and for words themselves.
    """
    labels, before = [], ""
    for cell in _divided(line, separator):
        match = _LABELLED.fullmatch(cell)
        is_word = cell.rstrip(":=").isidentifier() and not is_unit(cell)
        labels.append(match[1] if match else "" if is_word else before)
        before = cell.rstrip(":=") if is_word else ""
    return labels


def _divided(line: str, separator: str) -> list[str]:
    text = line.strip("\r\n")
    if separator != ";" and text.rstrip().endswith(";"):  # the end of a row, as in MATLAB
        text = text.rstrip()[:-1]
    text = _lists_kept(_lists_divided(text, separator), separator)
    framed = text.strip()
    if separator == "|" and framed.startswith("| ") and framed.endswith(" |"):  # Markdown
        text = framed[1:-1]
    numbered = _NUMBERED.match(text)
    if numbered:
        text = f"{numbered[1]}{separator}{text[numbered.end() :]}"
    return [cell.replace(_KEPT, separator) for cell in _split_at(text, separator)]


def _lists_divided(text: str, separator: str) -> str:
    """The line with a separator between lists in brackets that stand next to one another."""
    lists = _IN_BRACKETS.findall(text)
    if not lists or not all(map(list_in, lists)):
        return text
    return _NUMBER_OF_LIST.sub(rf"\g<1>{separator}", _BETWEEN_LISTS.sub(separator, text))


def _lists_kept(text: str, separator: str) -> str:
    """The line with `_KEPT` for each separator inside a list of numbers in brackets."""
    if not any(bracket in text for bracket in "[({"):
        return text
    kept = re.compile(r"\s") if separator == " " else re.compile(re.escape(separator))
    return _IN_BRACKETS.sub(lambda m: kept.sub(_KEPT, m[0]) if list_in(m[0]) else m[0], text)


def _split_at(text: str, separator: str) -> Sequence[str]:
    if separator == " ":
        return _spaced(text)
    if '"' in text:
        try:
            cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        except csv.Error:  # a cell above the size that a cell can have: no table of measurements
            cells = text.split(separator)
        return [cell.strip() for cell in cells]
    return [cell.strip() for cell in text.split(separator)]


def _spaced(text: str) -> list[str]:
    """Cells between runs of spaces or tabs; a quoted cell may hold spaces, and "X = 1.5" is one cell."""
    text = _SPACED_SIGN.sub("=", text)
    if '"' not in text:
        return text.split()
    return [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', text)]


def _plain(cell: str) -> str:
    """A cell without a label in front and without a unit behind it."""
    if not cell:
        return cell
    if cell[0].isalpha():
        labelled = _LABELLED.fullmatch(cell)
        return _without_unit(labelled[2] or labelled[3]) if labelled else cell
    counted = _COUNTED.fullmatch(cell)
    return counted[1] if counted else _without_unit(cell)


def _without_unit(cell: str) -> str:
    """The number of a cell such as "12,5°"; the unit is tested on the robot like an unstated one."""
    if not cell or cell[-1].isdigit() or not (cell[0].isdigit() or cell[0] in "+-.,"):
        return cell
    match = _WITH_UNIT.fullmatch(cell)
    if match:
        return match[1]
    angle = _SEXAGESIMAL.fullmatch(cell)
    return cell if angle is None else _degrees(angle)


def _degrees(match: re.Match) -> str:
    """The number of degrees of an angle such as 12°34'56,7"."""
    sign, degrees, minutes, seconds = match.groups(default="0")
    value = int(degrees) + int(minutes) / 60 + float(seconds.replace(",", ".")) / 3600
    return f"{'-' if sign == '-' else ''}{value:.12g}"
