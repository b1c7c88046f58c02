"""Reports of measuring software that give each axis a line: dimension reports of PC-DMIS (Hexagon), CAM2 (FARO).

    DIM LOC1= LOCATION OF POINT P001  UNITS=MM
    AX    NOMINAL       +TOL       -TOL       MEAS        DEV     OUTTOL
    X     100.000      0.010      0.010    100.013      0.013      0.003
    Y     ...

A block is the three lines of X, Y and Z; its name is the last name of the line that opens it. The measured value is in
the column that the line above calls MEAS, ACTUAL or alike; without such a line each axis has one number.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of
from datasets.importers.units import LENGTHS, unit_named

_NUMBER = r"[+-]?\d*[.,]?\d+(?:[eE][+-]?\d+)?"
_AXIS = re.compile(rf"\s*([XYZ])\s*[:=]?((?:[\s;]+{_NUMBER})+)(?:\s|;|$)", re.IGNORECASE)
_HEADER_WORDS = re.compile(r"[+-]?[A-Za-z][A-Za-z./]*")
_MEASURED = {"meas", "measured", "actual", "act", "ist", "istwert", "measurement"}
_OTHER = {
    "nominal",
    "nom",
    "theo",
    "dev",
    "deviation",
    "tol",
    "outtol",
    "max",
    "min",
    "soll",
    "abw",
}
_UNIT = re.compile(r"UNITS?\s*[=:]\s*([A-Za-z]+)", re.IGNORECASE)
_NAME = re.compile(
    r"(?:\bOF\s+(?:\w+\s+)?|\b(?:POINT|FEATURE|SPHERE|PUNKT|NAME|LABEL)\s*[:=]?\s*)\"?([\w.-]+)",
    re.IGNORECASE,
)
_LOOKED_AT, _FEWEST = 400, 3


@dataclass(frozen=True)
class Block:
    """A point of a report: name, line of its X, the numbers of each axis, words of its header, stated unit."""

    name: str
    line: int
    axes: tuple[tuple[float, ...], ...]
    header: tuple[str, ...]
    unit: str | None


def is_axis_report(path: Path) -> bool:
    """Whether the first lines of a text file hold three blocks or more."""
    with path.open(encoding=encoding_of(path), errors="replace") as file:
        lines = [line for _, line in zip(range(_LOOKED_AT), file)]
    return sum(1 for _ in _blocks(lines)) >= _FEWEST


def read_axis_report(path: Path) -> list[RawTable]:
    """The measured points of a report. Raises InputError where the measured column or the unit is not clear."""
    lines = path.read_text(encoding=encoding_of(path), errors="replace").splitlines()
    blocks = list(_blocks(lines))
    points = np.array([[_measured(block, axis, path) for axis in block.axes] for block in blocks])
    units = {block.unit for block in blocks if block.unit}
    if len(units) > 1:
        raise complaint(
            path.name,
            "one unit in the whole report",
            " and ".join(sorted(units)),
            "export it again",
        )
    columns = {"name": np.array([block.name for block in blocks])}
    columns |= {axis: points[:, k] for k, axis in enumerate("XYZ")}
    stated = {"length": units.pop()} if units else {}
    lines_of = np.array([block.line for block in blocks])
    return [RawTable(path.name, columns, lines_of, default_units=stated)]


def _blocks(lines: list[str]) -> Iterator[Block]:
    """All places where lines of X, Y and Z follow one another."""
    unit = None
    for number in range(len(lines) - 2):
        unit = _unit_in(lines[number]) or unit
        found = [_AXIS.match(line) for line in lines[number : number + 3]]
        if not all(found) or "".join(match[1].upper() for match in found) != "XYZ":
            continue
        axes = tuple(_numbers(match[2]) for match in found)
        lines_above = [line for line in lines[max(0, number - 3) : number] if not _AXIS.match(line)]
        header = _header(lines_above)
        title = next(
            (line for line in reversed(lines_above) if line.strip() and not _header([line])), ""
        )
        yield Block(_name(title, number), number + 1, axes, header, unit)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(cell.replace(",", ".")) for cell in re.findall(_NUMBER, text))


def _unit_in(line: str) -> str | None:
    match = _UNIT.search(line)
    unit = unit_named(match[1]) if match else None
    return unit if unit in LENGTHS else None


def _header(lines: list[str]) -> tuple[str, ...]:
    """Names of the columns of numbers: the words of the lowest line with one of them, but for that of the axis."""
    for line in reversed(lines):
        words = [word.strip("+-./").lower() for word in _HEADER_WORDS.findall(line)]
        if (_MEASURED | _OTHER) & set(words):
            return tuple(word for word in words if word not in ("ax", "axis", "achse"))
    return ()


def _name(title: str, number: int) -> str:
    match = _NAME.search(title)
    if match:
        return match[1]
    words = title.split()
    return words[0].strip(':="') if words else f"row {number + 1}"


def _measured(block: Block, numbers: tuple[float, ...], path: Path) -> float:
    if len(numbers) == 1 and not block.header:
        return numbers[0]
    places = [k for k, word in enumerate(block.header) if word in _MEASURED]
    if len(places) == 1 and places[0] < len(numbers):
        return numbers[places[0]]
    raise complaint(
        f"{path.name}, row {block.line}",
        "one number for each axis, or a line above that names the measured column MEAS or ACTUAL",
        f"{len(numbers)} numbers under {', '.join(block.header) or 'no header'}",
        "export the points as a table with the columns X, Y, Z",
    )
