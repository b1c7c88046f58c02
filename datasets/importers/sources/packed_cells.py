"""Cells that hold several numbers: a position written as "101 202 300" in one cell of a table.

Such a cell may also be one number with thousands separators. The header decides where it names as many quantities as
the cell has groups ("X Y Z", "Position XYZ [mm]"). Where it does not, a column whose cells all have the same three
groups or more is a question, since numbers of one quantity hardly ever have nine digits in every row.
"""

import re
from collections.abc import Sequence

from datasets.errors import complaint
from datasets.importers.mapping.headers import read_header

_SPACE = " \u00a0\u2009\u202f"
_GAPS = re.compile(f"[{_SPACE}]+")
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(f"[+-]?\\d{{1,3}}(?:[{_SPACE}]\\d{{3}})+")
_BRACKETS = re.compile(r"\s*[\[(<{]([^\])>}]*)[\])>}]\s*$")
_LETTERS = ("xyz", "abc", "wpr", "wxyz", "xyzw")
_FEWEST = 2
_MANY = 3


def unpacked(name: str, cells: Sequence[str], where: str, lines: Sequence[int]):
    """(names, columns) of a column whose cells hold several numbers each, where its header names them; else None.

    cells (n,), empty ones included; where: the column in error sentences; lines (n,): rows of the file. Raises
    InputError for a column of a known quantity that may be one number or several.
    """
    groups = [_GAPS.split(cell) if cell else [] for cell in cells]
    counts = {len(group) for group in groups if group}
    if len(counts) != 1 or (count := counts.pop()) < _FEWEST:
        return None
    if not all(_NUMBER.fullmatch(part) for group in groups for part in group):
        return None
    names = _names_in(name, count)
    if names is not None:
        columns = [[group[k] if group else "" for group in groups] for k in range(count)]
        return names, columns
    filled = [(cell, line) for cell, line in zip(cells, lines) if cell]
    if count >= _MANY and all(_GROUPED.fullmatch(cell) for cell, _ in filled):
        _ask(name, filled[0], count, where)
    return None


def _names_in(header: str, count: int) -> list[str] | None:
    """The names of `count` quantities that one header lists, each with its unit; None where it lists others."""
    bracket = _BRACKETS.search(header)
    is_list = bracket is not None and len(_listed(bracket[1])) == count
    plain = header[: bracket.start()] if bracket else header
    if is_list:  # "Position (x, y, z)"
        return [f"{plain} {part}".strip() for part in _listed(bracket[1])]
    unit = f" [{bracket[1]}]" if bracket else ""
    parts = _listed(plain)
    if len(parts) == count and all(read_header(part).kind for part in parts):
        return [f"{part}{unit}" for part in parts]
    if parts and parts[-1].lower() in _LETTERS and len(parts[-1]) == count:
        front = " ".join(parts[:-1])
        return [f"{front} {letter}{unit}".strip() for letter in parts[-1]]
    return None


def _listed(text: str) -> list[str]:
    return [part for part in re.split(r"[\s,;/|]+", text) if part]


def _ask(name: str, first: tuple[str, int], count: int, where: str) -> None:
    """Raise InputError for a column of a known quantity; columns that mean nothing are not asked about."""
    if not read_header(name).kind:
        return
    cell, line = first
    raise complaint(
        f"{where}, row {line}",
        f"one number, or a header that names {count} quantities",
        f"'{cell}', which may be one number with thousands separators or {count} numbers",
        f"write the numbers without spaces, or name all {count} in the header, as in 'X Y Z'",
    )
