"""Tool and frame of the positions of a robot program, as far as the file states them.

A controller stores a Cartesian position as the pose of the active tool in the active frame. The pose of the flange in
the root frame of the robot follows from both: T_root_flange = T_root_frame T_frame_tool inv(T_flange_tool).

| maker | tool | frame |
|---|---|---|
| ABB | last argument of the move instructions: tool0, or a tooldata of the file | WObj: wobj0, or a wobjdata |
| KUKA | $TOOL, TOOL_NO, BAS(#TOOL, n): a frame, $NULLFRAME, 0, or TOOL_DATA[n] of the file | $BASE and BASE_NO |
| FANUC | UT : 0 | UF : 0, position by position |

What only the controller knows (UT : 1, TOOL_DATA[3] without a value) the user may state (`StatedFrames`).
The world frame of the controller counts as the root frame of the robot.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RAPID_COMMENT = re.compile(r"(?m)^\s*!.*$")
_MOVE = re.compile(r"\bMove\w*\s([^;]{1,2000});", re.IGNORECASE)
_WORK_OBJECT = re.compile(r"\\\s*WObj\s*:=\s*([^\\,\s]+)", re.IGNORECASE)
_RAPID_DATA = re.compile(
    r"\b(tooldata|wobjdata)\s+(\w+)\s*:=\s*(\[[^;]{1,2000}\])\s*;", re.IGNORECASE
)
_DISPLACEMENT = re.compile(r"\b(?:PDispOn|PDispSet|EOffsOn|EOffsSet)\b", re.IGNORECASE)
_KUKA_DATA = re.compile(r"\b(TOOL|BASE)_DATA\[(\d+)\]\s*=\s*\{([^{}]{1,500})\}", re.IGNORECASE)
_KUKA_SET = re.compile(
    r"\$(TOOL|BASE)\s*=\s*(?:\{([^{}]{1,500})\}|([$\w]+(?:\[\w+\])?))", re.IGNORECASE
)
_KUKA_NUMBER = re.compile(
    r"\b(TOOL|BASE)_NO\s+(-?\d+)|\bBAS\s*\(\s*#(TOOL|BASE)\s*,\s*(\w+)\s*\)", re.IGNORECASE
)
_KUKA_KEY = re.compile(rf"\b([XYZABC])\s+({_NUMBER})", re.IGNORECASE)
FANUC_POSITION = re.compile(
    r"P\[(\d{1,9})(?:\s{0,9}:\s{0,9}\"([^\"\n]{0,80})\")?\]\s{0,9}\{([^{};]{1,4000})\}\s*;"
)
"""Number, comment and content of a position of a FANUC program."""
FANUC_OTHER_GROUPS = re.compile(r"\bGP[2-9]\s{0,9}:")
"""Where the axes of a positioner or a second arm begin in a FANUC position."""
_FANUC_FRAMES = re.compile(r"\b(UF|UT)\s*:\s*(\w+)")
UNIT_LENGTH = 0.01  # by which the length of a stated quaternion may differ from 1

REMEDIES = {
    "ABB": "name the tool and the work object in a move instruction and define both in the file (tooldata, wobjdata), "
    "or give joint targets (jointtarget)",
    "KUKA": "set $TOOL and $BASE in the file, as in $BASE=$NULLFRAME, or give joint targets (E6AXIS)",
    "FANUC": "record the positions with UF : 0 and UT : 0, or as joint values",
}
"""Maker -> what to do where the file does not state tool or frame."""


@dataclass(frozen=True)
class StatedFrames:
    """Tools and frames stated by the user: T_flange_tool and T_root_frame (4, 4) mm by number or name.

    They take the place of what the file states or leaves to the controller. Those under the name "" hold for all
    positions.
    """

    tools: Mapping[str, np.ndarray] = field(default_factory=dict)
    frames: Mapping[str, np.ndarray] = field(default_factory=dict)


def _stated(known: Mapping[str, np.ndarray], name: str, used: Collection[str]):
    """The (4, 4) of this number or name, else the one of all where the program uses no other; None: not stated."""
    return known.get(name, known.get("") if len(used) == 1 else None)


NOTHING_STATED = StatedFrames()


class UnstatedFrame(ValueError):
    """The file does not state tool or frame of a position; the text says what it states instead."""


class SeveralFrames(UnstatedFrame):
    """The file uses several tools or frames, and which of them belongs to a position depends on how it runs."""


def flange_poses(
    maker: str, text: str, names, poses: np.ndarray, stated: StatedFrames = NOTHING_STATED
) -> np.ndarray:
    """(n, 4, 4) T_root_flange (mm) of the named positions (n, 4, 4) of the tool in its frame.

    Raises UnstatedFrame where the file states tool or frame of a position not at all, or in several ways.
    """
    frames_of = _READERS[maker](text, stated)
    made = np.empty_like(poses)
    for k, (name, pose) in enumerate(zip(names, poses)):
        frame, tool = frames_of(name)
        made[k] = frame @ pose @ np.linalg.inv(tool)
    return made


def tool_poses(
    maker: str, text: str, names, flange: np.ndarray, stated: StatedFrames = NOTHING_STATED
) -> np.ndarray:
    """(n, 4, 4) poses of the tool in its frame (mm) for poses of the flange in the root frame: the inverse of
    `flange_poses`."""
    frames_of = _READERS[maker](text, stated)
    made = np.empty_like(flange)
    for k, (name, pose) in enumerate(zip(names, flange)):
        frame, tool = frames_of(name)
        made[k] = np.linalg.inv(frame) @ pose @ tool
    return made


class _RapidFrames:
    """Work object and tool of a robtarget: those of the move instructions that name it."""

    def __init__(self, text: str, given: StatedFrames):
        self.given = given
        self.text = _RAPID_COMMENT.sub("", text)
        self.data: dict[tuple[str, str], list[str]] = {}
        for kind, name, value in _RAPID_DATA.findall(self.text):
            self.data.setdefault((kind.lower(), name.lower()), []).append(value)
        self.used: dict[str, set[tuple[str, str]]] = {}
        for arguments in _MOVE.findall(self.text):
            tool = arguments.rsplit(",", 1)[-1].split("\\")[0].strip().lower()
            stated = _WORK_OBJECT.search(arguments)
            work_object = stated[1].lower() if stated else "wobj0"
            for word in set(re.findall(r"\w+", arguments.lower())):
                self.used.setdefault(word, set()).add((work_object, tool))

    def __call__(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(T_root_frame, T_flange_tool)."""
        if _DISPLACEMENT.search(self.text):
            raise UnstatedFrame("a program displacement")
        used = self.used.get(name.lower(), set())
        if len(used) != 1:
            raise UnstatedFrame(f"{len(used)} tools and work objects in the moves to {name}")
        ((work_object, tool),) = used
        frame = _of_any_case(self.given.frames, work_object)
        stationary_tool = _of_any_case(self.given.tools, tool)
        frame = self._work_object(work_object) if frame is None else frame
        return frame, self._tool(tool) if stationary_tool is None else stationary_tool

    def _tool(self, name: str) -> np.ndarray:
        if name == "tool0":
            return np.eye(4)
        value = self._value("tooldata", name)
        if not _flags(value)[:1] == ["TRUE"]:
            raise UnstatedFrame(f"the tool {name}, which the robot does not hold")
        return _rapid_pose(value, 0, name)

    def _work_object(self, name: str) -> np.ndarray:
        if name == "wobj0":
            return np.eye(4)
        value = self._value("wobjdata", name)
        if not _flags(value)[:2] == ["FALSE", "TRUE"]:
            raise UnstatedFrame(f"the work object {name}, which moves")
        value = re.sub(r'"[^"]*"', "", value)
        return _rapid_pose(value, 0, name) @ _rapid_pose(value, 7, name)

    def _value(self, kind: str, name: str) -> str:
        values = self.data.get((kind, name), [])
        if len(values) != 1:
            count = "none" if not values else f"{len(values)} definitions"
            raise UnstatedFrame(f"the {kind} {name} with {count} in the file")
        if re.search(rf"(?im)^\s*{re.escape(name)}(?:\.\w+)*\s*:=", self.text):
            raise UnstatedFrame(f"the {kind} {name}, which the program changes")
        return values[0]


def _of_any_case(known: Mapping[str, np.ndarray], name: str) -> np.ndarray | None:
    """The stated transform of a name of RAPID, which has no case, or the one of all."""
    return {key.lower(): transform for key, transform in known.items()}.get(name, known.get(""))


def _flags(value: str) -> list[str]:
    return [word.upper() for word in re.findall(r"\b(TRUE|FALSE)\b", value, re.IGNORECASE)]


def _rapid_pose(value: str, first: int, name: str) -> np.ndarray:
    """The pose in numbers `first` to `first` + 6 of a RAPID value: mm and a quaternion w x y z."""
    numbers = [float(text) for text in re.findall(_NUMBER, value)][first : first + 7]
    if len(numbers) < 7 or abs(np.linalg.norm(numbers[3:]) - 1) > UNIT_LENGTH:
        raise UnstatedFrame(f"{name} without a position and a quaternion of length 1")
    pose = np.eye(4)
    pose[:3, 3] = numbers[:3]
    pose[:3, :3] = Rotation.from_quat(numbers[3:], scalar_first=True).as_matrix()
    return pose


class _KukaFrames:
    """$BASE and $TOOL of a program: all statements of the file have to agree."""

    def __init__(self, text: str, given: StatedFrames):
        self.given = {"BASE": given.frames, "TOOL": given.tools}
        self.text = re.sub(r"(?m)^\s*;(?!FOLD).*$", "", text)
        self.data = {
            (kind.upper(), int(number)): value
            for kind, number, value in _KUKA_DATA.findall(self.text)
        }
        self.frames: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(T_root_frame, T_flange_tool), the same for every position."""
        if self.frames is None:
            if "#TCP" in self.text.upper():
                raise UnstatedFrame("a tool that stands still (#TCP)")
            self.frames = self._only("BASE"), self._only("TOOL")
        return self.frames

    def _only(self, kind: str) -> np.ndarray:
        if self.given[kind]:
            words = {value or word for value, word in self._stated(kind)} | self._numbers(kind)
            if len(words) > 1:
                raise SeveralFrames(f"several values of ${kind}")
            word = words.pop() if words else ""
            number = re.sub(rf"(?i)^{kind}_DATA\[(\d+)\]$", r"\1", word)
            given = _stated(self.given[kind], number, [number])
            if given is not None:
                return given
        found = [self._named(kind, word, value) for value, word in self._stated(kind)]
        found += [self._numbered(kind, number) for number in self._numbers(kind)]
        if not found:
            raise UnstatedFrame(f"no ${kind}")
        if any(not np.allclose(transform, found[0], atol=1e-9) for transform in found):
            raise SeveralFrames(f"several values of ${kind}")
        return found[0]

    def _stated(self, kind: str) -> list[tuple[str, str]]:
        found = _KUKA_SET.findall(self.text)
        return [(value, word) for own_kind, value, word in found if own_kind.upper() == kind]

    def _numbers(self, kind: str) -> set[str]:
        found = _KUKA_NUMBER.findall(self.text)
        return {a or b for own_kind, a, other, b in found if (own_kind or other).upper() == kind}

    def _named(self, kind: str, word: str, value: str) -> np.ndarray:
        if value:
            return _kuka_pose(value, f"${kind}")
        if word.upper() == "$NULLFRAME":
            return np.eye(4)
        number = re.fullmatch(rf"{kind}_DATA\[(\d+)\]", word, re.IGNORECASE)
        if number is None:
            raise UnstatedFrame(f"${kind}={word}")
        return self._numbered(kind, number[1])

    def _numbered(self, kind: str, number: str) -> np.ndarray:
        if number == "0":
            return np.eye(4)
        value = self.data.get((kind, int(number))) if number.isdigit() else None
        if value is None:
            raise UnstatedFrame(f"{kind}_DATA[{number}] without a value in the file")
        return _kuka_pose(value, f"{kind}_DATA[{number}]")


def _kuka_pose(value: str, name: str) -> np.ndarray:
    keys = {key.upper(): float(number) for key, number in _KUKA_KEY.findall(value)}
    if set(keys) != set("XYZABC"):
        raise UnstatedFrame(f"{name} without all of X, Y, Z, A, B, C")
    pose = np.eye(4)
    pose[:3, 3] = [keys[key] for key in "XYZ"]
    pose[:3, :3] = Rotation.from_euler(
        "ZYX", [keys[key] for key in "ABC"], degrees=True
    ).as_matrix()
    return pose


class _FanucFrames:
    """User frame and tool frame of each FANUC position; their values are not in the file."""

    def __init__(self, text: str, given: StatedFrames):
        self.given = {"UF": given.frames, "UT": given.tools}
        self.numbers: dict[str, set[tuple[str, str]]] = {}
        for match in FANUC_POSITION.finditer(text):
            name = match[2] or f"P[{match[1]}]"
            content = FANUC_OTHER_GROUPS.split(match[3])[0]
            self.numbers.setdefault(name, set()).update(_FANUC_FRAMES.findall(content))
        all_numbers = set().union(*self.numbers.values())
        self.used = {
            kind: {number for own_kind, number in all_numbers if own_kind == kind}
            for kind in self.given
        }

    def __call__(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(T_root_frame, T_flange_tool): the identity for number 0, else what the user states."""
        numbers_of_pose = self.numbers.get(name, set())
        found = []
        for kind in self.given:
            numbers = [number for key, number in numbers_of_pose if key == kind]
            matrix = self._matrix(kind, numbers[0]) if len(numbers) == 1 else None
            if matrix is None:
                shown = ", ".join(f"{key} : {number}" for key, number in sorted(numbers_of_pose))
                raise UnstatedFrame(shown or "no UF and UT")
            found.append(matrix)
        return found[0], found[1]

    def _matrix(self, kind: str, number: str) -> np.ndarray | None:
        """(4, 4); None where neither the number 0 nor the user states it."""
        given = _stated(self.given[kind], number, self.used[kind])
        return np.eye(4) if given is None and number == "0" else given


_READERS = {"ABB": _RapidFrames, "KUKA": _KukaFrames, "FANUC": _FanucFrames}
