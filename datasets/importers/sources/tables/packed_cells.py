"""Cells that hold several numbers: a position written as "101 202 300" in one cell of a table.

Such a cell may also be one number with thousands separators. The header decides: it names several quantities where its
last words, as many as the cell has groups, are components of one quantity ("X Y Z", "Tracker X Y Z [mm]", "Position
(x, y, z)", "A1 A2 A3 A4 A5 A6"). A word for the object or the quantity, as in "Point X" or "Time s", and a unit in
brackets are no components. Where both readings remain possible, the column is a question: two components whose cells
may all be numbers with thousands separators, or three groups and more under a header that names one quantity.
"""

import re
from collections.abc import Sequence

from datasets.errors import complaint
from datasets.importers.mapping.columns.headers import COMPONENTS, read_header
from datasets.importers.mapping.columns.sets import SLURBT, WORD_SETS

_SPACE = " \u00a0\u2009\u202f"
_GAPS = re.compile(f"[{_SPACE}]+")
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(f"[+-]?\\d{{1,3}}(?:[{_SPACE}]\\d{{3}})+(?:[.,]\\d*)?")
_LISTED = re.compile(r"(?:[A-Za-z]{0,4}\s*)[\[({]([^\[\](){}]*)[\])}]")
_BRACKETS = re.compile(r"\s*[\[(<{]([^\])>}]*)[\])>}]\s*$")
_LETTERS = ("xyz", "abc", "wpr", "wxyz", "xyzw")
_WHOLE_SETS = (set("wxyz"), set(SLURBT))
_FEWEST = 2
_MANY = 3


def unpacked(name: str, cells: Sequence[str], where: str, lines: Sequence[int]):
    """(names, columns) of a column whose cells hold several numbers each, where its header names them; else None.

    cells (n,), empty ones included; where: the column in error sentences; lines (n,): rows of the file. Raises
    InputError for a column that may be one number or several.
    """
    listed = _lists(name, cells)
    if listed is not None:
        return listed
    groups = [_GAPS.split(cell) if cell else [] for cell in cells]
    counts = {len(group) for group in groups if group}
    if len(counts) != 1 or (count := counts.pop()) < _FEWEST:
        return None
    if not all(_NUMBER.fullmatch(part) for group in groups for part in group):
        return None
    names = _names_in(name, count)
    filled = [(cell, line) for cell, line in zip(cells, lines) if cell]
    is_one_number = all(_GROUPED.fullmatch(cell) for cell, _ in filled)
    if is_one_number and _is_open(name, names, count):
        raise _question(filled[0], count, where)
    if names is None:
        return None
    columns = [[group[k] if group else "" for group in groups] for k in range(count)]
    return names, columns


def list_in(cell: str) -> list[str]:
    """The numbers of a cell such as "p[0.1, -0.2, 0.3]", "(1; 2; 3)" or "(1,5; 2,5)"; [] for another cell."""
    match = _LISTED.fullmatch(cell.strip())
    if match is None:
        return []
    pieces = re.split(r"\s*;\s*|\s+", match[1].strip())
    if ";" not in match[1] or not all(map(_NUMBER.fullmatch, pieces)):  # no decimal commas
        pieces = re.split(r"\s*[,;]\s*|\s+", match[1].strip())
    return pieces if len(pieces) >= _FEWEST and all(map(_NUMBER.fullmatch, pieces)) else []


def _lists(name: str, cells: Sequence[str]):
    """(names, columns) of cells that are lists in brackets of equal length, with numbered names; else None."""
    groups = [list_in(cell) for cell in cells]
    counts = {len(group) for group, cell in zip(groups, cells) if cell}
    if len(counts) != 1 or (count := counts.pop()) == 0:
        return None
    names = [f"{name} {k + 1}" for k in range(count)]
    return names, [[group[k] if group else "" for group in groups] for k in range(count)]


def _is_open(header: str, names: Sequence[str] | None, count: int) -> bool:
    """Whether cells that may be one number with thousands separators may also be `count` numbers.

    Three names and more are a list. Three groups and more under the name of one quantity are hardly one number, since
    numbers of one quantity hardly ever have nine digits in every row; columns that mean nothing are not asked about.
    """
    if names is None:
        return count >= _MANY and bool(read_header(header).kind)
    return count < _MANY


def _names_in(header: str, count: int) -> list[str] | None:
    """The names of `count` quantities that one header lists, each with its unit; None where it lists others."""
    bracket = _BRACKETS.search(header)
    plain = header[: bracket.start()] if bracket else header
    if bracket:
        inner = _listed(bracket[1])
        if len(inner) == count and _are_components(inner):  # "Position (x, y, z)"
            return [f"{plain} {part}".strip() for part in inner]
    unit = f" [{bracket[1]}]" if bracket else ""
    words = _listed(plain)
    front, last = words[:-count], words[-count:]
    if len(last) < count or not _are_components(last):
        front, last = words[:-1], list("".join(words[-1:]))  # "Position XYZ"
        if len(last) != count or "".join(last).lower() not in _LETTERS:
            return None
    return [" ".join([*front, part]) + unit for part in last]


def _are_components(words: Sequence[str]) -> bool:
    """Whether words are components of one quantity, or of a position and an orientation: two of a kind or more."""
    headers = [read_header(part) for part in words]
    cores = {header.core for header in headers}
    if len(cores) < len(words):
        return False
    if cores in _WHOLE_SETS:
        return True
    kinds: dict[str, set[str]] = {}
    for header in headers:
        kind = (
            "joint" if header.kind == "qindex" else header.kind
        )  # q1 to q4 of an arm, or of a quaternion
        kinds.setdefault(kind, set()).add(header.core)
    return all(_is_family(kind, names) for kind, names in kinds.items())


def _is_family(kind: str, names: set[str]) -> bool:
    """Whether two names or more are components of a kind: of one set of angles where they are words."""
    if len(names) < _FEWEST or kind not in COMPONENTS:
        return False
    return kind != "word" or any(names <= set(word_set) for word_set in WORD_SETS.values())


def _listed(text: str) -> list[str]:
    return [part for part in re.split(r"[\s,;/|]+", text) if part]


def _question(first: tuple[str, int], count: int, where: str):
    """The InputError for a column whose cells may be one number or several."""
    cell, line = first
    wanted = "numbers without thousands separators, since the header names 2 quantities"
    remedy = "write the numbers without spaces, or each in a column of its own"
    if count >= _MANY:
        wanted = f"one number, or a header that names {count} quantities"
        remedy = (
            f"write the numbers without spaces, or name all {count} in the header, as in 'X Y Z'"
        )
    return complaint(
        f"{where}, row {line}",
        wanted,
        f"'{cell}', which may be one number with thousands separators or {count} numbers",
        remedy,
    )
