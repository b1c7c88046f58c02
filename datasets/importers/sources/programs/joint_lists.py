"""Joint positions in the notation of a controller, wherever they stand: in a program, a variable file or a log.

Each language has one pattern, `_LANGUAGES`; the positions are read in the order in which they stand in the file. Axes
beyond the sixth are read if they move. Poses are those of a tool that such a file does not state: they are counted and
not read. Programs of KUKA, ABB and FANUC whose positions can be replaced are those of `robot_programs`.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_SEVERAL = rf"{_NUMBER}(?:\s*,\s*{_NUMBER}){{3,11}}"
_SIX = rf"\s*{_NUMBER}(?:\s*,\s*{_NUMBER}){{5}}\s*"
_VALUE = re.compile(
    rf"(?:\b(A|J|E|EXT)(\d{{1,2}})\s*[=:]?\s*)?(?<![\w.])({_NUMBER})", re.IGNORECASE
)
_STAMP = re.compile(
    r"(?:\d{4}-\d\d-\d\d[T ]|\d{1,2}\.\d{1,2}\.\d{4} )?\d{1,2}:\d\d:\d\d(?:[.,]\d+)?"
)
_NO_AXIS = 8.9e9
"""RAPID states 9E9 for an external axis that does not exist."""
_ARM_AXES = 6
_FEWEST = 3
_HEAD_CHARACTERS = 200_000


def _pattern(text: str) -> re.Pattern:
    """A pattern with gaps of limited length: the time of others grows with a power of the number of spaces."""
    text = text.replace(r"\s*", r"\s{0,20}").replace(r"\s+", r"\s{1,20}")
    return re.compile(text, re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True)
class _Language:
    """Notation of a controller: `position` with the groups name and values, `pose` of a tool, unit of the values."""

    position: re.Pattern
    unit: str = "deg"
    pose: re.Pattern | None = None


_NAME = r"(?P<name>[$\w]{1,80}(?:\[\d{1,9}\])?)"
_IS = r"[ \t]{0,9}(?::=|[=:])[ \t]{0,9}"
_START = r"^[ \t]{0,40}(?:\d{1,6}[ \t]{1,9})?"
_REGISTER = r"\[\s*1\s*,\s*\d+\s*\]\s*=\s*'(?P<name>[^'\n]{0,80})'\s*Group:\s*1\s+"
_LANGUAGES = {
    # P[3]={A1 10.0,A2 -90.0, ...} and $AXIS_ACT={E6AXIS: A1 10.0, ...} in a log
    "KUKA": _Language(
        _pattern(rf"(?:{_NAME}{_IS})?\{{\s*(?:E6AXIS|AXIS)?\s*:?\s*(?P<values>A1\s[^{{}}]+)\}}")
    ),
    # [[10,-20,30,0,45,0],[9E+09, ...]], also as elements of an array
    "ABB": _Language(
        _pattern(
            rf"(?:{_NAME}{_IS})?"
            rf"(?P<values>\[\s*\[{_SIX}\]\s*,\s*\[(?=[^\]]*9E\+?0*9){_SIX}\]\s*\])"
        )
    ),
    # position registers, posreg.va
    "FANUC": _Language(
        _pattern(_REGISTER + r"(?P<values>J1\s*=[^\['\n]*(?:\n[ \t]+(?:J\d|EXT\d)[^\['\n]*)*)"),
        pose=_pattern(_REGISTER + "Config"),
    ),
    "Universal Robots": _Language(
        _pattern(rf"(?:\bmove[jlp]\s*\(\s*|\b{_NAME}{_IS})\[(?P<values>{_SIX})\]"),
        "rad",
        _pattern(rf"(?:\bmove[jlp]\s*\(\s*|\b{_NAME}{_IS})p\[{_SIX}\]"),
    ),
    # J1=(+10.00,-20.00, ...) of MELFA BASIC, and with J( ... ) of PacScript
    "Mitsubishi or Denso": _Language(
        _pattern(rf"{_START}(?P<name>J\w*){_IS}J?\(\s*(?P<values>{_SEVERAL})\s*\)"),
        pose=_pattern(rf"{_START}P\w*{_IS}P?\(\s*{_SEVERAL}"),
    ),
    "Kawasaki": _Language(
        _pattern(rf"{_START}#{_NAME}[ \t]+(?P<values>{_NUMBER}(?:[ \t,]+{_NUMBER}){{3,11}})\s*$")
    ),
    "Doosan": _Language(
        _pattern(rf"(?:\b{_NAME}{_IS})?\bposj\s*\(\s*\[?\s*(?P<values>{_SEVERAL})\s*\]?\s*\)"),
        pose=_pattern(r"\bposx\s*\("),
    ),
    "Techman": _Language(
        _pattern(rf"\bPTP\s*\(\s*\"J(?P<name>)\w+\"\s*,\s*\{{?(?P<values>{_SIX})")
    ),
}
_BY_EXTENSION = {".script": "Universal Robots", ".urscript": "Universal Robots"}
_ONLY_BY_EXTENSION = frozenset(_BY_EXTENSION.values())
"""Variables in brackets are also those of Python and of MATLAB, in which a text may state anything."""
EXTENSIONS = {*_BY_EXTENSION, ".va", ".as", ".pg", ".drl", ".mb4", ".mb5", ".mb6"}
_COMMENT = re.compile(r"#.*$", re.MULTILINE)


@dataclass(frozen=True)
class _Position:
    name: str
    line: int
    stamp: str
    values: dict[str, float]


def has_joint_lists(path: Path) -> bool:
    """Whether a text holds at least three joint positions of a known language, or is a script of one."""
    return path.suffix.lower() in _BY_EXTENSION or _language_of(path) is not None


def read_joint_lists(path: Path) -> list[RawTable]:
    """The table of the joint positions; the column "time" where each stands behind a time stamp.

    Raises InputError for a script without joint positions.
    """
    text = _text(path, -1)
    language = _LANGUAGES[_language_of(path) or _BY_EXTENSION[path.suffix.lower()]]
    found = list(_positions(language, text))
    poses = sum(1 for _ in language.pose.finditer(text)) if language.pose else 0
    if not found:
        raise complaint(
            path.name,
            "joint positions such as movej([0.1, -1.2, 1.5, 0.3, 1.5, 0.0])",
            f"{poses} poses p[...] of the tool only" if poses else "none",
            "record joint positions, or export a table of flange poses",
        )
    first = found[0].values
    same = [position for position in found if set(position.values) == set(first)]
    warnings = [
        f"{path.name}, row {position.line}: a position with other axes than the first one is not read."
        for position in found
        if set(position.values) != set(first)
    ]
    if poses:
        warnings.append(f"{path.name}: poses of the tool are not read ({poses} of them).")
    columns: dict[str, np.ndarray] = {"position name": np.array(_names(same))}
    if all(position.stamp for position in same):
        columns["time"] = np.array([position.stamp for position in same])
    columns |= _axes(same, language.unit)
    lines = np.array([position.line for position in same])
    return [RawTable(path.name, columns, lines, warnings=tuple(warnings))]


def _language_of(path: Path) -> str | None:
    """The language with the most positions; None where no language has three of them."""
    language = _BY_EXTENSION.get(path.suffix.lower())
    text = _text(path, _HEAD_CHARACTERS)
    names = (
        [language] if language else [name for name in _LANGUAGES if name not in _ONLY_BY_EXTENSION]
    )
    counts = {name: sum(1 for _ in _LANGUAGES[name].position.finditer(text)) for name in names}
    best = max(counts, key=counts.get)
    return best if counts[best] >= _FEWEST else None


def _positions(language: _Language, text: str) -> Iterator[_Position]:
    number, done = 1, 0
    for match in language.position.finditer(text):
        number += text.count("\n", done, match.start("values"))
        done = match.start("values")
        values: dict[str, float] = {}
        for place, (letter, axis, value) in enumerate(_VALUE.findall(match["values"]), 1):
            name = _axis_name(letter, axis, place)
            if float(value) < _NO_AXIS:
                values[name] = float(value)
        before = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
        stamp = _STAMP.search(before)
        yield _Position(match["name"] or "", number, stamp[0] if stamp else "", values)


def _axis_name(letter: str, number: str, place: int) -> str:
    """J1 to J6 for the axes of the arm, E1 and so on for external axes; by their place where nothing names them."""
    if letter:
        return f"{'J' if letter.upper() in 'AJ' else 'E'}{number}"
    return f"J{place}" if place <= _ARM_AXES else f"E{place - _ARM_AXES}"


def _names(positions: Sequence[_Position]) -> list[str]:
    """Names that differ; numbers of the positions where the file has none or the same for several."""
    names = [position.name for position in positions]
    if len(set(names)) == len(names):
        return names
    return [f"P{k}" for k in range(1, len(names) + 1)]


def _axes(positions: Sequence[_Position], unit: str) -> dict[str, np.ndarray]:
    """Columns of the axes of the arm, and without a unit those of further axes that move."""
    columns: dict[str, np.ndarray] = {}
    arm = [f"J{k}" for k in range(1, _ARM_AXES + 1)]
    for name in positions[0].values:
        cells = np.array([position.values[name] for position in positions])
        if name in arm:
            columns[f"{name} [{unit}]"] = cells
        elif np.ptp(cells) > 0:
            columns[name] = cells
    return columns


def _text(path: Path, max_characters: int) -> str:
    with path.open(encoding=encoding_of(path), errors="replace") as file:
        text = file.read(max_characters)
    is_script = path.suffix.lower() in _BY_EXTENSION
    return _COMMENT.sub("", text) if is_script else text


__all__ = ["EXTENSIONS", "has_joint_lists", "read_joint_lists"]
