"""Tree of links and joints of a URDF file, with their poses at zero and their actuators."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_model.robot import wrong

_KEYS = {
    "urdf": ((str, Path), "a path"),
    "joints": ((list, tuple), "a list of names"),
    "tip": (str, "the name of a link"),
    "mimic": (Mapping, "a table"),
    "gravity": ((list, tuple, np.ndarray), "a direction of three numbers"),
    "name": (str, "a text"),
    "source": (str, "a text"),
}
_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of the URDF; `origin` (4, 4) and `limits` in mm and rad; `axis` (3,) a unit vector.

    `mimic`: (joint, ratio, offset) in the URDF's units, rad and m.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float]
    mimic: tuple[str, float, float] | None

    @property
    def unit(self) -> float:
        """Our unit in the URDF's: mm of a metre, or rad."""
        return 1000.0 if self.kind == "prismatic" else 1.0


NAMELESS = "without a name)"
"""End of the name that a part has here which has none in its file."""
_ARM = 4
"""Joints of its own from which on a branch is an arm: a SCARA has four; fingers, doors and positioners have fewer."""


class Tree:
    """A URDF: `links` (name -> element), `joints` (name -> Joint), `into` (link -> the joint before it).

    `gravity`: direction in the root frame, where the file states it.
    `places`: link -> (4, 4) in the frame of the `root` link with every joint at zero, mm, from the
    root outward. `named`: the joints that have a reading, None: all. Raises InputError.
    """

    gravity = (0.0, 0.0, -1.0)
    language = "URDF"

    def __init__(self, spec: Mapping, where: str):
        check_keys(spec, where)
        self.file = Path(spec["urdf"])
        self.named = spec.get("joints")
        self.mimic: dict[str, tuple[str, float, float]] = {}
        self._read(spec, where)
        self.into = {joint.child: joint for joint in self.joints.values()}
        for name, words in (spec.get("mimic") or {}).items():
            self.mimic[name] = self._stated_mimic(f"{where}: key mimic.{name}", name, words)
        self._check_names(where)
        self._check_tree()
        (self.root,) = set(self.links) - set(self.into)
        self.places = {self.root: np.eye(4)}
        for joint in self._outward():
            self.places[joint.child] = self.places[joint.parent] @ joint.origin

    def _read(self, spec: Mapping, where: str) -> None:
        """Name, links, joints, and what a joint mimics, from the file."""
        element = _parse(self.file)
        self.name = element.get("name", self.file.stem)
        self.links = {e.get("name"): e for e in element.findall("link")}
        self.joints = {e.get("name"): _joint(e, self.file) for e in element.findall("joint")}
        self.mimic |= {name: joint.mimic for name, joint in self.joints.items() if joint.mimic}

    def _stated_mimic(self, key: str, name: str, words: object) -> tuple[str, float, float]:
        """A mimic of the spec; what it leaves out is as the URDF has it."""
        if (
            not isinstance(words, Mapping)
            or "joint" not in words
            or not set(words) <= {"joint", "ratio", "offset"}
        ):
            raise wrong(key, "joint, ratio and offset", repr(words), "correct it")
        _, ratio, offset = self.mimic.get(name, ("", 1.0, 0.0))
        numbers = words.get("ratio", ratio), words.get("offset", offset)
        if not all(isinstance(number, (int, float)) and np.isfinite(number) for number in numbers):
            raise wrong(key, "finite numbers", numbers, "correct them")
        return words["joint"], *numbers

    def _check_names(self, where: str) -> None:
        for name in [
            *(self.named or []),
            *self.mimic,
            *(parent for parent, _, _ in self.mimic.values()),
        ]:
            if name not in self.joints:
                known_joints = ", ".join(map(str, self.joints)) or "none"
                raise wrong(
                    where, f"a joint of {self.file.name}", name, f"choose among {known_joints}"
                )

    def _check_tree(self) -> None:
        for joint in self.joints.values():
            if not {joint.parent, joint.child} <= set(self.links):
                links = f"{joint.parent} and {joint.child}"
                raise wrong(
                    f"{self.file}: joint {joint.name}", "links of this file", links, "define both"
                )
        if len(self.into) != len(self.joints) or len(self.links) != len(self.joints) + 1:
            counts = f"{len(self.links)} links and {len(self.joints)} joints"
            raise wrong(
                self.file,
                "a tree of links with one root",
                counts,
                "cut loops and remove stray links",
            )

    def _outward(self) -> Iterator[Joint]:
        """Joints from the root outward: each once its parent's place is known."""
        waiting = self.joints
        while waiting:
            ready = [joint for joint in waiting.values() if joint.parent in self.places]
            if not ready:
                raise wrong(
                    self.file,
                    f"every link to hang on {self.root}",
                    f"a loop at {min(waiting)}",
                    "cut it",
                )
            yield from ready
            waiting = {name: joint for name, joint in waiting.items() if joint not in ready}

    def path(self, tip: str) -> list[Joint]:
        """Joints from the root to a link."""
        if tip not in self.links:
            raise wrong(
                self.file,
                "the tip to be a link",
                tip,
                f"choose among {', '.join(map(str, self.links))}",
            )
        joints = []
        while tip in self.into:
            joints.append(self.into[tip])
            tip = joints[-1].parent
        return joints[::-1]

    def flanges(self) -> list[str]:
        """Names of the last links that may be the flange of an arm, for every arm in the file."""
        ends = [end for leaves in self._arms() for end in self._ends_of(leaves)]
        return sorted(ends, key=lambda end: end.endswith(NAMELESS))

    def farthest_leaf(self) -> str:
        """The leaf beyond most joints that move. Raises InputError where there are several, or another arm."""
        ends = self.flanges()
        if len(ends) > 1:
            choice = f'tip = "{ends[0]}" under [robot], or {self.file.name}#{ends[0]}'
            raise wrong(
                self.file,
                "one arm, or the name of its flange",
                f"several last links, {', '.join(ends)}",
                f"name one of them: {choice} where a file is named",
            )
        return ends[0]

    def _ends_of(self, leaves: list[str]) -> list[str]:
        """Those of the last links of an arm that may be its flange."""
        return leaves

    def _arms(self) -> list[list[str]]:
        """The leaves beyond most joints that move, and those of every other arm, arm by arm.

        Leaves beyond a joint of a kind that no arm has (free, ball, floating) are other things than the arm, where
        there are others. Another arm has `_ARM` or more moving joints of its own.
        """
        leaves = set(self.links) - {joint.parent for joint in self.joints.values()}
        paths = {leaf: self.path(leaf) for leaf in sorted(leaves)}
        usable = {leaf: path for leaf, path in paths.items() if all(map(_is_of_arm, path))}
        if not usable:  # the longest path is the arm's
            usable = dict([max(paths.items(), key=lambda item: len(item[1]))])
        remaining_joints = {}
        for leaf, path in usable.items():
            remaining_joints[leaf] = {joint.name for joint in path if self.drive(joint) is not None}
        arms: list[list[str]] = []
        while True:
            longest = max(remaining_joints.values(), key=len)
            if arms and len(longest) < _ARM:
                return arms
            equally_long = [
                leaf for leaf, joints in remaining_joints.items() if len(joints) == len(longest)
            ]
            arms.append(
                [leaf for leaf in equally_long if not longest or remaining_joints[leaf] & longest]
            )
            assigned = set().union(*(remaining_joints[leaf] for leaf in arms[-1]))
            remaining_joints = {
                leaf: joints - assigned for leaf, joints in remaining_joints.items()
            }

    def drive(self, joint: Joint) -> tuple[str, float, float] | None:
        """Find the reading that moves a joint, its ratio and offset (m, rad); None where it stands still."""
        if joint.kind == "fixed":
            return None
        if joint.kind not in _MOVING:
            raise self._wrong_kind(joint)
        name = joint.name
        ratio = 1.0
        offset = 0.0
        for _ in range(len(self.joints) + 1):
            if name in (self.named or ()) or name not in self.mimic:
                if self.named is None or name in self.named:
                    return (name, ratio, offset)
                return None
            name, factor, shift = self.mimic[name]
            ratio, offset = ratio * factor, offset + ratio * shift
        raise wrong(
            f"{self.file}: joint {joint.name}",
            "mimic to end at a joint that is read",
            "a circle",
            "cut it",
        )

    def _wrong_kind(self, joint: Joint) -> Exception:
        kinds = f"one of fixed, {', '.join(_MOVING)}"
        return wrong(f"{self.file}: joint {joint.name}, type", kinds, joint.kind, "replace it")

    def inertial(self, link: str) -> tuple[float, np.ndarray]:
        """kg of a link and its centre (3,) in the root frame at zero, mm."""
        element = self.links[link].find("inertial")
        if element is None:
            return 0.0, np.zeros(3)
        mass = _numbers(element, "mass", "value", (0.0,), f"{self.file}: link {link}")[0]
        centre = (self.places[link] @ _origin(element, f"{self.file}: link {link}"))[:3, 3]
        return mass, centre


def _is_of_arm(joint: Joint) -> bool:
    return joint.kind in ("fixed", *_MOVING)


def check_keys(spec: Mapping, where: str) -> None:
    """InputError unless the spec's keys are known and of their kind."""
    for key, value in spec.items():
        if key not in _KEYS:
            raise wrong(
                f"{where}: key {key}",
                f"one of {', '.join(_KEYS)} in addition to urdf",
                key,
                "correct or remove it",
            )
        kinds, words = _KEYS[key]
        if value is not None and not isinstance(value, kinds):
            raise wrong(f"{where}: key {key}", words, repr(value), "correct it")
    joints = list(map(str, spec.get("joints") or []))
    if len(set(joints)) != len(joints):
        raise wrong(
            f"{where}: key joints", "every joint once", ", ".join(joints), "remove the repetition"
        )
    gravity = np.asarray(spec.get("gravity", (0.0, 0.0, -1.0)))
    if (
        gravity.shape != (3,)
        or gravity.dtype.kind not in "if"
        or not 1e-9 < np.linalg.norm(gravity) < np.inf
    ):
        raise wrong(
            f"{where}: key gravity",
            _KEYS["gravity"][1],
            spec["gravity"],
            "write [0, 0, -1] if upright",
        )


def _parse(file: Path) -> ET.Element:
    try:
        element = ET.parse(file).getroot()
    except OSError as problem:
        raise wrong(file, "a readable URDF", problem.strerror, "check the path") from None
    except (ET.ParseError, ValueError, LookupError) as problem:
        raise wrong(file, "XML", f"a mistake ({problem})", "correct it there") from None
    _strip_namespace(element)
    if element.tag != "robot":
        raise wrong(file, "the root element robot", f"<{element.tag}>", "give a URDF file")
    if any("xacro" in part.tag for part in element.iter() if isinstance(part.tag, str)):
        raise wrong(file, "a finished URDF", "xacro macros", "expand them with xacro first")
    return element


def _strip_namespace(root: ET.Element) -> None:
    """Plain names for elements in the default namespace of the root (xmlns), as in the files of Drake."""
    space, end, _ = root.tag.rpartition("}")
    for part in root.iter():
        if end and isinstance(part.tag, str) and part.tag.startswith(space + end):
            part.tag = part.tag.removeprefix(space + end)


def _joint(element: ET.Element, file: Path) -> Joint:
    name = element.get("name")
    kind = element.get("type")
    where = f"{file}: joint {name}"
    parent, child = (_attribute(element, part, "link") for part in ("parent", "child"))
    if None in (name, kind, parent, child):
        raise wrong(
            where,
            "name, type, parent and child",
            f"{name}, {kind}, {parent}, {child}",
            "add what is missing",
        )
    axis = _numbers(element, "axis", "xyz", (1.0, 0.0, 0.0), where)
    if kind in _MOVING and np.linalg.norm(axis) < 1e-9:
        raise wrong(where, "an axis with a direction", "zero", "correct it")
    unit = 1000.0 if kind == "prismatic" else 1.0
    low, high = (
        _numbers(element, "limit", side, (np.nan,), where)[0] * unit for side in ("lower", "upper")
    )
    if low < high and kind != "continuous":
        limits = low, high
    else:
        limits = np.nan, np.nan
    axis = axis / max(np.linalg.norm(axis), 1e-9)
    return Joint(
        name, kind, parent, child, _origin(element, where), axis, limits, _mimic(element, where)
    )


def _mimic(element: ET.Element, where: str) -> tuple[str, float, float] | None:
    parent = _attribute(element, "mimic", "joint")
    ratio = _numbers(element, "mimic", "multiplier", (1.0,), where)[0]
    offset = _numbers(element, "mimic", "offset", (0.0,), where)[0]
    return None if parent is None else (parent, ratio, offset)


def _attribute(element: ET.Element, part: str, key: str) -> str | None:
    found = element.find(part)
    return None if found is None else found.get(key)


def _numbers(element: ET.Element, part: str, key: str, default: tuple, where: str) -> np.ndarray:
    text = _attribute(element, part, key)
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != len(default) or not np.isfinite(values).all():
        raise wrong(
            f"{where}, {part} {key}", f"{len(default)} finite number(s)", repr(text), "correct it"
        )
    return values


def _origin(element: ET.Element, where: str) -> np.ndarray:
    """(4, 4) of an <origin>, mm; roll, pitch and yaw are about fixed axes."""
    from scipy.spatial.transform import Rotation

    place = np.eye(4)
    angles = _numbers(element, "origin", "rpy", (0.0, 0.0, 0.0), where)
    place[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    place[:3, 3] = 1000 * _numbers(element, "origin", "xyz", (0.0, 0.0, 0.0), where)
    return place
