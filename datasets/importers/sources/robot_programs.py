"""Position lists of robot controllers: KUKA KRL (.dat, .src), ABB RAPID (.mod), FANUC TP (.ls).

The makers fix units and rotation conventions, so that nothing about them has to be asked:

| maker | joints | pose |
|---|---|---|
| KUKA | E6AXIS/AXIS, deg | E6POS/POS/FRAME: mm; A, B, C = intrinsic ZYX in deg |
| ABB | jointtarget, deg | robtarget: mm; quaternion w x y z |
| FANUC | J1 = ... deg | X, Y, Z mm; W, P, R = extrinsic XYZ in deg |

Poses are those of the active tool in the active base or user frame, as the controller stored them.
"""

import re
from bisect import bisect_left
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.text_tables import encoding_of

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_KUKA = re.compile(
    r"(?:DECL\s+)?(?:GLOBAL\s+)?(E6AXIS|AXIS|E6POS|POS|FRAME)\s+(\w+)\s*=\s*\{([^{}]{1,2000})\}",
    re.IGNORECASE,
)
_KUKA_KEY = re.compile(rf"\b([A-Z]\d?)\s+({_NUMBER})", re.IGNORECASE)
_ABB = re.compile(r"\b(robtarget|jointtarget)\s+(\w+)\s*:=\s*(\[[^;]{1,2000}\])\s*;", re.IGNORECASE)
_FANUC = re.compile(
    r"P\[(\d{1,9})(?:\s{0,9}:\s{0,9}\"([^\"\n]{0,80})\")?\]\s{0,9}\{([^{};]{1,4000})\}\s*;"
)
_FANUC_KEY = re.compile(rf"\b([XYZWPR]|J\d)\s*=\s*({_NUMBER})")

_POSE = ("flange X [mm]", "flange Y [mm]", "flange Z [mm]")
_KUKA_ANGLES = ("flange A [deg]", "flange B [deg]", "flange C [deg]")
_FANUC_ANGLES = ("flange W [deg]", "flange P [deg]", "flange R [deg]")
_QUATERNION = ("flange qw", "flange qx", "flange qy", "flange qz")


def is_robot_program(path: Path) -> bool:
    """Whether the text of a file holds positions of one of the three controllers."""
    text = _text(path, 200_000)
    return bool(_KUKA.search(text) or _ABB.search(text) or _FANUC.search(text))


def read_robot_program(path: Path) -> list[RawTable]:
    """A table of the joint positions and a table of the poses, as far as each is there.

    Raises InputError where a position lacks a number.
    """
    text = _text(path, -1)
    joints: list[tuple[str, int, list[float]]] = []
    poses: list[tuple[str, int, list[float]]] = []
    names, convention = (*_POSE, *_QUATERNION), ("flange qw", "quaternion wxyz")
    for reader, angles, stated in (
        (_kuka, _KUKA_ANGLES, "intrinsic ZYX"),
        (_abb, None, ""),
        (_fanuc, _FANUC_ANGLES, "extrinsic XYZ"),
    ):
        found = list(reader(text, path))
        if not found:
            continue
        joints += [item[1:] for item in found if item[0] == "joints"]
        poses += [item[1:] for item in found if item[0] == "pose"]
        if angles is not None:
            names, convention = (*_POSE, *angles), (angles[0], stated)
    tables = []
    if joints:
        size = min(len(values) for _, _, values in joints)
        tables.append(_table(path, joints, [f"J{k + 1} [deg]" for k in range(size)]))
    if poses:
        tables.append(_table(path, poses, names, convention))
    return tables


def _table(path, rows, names, convention: tuple[str, str] | None = None) -> RawTable:
    """The positions of a program; rows of (name, line, values), of which those with `names` are taken."""
    position_names, lines, values = zip(*rows)
    columns: dict[str, np.ndarray] = {"position name": np.array(position_names)}
    for k, name in enumerate(names):
        columns[name] = np.array([row[k] for row in values])
    conventions = dict([convention]) if convention else {}
    return RawTable(path.name, columns, np.array(lines), conventions=conventions)


def _kuka(text: str, path: Path) -> Iterator[tuple[str, str, int, list[float]]]:
    for match in _KUKA.finditer(text):
        keys = {key.upper(): float(value) for key, value in _KUKA_KEY.findall(match[3])}
        line = text.count("\n", 0, match.start()) + 1
        is_axis = match[1].upper().endswith("AXIS")
        wanted = [f"A{k}" for k in range(1, 7)] if is_axis else ["X", "Y", "Z", "A", "B", "C"]
        missing = [key for key in wanted if key not in keys]
        if missing:
            raise _incomplete(path, line, match[2], missing[0])
        yield "joints" if is_axis else "pose", match[2], line, [keys[key] for key in wanted]


def _abb(text: str, path: Path) -> Iterator[tuple[str, str, int, list[float]]]:
    line_of = _line_counter(text)
    for match in _ABB.finditer(text):
        line = line_of(match.start())
        values = [float(v) for v in re.findall(_NUMBER, match[3])]
        is_joint = match[1].lower() == "jointtarget"
        size = 6 if is_joint else 7
        if len(values) < size:
            raise _incomplete(path, line, match[2], f"number {len(values) + 1}")
        yield "joints" if is_joint else "pose", match[2], line, values[:size]


def _fanuc(text: str, path: Path) -> Iterator[tuple[str, str, int, list[float]]]:
    line_of = _line_counter(text)
    for match in _FANUC.finditer(text):
        line = line_of(match.start())
        keys = {key: float(value) for key, value in _FANUC_KEY.findall(match[3])}
        name = match[2] or f"P[{match[1]}]"
        if "J1" in keys:
            size = max(int(key[1:]) for key in keys if key.startswith("J"))
            wanted = [f"J{k}" for k in range(1, size + 1)]
        else:
            wanted = ["X", "Y", "Z", "W", "P", "R"]
        missing = [key for key in wanted if key not in keys]
        if missing:
            raise _incomplete(path, line, name, missing[0])
        yield "joints" if "J1" in keys else "pose", name, line, [keys[key] for key in wanted]


def _line_counter(text: str) -> Callable[[int], int]:
    """The number of the line that holds a position of the text."""
    breaks = [match.start() for match in re.finditer("\n", text)]
    return lambda position: bisect_left(breaks, position) + 1


def _incomplete(path: Path, line: int, name: str, missing: str):
    return complaint(
        f"{path.name}, row {line}, position {name}", f"a value of {missing}", "none", "complete it"
    )


def _text(path: Path, most: int) -> str:
    with path.open(encoding=encoding_of(path), errors="replace") as file:
        return file.read(most)
