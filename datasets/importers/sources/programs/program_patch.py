"""Robot programs with other numbers in their positions; every other byte of the file stays."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.importers.sources.programs.program_frames import (
    FANUC_OTHER_GROUPS,
    NOTHING_STATED,
    StatedFrames,
    tool_poses,
)
from datasets.importers.sources.programs.robot_programs import (
    is_robot_program,
    program_text,
    read_robot_program,
)
from datasets.importers.sources.tables.text_tables import encoding_of

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SUFFIXES = {"KUKA": (".src", ".dat"), "ABB": (".mod", ".sys", ".prg"), "FANUC": (".ls",)}
_VALUES = {
    "KUKA": re.compile(r"\{[^{}]{1,2000}\}"),
    "ABB": re.compile(r":=\s*\[[^;]{1,2000}\]\s*;"),
    "FANUC": re.compile(r"P\[\d{1,9}[^\]]{0,100}\]\s{0,9}\{[^{};]{1,4000}\}\s*;"),
}
_KEYS = {
    ("KUKA", True): ("A1", "A2", "A3", "A4", "A5", "A6"),
    ("KUKA", False): ("X", "Y", "Z", "A", "B", "C"),
    ("FANUC", True): ("J1", "J2", "J3", "J4", "J5", "J6"),
    ("FANUC", False): ("X", "Y", "Z", "W", "P", "R"),
}
_EULER = {"KUKA": "ZYX", "FANUC": "xyz"}
_DECIMALS, _QUATERNION_DECIMALS, _FANUC_DECIMALS = 5, 9, 3
"""1e-5 deg at 2 m are 0.3 um; a quaternion of nine decimals is as exact. FANUC's own files hold three."""


@dataclass(frozen=True)
class PatchedProgram:
    """`content` of the file and the number of its positions, `count`."""

    content: bytes
    count: int


def is_program_of(path: Path, maker: str) -> bool:
    """Whether a file is a program of this maker (KUKA, ABB, FANUC) whose positions can be replaced."""
    return path.suffix.lower() in _SUFFIXES[maker] and is_robot_program(path)


def patched_program(
    path: Path,
    maker: str,
    readings: np.ndarray,
    flange: np.ndarray,
    stated: StatedFrames = NOTHING_STATED,
) -> PatchedProgram:
    """The program with corrected positions, in the order of the file.

    readings (n, 6) deg replace joint positions; flange (n, 4, 4) mm, the flange in the root frame where the controller
    believes it to be at these readings, becomes poses of the tool in the frame of the program. Raises InputError where
    a position is not in the text any more.
    """
    encoding = encoding_of(path)
    raw = path.read_bytes()
    text = raw.decode(encoding)
    new = _new_values(path, maker, readings, flange, stated)
    starts = [0, *(match.end() for match in re.finditer("\n", text))]
    pieces, done = [], 0
    for line, is_joint, values in new:
        found = _VALUES[maker].search(text, max(starts[line - 1], done))
        if found is None:
            raise complaint(f"{path.name}, row {line}", "a position", "none", "correct the program")
        pieces += [text[done : found.start()], _replaced(maker, found[0], values, is_joint)]
        done = found.end()
    made = "".join([*pieces, text[done:]])
    return PatchedProgram(made.encode(encoding), len(new))


def _new_values(
    path: Path, maker: str, readings: np.ndarray, flange: np.ndarray, stated: StatedFrames
) -> list[tuple]:
    """(line, whether the position is one of joints, its new numbers) of each position in the order of the file."""
    tables = read_robot_program(path)
    if sum(len(table.lines) for table in tables) != len(readings):
        raise complaint(
            path.name, f"{len(readings)} positions", "others", "name the program itself"
        )
    places = [(line, t, k) for t, table in enumerate(tables) for k, line in enumerate(table.lines)]
    places.sort(key=lambda place: place[:2])
    made = []
    for row, (line, t, k) in enumerate(places):
        is_joint = "J1 [deg]" in tables[t].columns
        name = tables[t].columns["position name"][k : k + 1]
        values = (
            readings[row]
            if is_joint
            else _tool_values(maker, program_text(path), name, flange[row : row + 1], stated)[0]
        )
        made.append((line, is_joint, values))
    return made


def _tool_values(
    maker: str, text: str, names, flange: np.ndarray, stated: StatedFrames
) -> np.ndarray:
    """(n, 6) mm and deg of KUKA and FANUC, (n, 7) mm and quaternion of ABB: the tool in its frame."""
    poses = tool_poses(maker, text, names, flange, stated)
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    if maker in _EULER:
        return np.column_stack([poses[:, :3, 3], rotations.as_euler(_EULER[maker], degrees=True)])
    return np.column_stack([poses[:, :3, 3], rotations.as_quat(scalar_first=True)])


def _replaced(maker: str, text: str, values: Sequence[float], is_joint: bool) -> str:
    """The text of one position with other numbers."""
    spans = _spans(maker, text, is_joint)
    old = np.array([float(text[begin:end]) for begin, end in spans])
    new = np.array(values, float)
    if maker == "ABB" and not is_joint:  # both signs of a quaternion are the same rotation
        new[3:] *= 1.0 if new[3:] @ old[3:] >= 0 else -1.0
    if maker in _EULER and not is_joint:
        new[3:] += 360 * np.round((old[3:] - new[3:]) / 360)
    for k in reversed(range(len(spans))):
        begin, end = spans[k]
        decimals = _decimals(maker, maker == "ABB" and k >= 3 and not is_joint)
        text = f"{text[:begin]}{new[k]:.{decimals}f}{text[end:]}"
    return text


def _decimals(maker: str, is_quaternion: bool) -> int:
    if maker == "FANUC":
        return _FANUC_DECIMALS
    return _QUATERNION_DECIMALS if is_quaternion else _DECIMALS


def _spans(maker: str, text: str, is_joint: bool) -> list[tuple[int, int]]:
    """Positions of the six or seven numbers of a pose in its text."""
    if maker == "ABB":
        return [match.span() for match in _NUMBER.finditer(text)][: 6 if is_joint else 7]
    separator = r"\s+" if maker == "KUKA" else r"\s*=\s*"
    first_group = text if maker == "KUKA" else FANUC_OTHER_GROUPS.split(text)[0]
    found: Mapping[str, tuple[int, int]] = {
        match[1].upper(): match.span(2)
        for match in re.finditer(
            rf"\b([A-Z]\d?){separator}({_NUMBER.pattern})", first_group, re.IGNORECASE
        )
    }
    return [found[key] for key in _KEYS[maker, is_joint]]


__all__ = ["PatchedProgram", "is_program_of", "patched_program"]
