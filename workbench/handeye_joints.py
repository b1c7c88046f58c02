"""Mistakes in joint readings, or in the choice of the robot, undone: flange poses as they would be without each."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from datasets.columns import joint_columns, joint_number
from datasets.recording import Recording
from robot_model import builtin_robots, load_robot
from sensors.hand_eye.mistakes import Reading
from workbench.core.errors import InputError
from workbench.core.rigid import inverse
from workbench.flange import flange_poses

_OFFSETS_DEG = (90.0, -90.0, 180.0)
_TURN = 2.1 * np.pi


def joint_readings(recording: Recording, rows: np.ndarray) -> Iterator[Reading]:
    """Every frequent mistake in the joint columns of a recording without flange poses.

    rows: (P,) rows of samples.csv, one per image. Order, sign, unit and zero of the joints; a coupled third joint;
    rows that are shifted; another robot with as many joints; sensor and board that have changed places.
    """
    given = flange_poses(recording)[rows]
    yield Reading(
        "inverse",
        "the sensor and the board look as if they had changed places (--kind)",
        "name the other --kind, or correct fixed_to under [board]",
        inverse(given),
    )
    for step, words in ((1, "of the image before"), (-1, "of the image after")):
        yield Reading(
            "shifted",
            f"the joint readings look shifted by one row: each image has those {words}",
            "shift the rows back, and look for an image that was lost",
            np.roll(given, -step, 0),
        )
    for cause, seems, do, change in _column_changes(recording):
        changed = replace(recording, columns={**recording.columns, **change})
        yield Reading(cause, seems, do, flange_poses(changed)[rows])
    yield from _other_robots(recording, rows)


def _column_changes(recording):
    columns = recording.columns
    names = joint_columns(columns)
    turning = [name for name in names if name.endswith("_deg")]
    for name in names:
        yield (
            "joint-sign",
            f"column {name} looks as if it had the opposite sign",
            f"negate {name}",
            {name: -columns[name]},
        )
    for a, b in combinations(names, 2):
        yield (
            "joint-order",
            f"columns {a} and {b} look exchanged",
            "put them in order",
            {
                a: columns[b],
                b: columns[a],
            },
        )
    yield from _unit_changes(columns, turning)
    for name in turning:
        for offset in _OFFSETS_DEG:
            yield (
                "joint-zero",
                f"the zero of column {name} looks displaced by {-offset:g} deg",
                (
                    f"add {offset:g} deg to {name}, or correct theta_deg of joint {joint_number(name)} of the robot"
                ),
                {name: columns[name] + offset},
            )
    if len(turning) > 2:
        second, third = turning[1:3]
        for sign, word in ((1, "plus"), (-1, "less")):
            seems = f"the angle of joint 3 looks like {third} {word} {second}"
            do = "write coupled under joint 3 of the robot"
            yield "joint-coupling", seems, do, {third: columns[third] + sign * columns[second]}
    for names_of_two in (*combinations(turning, 2), tuple(turning)):
        if len(names_of_two) > 1:
            listed = " and ".join(names_of_two) if len(names_of_two) == 2 else "all joint columns"
            yield (
                "joint-sign",
                f"{listed} look as if they had the opposite sign",
                "negate them",
                {name: -columns[name] for name in names_of_two},
            )


def _unit_changes(columns, turning):
    small = [name for name in turning if np.abs(columns[name]).max() < _TURN]
    together = [tuple(turning)] if len(turning) > 1 else []
    for names in [*((name,) for name in turning), *together]:
        listed = names[0] if len(names) == 1 else "all joint columns"
        if set(names) <= set(small):
            yield (
                "joint-unit",
                f"{listed} look like radians",
                "write degrees",
                {name: np.degrees(columns[name]) for name in names},
            )
        yield (
            "joint-unit",
            f"{listed} look like gon",
            "write degrees",
            {name: 0.9 * columns[name] for name in names},
        )


def _other_robots(recording, rows):
    for name in builtin_robots():
        if name == recording.robot.get("builtin"):
            continue
        try:
            poses = flange_poses(replace(recording, robot={"builtin": name}))[rows]
            title = load_robot({"builtin": name}).name
        except InputError:  # another number of joints
            continue
        yield Reading(
            "robot",
            f"the robot looks like another one than the recording names: {title}",
            f'write builtin = "{name}" under [robot], or correct robot.toml',
            poses,
        )
