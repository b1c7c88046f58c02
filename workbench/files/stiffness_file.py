"""Measured or published stiffness of an arm, read from TOML.

robot = "abb_irb120"          # a built-in name, or a robot.toml, URDF or MJCF file relative to this one
source = "where the numbers are from"

[joint]                       # N m/rad, by joint number
1 = 1.2e5
2 = 0.9e5

[bearing]                     # tilting, N m/rad, by joint number
[link]                        # bending at mid-link, N m/rad, by link number
[pedestal]                    # N m/rad
about_x = 2e6
about_y = 2e6
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robot_model import load_robot
from robot_model.effects import elastic
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import is_robot_file
from workbench.core.text.structured_text import ContentError, read_toml
from workbench.files.solution_file import CalibratedArm

_TABLES = {
    "joint": (elastic.JointCompliance, "joint", "compliance"),
    "bearing": (elastic.BearingCompliance, "joint", "tilt"),
    "link": (elastic.LinkCompliance, "link", "bending"),
}
_PEDESTAL = ("about_x", "about_y")
_KEYS = ("robot", "source", *_TABLES, "pedestal")
_GEOMETRY = ("theta", "d", "a", "alpha", "beta")


def read_stiffness(path: Path) -> CalibratedArm:
    """The nominal arm with the stiffness that a file states. Raises InputError with file and key."""
    keys = _read(path)
    robot = _robot(keys, path)
    values: dict[str, float] = {}
    effects = []
    for table, (law, kind, name) in _TABLES.items():
        for number, stiffness in _table(keys, table, path).items():
            place = f"{kind}-{_number(number, robot, f'{path}, key {table}.{number}')}"
            effects.append(law(place))
            compliance = _compliance(stiffness, f"{path}, key {table}.{number}")
            values[f"{place}.{law.effect}.{name}"] = compliance
    pedestal = _table(keys, "pedestal", path)
    if pedestal:
        effects.append(elastic.PedestalCompliance("base"))
        values |= _of_pedestal(pedestal, path)
    nominal = {
        f"joint-{k + 1}.{name}{k + 1}": float(robot.geometry[k, c])
        for k in range(robot.joints)
        for c, name in enumerate(_GEOMETRY)
    }
    nothing = np.zeros((0, 0))
    source = {"source": str(keys.get("source", ""))}
    return CalibratedArm(
        robot,
        tuple(effects),
        nominal | values,
        (),
        nothing,
        robot.payload_com,
        0.0,
        True,
        "",
        source,
    )


def _read(path: Path) -> Mapping:
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path}: expected a stiffness file (TOML), found what cannot be read ({problem}); correct it"
        ) from None
    unknown = [key for key in keys if key not in _KEYS]
    if unknown or "robot" not in keys:
        found = f"the key {unknown[0]}" if unknown else "no key robot"
        raise InputError(
            f"{path}: expected the keys {', '.join(_KEYS)}, of which robot is required, found {found}; correct it"
        )
    return keys


def _robot(keys: Mapping, path: Path) -> Robot:
    name = keys["robot"]
    if not isinstance(name, str):
        raise InputError(
            f"{path}, key robot: expected a built-in name or a file, found {name!r}; correct it"
        )
    file = Path(path).parent / name
    if is_robot_file(file) and not file.is_file():
        raise InputError(
            f"{path}, key robot: expected the path of a file relative to this one, found no file {file}; correct it"
        )
    return load_robot(file if file.is_file() else name, f"{path}, key robot")


def _table(keys: Mapping, name: str, path: Path) -> Mapping:
    table = keys.get(name, {})
    if not isinstance(table, Mapping):
        raise InputError(
            f"{path}, key {name}: expected a table of stiffness values, found {table!r}; write [{name}]"
        )
    return table


def _number(text: str, robot: Robot, where: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= robot.joints:
        raise InputError(
            f"{where}: expected a number from 1 to {robot.joints}, found {text}; correct it"
        )
    if robot.prismatic[int(text) - 1]:
        raise InputError(
            f"{where}: expected a joint that turns, found a slide, whose stiffness is not taken; leave it out"
        )
    return int(text)


def _compliance(stiffness, where: str) -> float:
    """rad/(N m) of a stiffness in N m/rad."""
    is_number = isinstance(stiffness, int | float) and not isinstance(stiffness, bool)
    if not is_number or not math.isfinite(stiffness) or stiffness <= 0:
        raise InputError(
            f"{where}: expected a stiffness above zero in N m/rad, found {stiffness!r}; correct it, or leave out what "
            "is rigid"
        )
    return 1.0 / stiffness


def _of_pedestal(table: Mapping, path: Path) -> dict[str, float]:
    unknown = [key for key in table if key not in _PEDESTAL]
    if unknown:
        raise InputError(
            f"{path}, key pedestal: expected {' and '.join(_PEDESTAL)}, found {unknown[0]}; rename it"
        )
    return {
        f"base.{elastic.PedestalCompliance.effect}.{name}": (
            _compliance(table[name], f"{path}, key pedestal.{name}") if name in table else 0.0
        )
        for name in _PEDESTAL
    }


__all__ = ["read_stiffness"]
