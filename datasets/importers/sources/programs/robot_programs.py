"""Position lists of robot controllers: KUKA KRL (.dat, .src), ABB RAPID (.mod), FANUC TP (.ls).

The makers fix units and rotation conventions, so that nothing about them has to be asked:

| maker | joints | pose |
|---|---|---|
| KUKA | E6AXIS/AXIS, deg | E6POS/POS/FRAME: mm; A, B, C = intrinsic ZYX in deg; also inside PTP {...}, LIN {...} |
| ABB | jointtarget, deg | robtarget: mm; quaternion w x y z |
| FANUC | J1 = ... deg | X, Y, Z mm; W, P, R = extrinsic XYZ in deg |

Poses are those of the active tool in the active base or user frame, as the controller stored them. They are converted
to poses of the flange where the file states both (`program_frames`), else the table says that it does not.
"""

import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.programs.program_frames import (
    FANUC_OTHER_GROUPS,
    FANUC_POSITION,
    NOTHING_STATED,
    REMEDIES,
    UNIT_LENGTH,
    SeveralFrames,
    StatedFrames,
    UnstatedFrame,
    flange_poses,
)
from datasets.importers.sources.tables.text_tables import encoding_of

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_KUKA = re.compile(
    r"(?:DECL\s+)?(?:GLOBAL\s+)?(E6AXIS|AXIS|E6POS|POS|FRAME)\s+(\w+)\s*=\s*\{([^{}]{1,2000})\}",
    re.IGNORECASE,
)
_KUKA_INLINE = re.compile(
    r"\b(?:S?PTP|S?LIN|S?CIRC|SPL)\s*\{\s*(?:(E6AXIS|AXIS|E6POS|POS|FRAME)\s*:)?([^{}]{1,2000})\}",
    re.IGNORECASE,
)
_KUKA_KEY = re.compile(rf"\b([A-Z]\d?)\s+({_NUMBER})", re.IGNORECASE)
_ABB = re.compile(r"\b(robtarget|jointtarget)\s+(\w+)\s*:=\s*(\[[^;]{1,2000}\])\s*;", re.IGNORECASE)
_FANUC_KEY = re.compile(rf"\b([XYZWPR]|J\d)\s*=\s*({_NUMBER})")

_FANUC_CONFIG = re.compile(r"CONFIG\s*:\s*'([^'\n]{1,80})'")

_POSITION = ("X [mm]", "Y [mm]", "Z [mm]")
_QUATERNION = ("qw", "qx", "qy", "qz")
NAME_OF_POSITION = "position name"
"""Column of the table of a program, which no other table has."""
_ABB_NO_AXIS = 8.9e9
"""RAPID states 9E9 for an external axis that does not exist."""
CONFIGURATION = "configuration"
"""Column with the configuration data of a pose as the program states them: S and T, cf1 to cfx, or CONFIG."""


@dataclass(frozen=True)
class _Position:
    """A position of a program: `values` in deg, or mm and the rotation of the maker; its configuration data as text.

    `external`: readings of external axes, in deg or mm, by name.
    """

    is_joint: bool
    name: str
    line: int
    values: list[float]
    configuration: str = ""
    external: Mapping[str, float] = field(default_factory=dict)


def is_robot_program(path: Path) -> bool:
    """Whether the text of a file holds positions of one of the three controllers."""
    text = _text(path, 200_000)
    is_kuka = _KUKA.search(text) or _KUKA_INLINE.search(text)
    return bool(is_kuka or _ABB.search(text) or FANUC_POSITION.search(text))


def read_robot_program(path: Path, stated: StatedFrames = NOTHING_STATED) -> list[RawTable]:
    """A table of the joint positions and a table of the poses, as far as each is there.

    Raises InputError where a position lacks a number.
    """
    text = _text(path, -1)
    joints: list[_Position] = []
    poses: list[_Position] = []
    maker = ""
    for reader, maker_of_reader in ((_kuka, "KUKA"), (_abb, "ABB"), (_fanuc, "FANUC")):
        found = list(reader(text, path))
        maker = maker_of_reader if found else maker
        joints += [position for position in found if position.is_joint]
        poses += [position for position in found if not position.is_joint]
    tables = []
    if joints:
        size = min(len(position.values) for position in joints)
        values = np.array([position.values[:size] for position in joints])
        names = [f"J{k + 1} [deg]" for k in range(size)]
        columns = dict(zip(names, values.T)) | _external_axes(joints)
        tables.append(_table(path, joints, columns))
    if poses:
        tables.append(_pose_table(path, maker, poses, stated))
    return tables


def program_text(path: Path) -> str:
    """The text of a program; of KUKA with that of its other half, because `.src` sets the frames of the `.dat` file."""
    others = {".src": ".dat", ".dat": ".src"}
    other = path.with_suffix(others.get(path.suffix.lower(), path.suffix))
    has_other = other != path and other.is_file()
    return "\n".join(_text(file, -1) for file in ((path, other) if has_other else (path,)))


def _external_axes(rows: Sequence[_Position]) -> dict[str, np.ndarray]:
    """Columns of the external axes that move, as of a track; a program states neither kind nor unit of an axis."""
    names = [name for name in rows[0].external if all(name in row.external for row in rows)]
    columns = {name: np.array([row.external[name] for row in rows]) for name in names}
    return {name: cells for name, cells in columns.items() if np.ptp(cells) > 0}


def _remedy(maker: str, found: UnstatedFrame) -> str:
    if isinstance(found, SeveralFrames):
        return (
            "the poses belong to different tools or bases, which depends on the moves: write one program for each tool "
            "and base, with its moves and positions alone, and name them one by one, or give joint targets (E6AXIS)"
        )
    return (
        "state it with [tool] and [frame] (xyz_mm, rpy_deg; [tool.2] for one of several) in a mapping file for --map, "
        f"{REMEDIES[maker]}"
    )


def _table(path: Path, rows: Sequence[_Position], columns: Mapping[str, np.ndarray]) -> RawTable:
    names = np.array([position.name for position in rows])
    lines = np.array([position.line for position in rows])
    return RawTable(path.name, {NAME_OF_POSITION: names, **columns}, lines)


def _pose_table(
    path: Path, maker: str, rows: Sequence[_Position], stated: StatedFrames
) -> RawTable:
    """Poses of the flange, or of the tool with the question that the file leaves open; in mm and quaternions."""
    poses, question, warning = _matrices(maker, path, rows), "", ""
    try:
        names = [position.name for position in rows]
        poses = flange_poses(maker, program_text(path), names, poses, stated)
    except UnstatedFrame as found:
        question = (
            f"{path.name}: expected poses of the flange, found those of a tool, whose tool and frame the file does not "
            f"state ({found}); {_remedy(maker, found)}."
        )
        warning = (
            f"{path.name}: the poses are those of the active tool, not of the flange ({found}). A hand-eye transform "
            "refers to this tool, which must be one for all positions."
        )
    body = "tool" if question else "flange"
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    numbers = np.column_stack([poses[:, :3, 3], quaternions])
    columns = dict(zip([f"{body} {name}" for name in (*_POSITION, *_QUATERNION)], numbers.T))
    if any(position.configuration for position in rows):
        columns[CONFIGURATION] = np.array([position.configuration for position in rows])
    return replace(
        _table(path, rows, columns),
        conventions={f"{body} qw": "quaternion wxyz"},
        frame_question=question,
        warnings=(warning,) if warning else (),
    )


def _matrices(maker: str, path: Path, rows: Sequence[_Position]) -> np.ndarray:
    """(n, 4, 4) poses of the tool in its frame (mm), in the convention of the maker."""
    values = np.array([position.values for position in rows])
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, 3] = values[:, :3]
    if maker == "ABB":
        _check_quaternions(path, rows, values[:, 3:])
        rotations = Rotation.from_quat(values[:, 3:], scalar_first=True)
    else:
        rotations = Rotation.from_euler(
            "ZYX" if maker == "KUKA" else "xyz", values[:, 3:], degrees=True
        )
    poses[:, :3, :3] = rotations.as_matrix()
    return poses


def _check_quaternions(path: Path, rows: Sequence[_Position], quaternions: np.ndarray) -> None:
    for position, length in zip(rows, np.linalg.norm(quaternions, axis=1)):
        if not abs(length - 1) < UNIT_LENGTH:
            raise complaint(
                f"{path.name}, row {position.line}, position {position.name}",
                "a quaternion of length 1",
                f"length {length:.4g}",
                "correct the pose",
            )


def _kuka(text: str, path: Path) -> Iterator[_Position]:
    line_of = _line_counter(text)
    named = [(match.start(), match[1], match[2], match[3]) for match in _KUKA.finditer(text)]
    inline = [(match.start(), match[1], "", match[2]) for match in _KUKA_INLINE.finditer(text)]
    for start, kind, name, content in sorted(named + inline, key=lambda entry: entry[0]):
        keys = {key.upper(): float(value) for key, value in _KUKA_KEY.findall(content)}
        line = line_of(start)
        name = name or f"row {line}"
        is_axis = kind.upper().endswith("AXIS") if kind else "A1" in keys
        wanted = [f"A{k}" for k in range(1, 7)] if is_axis else ["X", "Y", "Z", "A", "B", "C"]
        missing = [key for key in wanted if key not in keys]
        if missing:
            raise _incomplete(path, line, name, missing[0])
        stated = [f"{key} {keys[key]:g}" for key in "ST" if key in keys and not is_axis]
        values, external = [keys[key] for key in wanted], [f"E{k}" for k in range(1, 7)]
        moved = {key: keys[key] for key in external if key in keys}
        yield _Position(is_axis, name, line, values, ", ".join(stated), moved)


def _abb(text: str, path: Path) -> Iterator[_Position]:
    line_of = _line_counter(text)
    for match in _ABB.finditer(text):
        line = line_of(match.start())
        values = [float(v) for v in re.findall(_NUMBER, match[3])]
        is_joint = match[1].lower() == "jointtarget"
        size = 6 if is_joint else 7
        if len(values) < size:
            raise _incomplete(path, line, match[2], f"number {len(values) + 1}")
        stated = "" if is_joint else ", ".join(f"{value:g}" for value in values[7:11])
        last = values[6:12] if is_joint else []
        moved = {f"E{k}": value for k, value in enumerate(last, 1) if value < _ABB_NO_AXIS}
        yield _Position(is_joint, match[2], line, values[:size], stated, moved)


def _fanuc(text: str, path: Path) -> Iterator[_Position]:
    line_of = _line_counter(text)
    for match in FANUC_POSITION.finditer(text):
        line = line_of(match.start())
        content = FANUC_OTHER_GROUPS.split(match[3])[0]
        keys = {key: float(value) for key, value in _FANUC_KEY.findall(content)}
        name = match[2] or f"P[{match[1]}]"
        if "J1" in keys:
            size = max(int(key[1:]) for key in keys if key.startswith("J"))
            wanted = [f"J{k}" for k in range(1, size + 1)]
        else:
            wanted = ["X", "Y", "Z", "W", "P", "R"]
        missing = [key for key in wanted if key not in keys]
        if missing:
            raise _incomplete(path, line, name, missing[0])
        stated = _FANUC_CONFIG.search(content)
        values = [keys[key] for key in wanted]
        yield _Position("J1" in keys, name, line, values, stated[1] if stated else "")


def _line_counter(text: str) -> Callable[[int], int]:
    """The number of the line that holds a position of the text."""
    breaks = [match.start() for match in re.finditer("\n", text)]
    return lambda position: bisect_left(breaks, position) + 1


def _incomplete(path: Path, line: int, name: str, missing: str):
    return complaint(
        f"{path.name}, row {line}, position {name}", f"a value of {missing}", "none", "complete it"
    )


def _text(path: Path, max_characters: int) -> str:
    with path.open(encoding=encoding_of(path), errors="replace") as file:
        return file.read(max_characters)
