"""Robot programs with other numbers in their positions; every other byte of the file stays."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.importers.sources.program_frames import tool_poses
from datasets.importers.sources.robot_programs import is_robot_program, read_robot_program
from datasets.importers.sources.text_tables import encoding_of

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SUFFIXES = {"KUKA": (".src", ".dat"), "ABB": (".mod", ".sys", ".prg")}
_VALUES = {
    "KUKA": re.compile(r"\{[^{}]{1,2000}\}"),
    "ABB": re.compile(r":=\s*\[[^;]{1,2000}\]\s*;"),
}
_KEYS = {True: ("A1", "A2", "A3", "A4", "A5", "A6"), False: ("X", "Y", "Z", "A", "B", "C")}
_DECIMALS, _QUATERNION_DECIMALS = 5, 9
"""1e-5 deg at 2 m are 0.3 um; a quaternion of nine decimals is as exact."""


@dataclass(frozen=True)
class PatchedProgram:
    """`content` of the file and the number of its positions, `count`."""

    content: bytes
    count: int


def is_program_of(path: Path, maker: str) -> bool:
    """Whether a file is a program of this maker (KUKA, ABB) whose positions can be replaced."""
    return path.suffix.lower() in _SUFFIXES[maker] and is_robot_program(path)


def patched_program(
    path: Path, maker: str, readings: np.ndarray, flange: np.ndarray
) -> PatchedProgram:
    """The program with corrected positions, in the order of the file.

    readings (n, 6) deg replace joint positions; flange (n, 4, 4) mm, the flange in the root frame where the controller
    believes it to be at these readings, becomes poses of the tool in the frame of the program. Raises InputError where
    a position is not in the text any more.
    """
    encoding = encoding_of(path)
    raw = path.read_bytes()
    text = raw.decode(encoding)
    tables = read_robot_program(path)
    if len(tables) != 1 or len(tables[0].lines) != len(readings):
        raise complaint(
            path.name, f"{len(readings)} positions of one kind", "others", "name the program itself"
        )
    table = tables[0]
    is_joint = "J1 [deg]" in table.columns
    new = readings if is_joint else _tool_values(maker, text, table, flange)
    starts = [0, *(match.end() for match in re.finditer("\n", text))]
    pieces, done = [], 0
    for line, values in zip(table.lines, new):
        found = _VALUES[maker].search(text, max(starts[line - 1], done))
        if found is None:
            raise complaint(f"{path.name}, row {line}", "a position", "none", "correct the program")
        pieces += [text[done : found.start()], _replaced(maker, found[0], values, is_joint)]
        done = found.end()
    made = "".join([*pieces, text[done:]])
    return PatchedProgram(made.encode(encoding), len(new))


def _tool_values(maker: str, text: str, table, flange: np.ndarray) -> np.ndarray:
    """(n, 6) mm and deg of KUKA, (n, 7) mm and quaternion of ABB: the tool in its frame."""
    poses = tool_poses(maker, text, table.columns["position name"], flange)
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    if maker == "KUKA":
        return np.column_stack([poses[:, :3, 3], rotations.as_euler("ZYX", degrees=True)])
    return np.column_stack([poses[:, :3, 3], rotations.as_quat(scalar_first=True)])


def _replaced(maker: str, text: str, values: Sequence[float], is_joint: bool) -> str:
    """The text of one position with other numbers."""
    spans = _spans(maker, text, is_joint)
    old = np.array([float(text[begin:end]) for begin, end in spans])
    new = np.array(values, float)
    if maker == "ABB" and not is_joint:  # both signs of a quaternion are the same rotation
        new[3:] *= 1.0 if new[3:] @ old[3:] >= 0 else -1.0
    if maker == "KUKA" and not is_joint:
        new[3:] += 360 * np.round((old[3:] - new[3:]) / 360)
    for k in reversed(range(len(spans))):
        begin, end = spans[k]
        decimals = _QUATERNION_DECIMALS if maker == "ABB" and k >= 3 and not is_joint else _DECIMALS
        text = f"{text[:begin]}{new[k]:.{decimals}f}{text[end:]}"
    return text


def _spans(maker: str, text: str, is_joint: bool) -> list[tuple[int, int]]:
    """Where the six or seven numbers of a position are in its text."""
    if maker == "ABB":
        return [match.span() for match in _NUMBER.finditer(text)][: 6 if is_joint else 7]
    found: Mapping[str, tuple[int, int]] = {
        match[1].upper(): match.span(2)
        for match in re.finditer(rf"\b([A-Z]\d?)\s+({_NUMBER.pattern})", text, re.IGNORECASE)
    }
    return [found[key] for key in _KEYS[is_joint]]


__all__ = ["PatchedProgram", "is_program_of", "patched_program"]
