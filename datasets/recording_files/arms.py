"""The [robot] section of a recording: robot.toml, a URDF, or the name of a built-in arm."""

import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from datasets.errors import complaint
from datasets.files import file_in_folder, label, read_text, read_toml
from datasets.recording_files.keys import shown
from workbench.core.robot_files.builtin_names import builtin_keys, check_builtin_name
from workbench.core.robot_files.robot_description import is_description
from workbench.core.robot_files.robot_file import checked_robot_file

_UNIT = 1e-3  # by which the length of a unit vector may differ from 1


def read_robot(folder: Path, section: Mapping, called: str) -> dict:
    """Value of `Recording.robot`. Raises InputError for a missing or impossible robot."""
    urdf = is_description(str(section.get("file", "")))
    if "gravity" in section and ("builtin" in section or not urdf):
        raise complaint(
            f"{called}, key robot.gravity",
            "this key for a URDF only",
            shown(section["gravity"]),
            "write gravity into robot.toml and name that file",
        )
    if "builtin" in section:
        return _builtin(section, called)
    if "payload" in section:
        raise complaint(
            f"{called}, [robot.payload]",
            "this section next to builtin only",
            "it next to file",
            "write [payload] into the robot file",
        )
    if "file" not in section:
        raise complaint(
            f"{called}, key robot.file",
            "a robot file",
            "no such key",
            'write file = "robot.toml" or builtin = "<name>" under [robot]',
        )
    path = file_in_folder(folder, section["file"], "key robot.file", called)
    if is_description(path):
        return _urdf(path, section)
    if path.suffix.lower() != ".toml":
        raise complaint(
            f"{called}, key robot.file",
            "a .toml, .urdf or MJCF (.xml) file",
            repr(section["file"])[:60],
            "name one",
        )
    robot = read_toml(path, label(path))
    check_robot(robot, label(path))
    return robot


def _builtin(section: Mapping, called: str) -> dict:
    """The name of a built-in arm; with [robot.payload] all its keys, with this empty tool and centre of the load."""
    robot = {"builtin": section["builtin"]}
    if "payload" not in section:
        return robot
    check_builtin_name(section["builtin"], f"{called}, key robot.builtin")
    robot = {**builtin_keys(robot), "payload": section["payload"]}
    if "builtin" not in robot:
        check_robot(robot, f"{called}, [robot]")
    return robot


def check_robot(robot: Mapping, called: str) -> None:
    """Raise InputError where the keys of a robot.toml are incomplete or cannot describe an arm."""
    file = checked_robot_file(robot, called)
    if abs(math.hypot(*file.gravity) - 1) > _UNIT:
        raise complaint(
            f"{called}: key gravity",
            "three numbers, a unit vector",
            shown(file.gravity),
            "correct the value",
        )


def nominal_reach(robot: Mapping) -> float:
    """Sum of |a| + |d| over the joints and of [base] and [flange], mm: no point of the flange is farther from the base.

    nan where the robot's numbers are not in the recording (built-in arm, URDF).
    """
    if "joint" not in robot:
        return math.nan
    ends = [robot[name].get("xyz_mm", ()) for name in ("base", "flange") if name in robot]
    fixed = sum(math.hypot(*place) for place in ends)
    return fixed + sum(abs(j["a_mm"]) + abs(j["d_mm"]) for j in robot["joint"])


def _urdf(path: Path, section: Mapping) -> dict:
    text = read_text(path, label(path))
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as problem:
        raise complaint(
            label(path), "a URDF", f"XML that breaks off ({problem})", "export it again"
        ) from None
    if root.tag not in ("robot", "mujoco"):
        raise complaint(
            label(path),
            "a URDF or MJCF file whose outermost element is <robot> or <mujoco>",
            f"<{root.tag}>",
            "name the robot's file",
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
