"""Columns that have the names of the joints in the file of the robot, as tables written by ROS do."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from datasets.importers.mapping.columns.column_units import joined_units
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.recordings.importing.robots import robot_candidates

_SEPARATORS = re.compile(r"[\s\-./:]+")
_UNIT = re.compile(r"_?[\[(]?(rad|radians|deg|degrees|gon|mm|cm|m|in)?[\])]?")
_LEAST_LETTERS = 2
"""Joints named x and z, or 1 to 6, share their names with other columns."""


def with_named_joints(tables: Sequence[RawTable], mapping: Mapping, named: str | None) -> Mapping:
    """The mapping with the columns that have the names of all joints of a robot, in the order of the robot.

    named: robot that the user names. Unchanged where columns are stated, no table has these names, or several sets of
    columns have them. A robot that cannot be read is refused later.
    """
    if mapping.joints is not None or named is None:
        names = ()
    else:
        names = _joint_names(named)
    if not names:
        return mapping
    for table in tables:
        columns = columns_of_joints(table.columns, names)
        if columns:
            units = [read_header(name, table.units.get(name)).unit for name in columns]
            return replace(mapping, joints=Group(columns, joined_units(units), None))
    return mapping


def _joint_names(named: str) -> tuple[str, ...]:
    """Names of the joints with a reading; () where the file has none, or names without a meaning of their own."""
    try:
        keys = next(iter(robot_candidates(named, "").values()))
        robot = load_robot(keys, f"--robot {named}")
    except InputError:
        return ()
    names = robot.joint_names
    is_telling = all(sum(map(str.isalpha, name)) >= _LEAST_LETTERS for name in names)
    has_readings = len(names) == robot.mixing.shape[1] and len(set(names)) == len(names)
    return names if is_telling and has_readings else ()


def columns_of_joints(columns: Iterable[str], joints: Sequence[str]) -> tuple[str, ...]:
    """The columns whose headers hold the names of all joints between the same prefix and suffix; () without them.

    The plain names come first, and of several sets the only one that is neither a command nor a speed or a load.
    """
    columns_by_pattern: dict[tuple[str, str], dict[str, str]] = {}
    for column in columns:
        for joint in joints:
            pattern = _parts_around(column, joint)
            if pattern is not None:
                columns_by_pattern.setdefault(pattern, {}).setdefault(joint, column)
    complete = {
        pattern: found for pattern, found in columns_by_pattern.items() if len(found) == len(joints)
    }
    if ("", "") in complete:
        complete = {("", ""): complete["", ""]}
    measured = [found for found in complete.values() if _is_reading(found[joints[0]])]
    if len(measured) != 1:
        return ()
    return tuple(measured[0][joint] for joint in joints)


def _parts_around(column: str, joint: str) -> tuple[str, str] | None:
    """What stands before and behind the name of a joint in a header, without a unit; None where it is not there."""
    text, name = (_SEPARATORS.sub("_", part.strip().lower()) for part in (column, joint))
    match = re.search(rf"(?<![a-z0-9]){re.escape(name)}(?![a-z0-9])", text)
    if match is None:
        return None
    suffix = text[match.end() :]
    return text[: match.start()], "" if _UNIT.fullmatch(suffix) else suffix


def _is_reading(column: str) -> bool:
    header = read_header(column)
    return not header.is_nominal and not header.is_deviation
