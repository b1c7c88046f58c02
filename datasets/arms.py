"""The [robot] section of a recording: robot.toml, a URDF, or the name of a built-in arm."""

import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from datasets.errors import complaint
from datasets.files import inside, label, read_text, read_toml
from datasets.keys import JOINT, ROBOT, check_keys, shown

RADIANS = tuple(k * math.pi / 2 for k in (-3, -2, -1, 1, 2, 3))


def read_robot(folder: Path, section: Mapping, called: str) -> dict:
    """What `Recording.robot` holds. Raises InputError for a missing or impossible robot."""
    urdf = str(section.get("file", "")).lower().endswith(".urdf")
    if "gravity" in section and ("builtin" in section or not urdf):
        raise complaint(
            f"{called}, key robot.gravity",
            "this key for a URDF only",
            shown(section["gravity"]),
            "write gravity into robot.toml and name that file",
        )
    if "builtin" in section:
        return {"builtin": section["builtin"]}
    if "file" not in section:
        raise complaint(
            f"{called}, key robot.file",
            "a robot file",
            "no such key",
            'write file = "robot.toml" or builtin = "<name>" under [robot]',
        )
    path = inside(folder, section["file"], "key robot.file", called)
    if path.suffix.lower() == ".urdf":
        return _urdf(path, section)
    if path.suffix.lower() != ".toml":
        raise complaint(
            f"{called}, key robot.file",
            "a .toml or .urdf file",
            repr(section["file"])[:60],
            "name one",
        )
    robot = read_toml(path, label(path))
    check_robot(robot, label(path))
    return robot


def check_robot(robot: Mapping, called: str) -> None:
    """Raise InputError where the keys of a robot.toml are incomplete or cannot describe an arm."""
    check_keys(robot, ROBOT, called)
    for number, joint in enumerate(robot["joint"], 1):
        where = f"{called}, [[joint]] {number}"
        check_keys(joint, JOINT, where)
        _check_coupling(joint, len(robot["joint"]), number, where)
        _check_radians(joint, where)
    reach = nominal_reach(robot)
    if 0 < reach < 10 and not any(j.get("kind") == "prismatic" for j in robot["joint"]):
        raise complaint(
            f"{called}, keys a_mm and d_mm",
            "lengths in mm",
            f"an arm that is {reach:.3g} mm long in all, as if in metres",
            "multiply them by 1000",
        )


def nominal_reach(robot: Mapping) -> float:
    """Sum of |a| + |d| over the joints, mm: no point of the flange is farther from the base.

    nan where the robot's numbers are not in the recording (built-in arm, URDF).
    """
    if "joint" not in robot:
        return math.nan
    return sum(abs(j["a_mm"]) + abs(j["d_mm"]) for j in robot["joint"])


def _check_coupling(joint: Mapping, count: int, number: int, where: str) -> None:
    if "coupled" in joint and not (
        joint["coupled"]["joint"] <= count and joint["coupled"]["joint"] != number
    ):
        raise complaint(
            f"{where}, key coupled.joint",
            f"another joint, 1 to {count}",
            str(joint["coupled"]["joint"]),
            "name the joint whose motion is added",
        )


def _check_radians(joint: Mapping, where: str) -> None:
    for key in ("theta_deg", "alpha_deg"):
        if any(abs(joint[key] - r) < 1e-3 for r in RADIANS):
            raise complaint(
                f"{where}, key {key}",
                "an angle in degrees",
                f"{joint[key]}, a multiple of pi/2 as if in radians",
                "multiply it by 57.29578",
            )


def _urdf(path: Path, section: Mapping) -> dict:
    text = read_text(path, label(path))
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as problem:
        raise complaint(
            label(path), "a URDF", f"XML that breaks off ({problem})", "export it again"
        ) from None
    if root.tag != "robot":
        raise complaint(
            label(path),
            "a URDF whose outermost element is <robot>",
            f"<{root.tag}>",
            "name the URDF",
        )
    names = {j.get("name") for j in root.iter("joint")}
    for name in section.get("joints", ()):
        if name not in names:
            raise complaint(
                f"{label(path)}, key robot.joints",
                "joints of the URDF",
                repr(name),
                "correct the name",
            )
    return {
        "urdf": str(path),
        **{k: section[k] for k in ("joints", "tip", "mimic", "gravity") if k in section},
    }
