"""Mistakes in joint readings, or in the choice of the robot, undone: flange poses as they would be without each."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import joint_columns, joint_number
from robot_model import builtin_robots, load_robot
from sensors.hand_eye.checks.mistakes import Reading
from workbench.core.errors import InputError
from workbench.core.rigid import inverse
from workbench.files.images.flange import flange_poses

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
    for cause, symptom, remedy, change in _column_changes(recording):
        changed = replace(recording, columns={**recording.columns, **change})
        yield Reading(cause, symptom, remedy, flange_poses(changed)[rows])
    yield from _other_robots(recording, rows)


def _column_changes(recording):
    """Cause, words, advice, and columns with the mistake undone; single joints first."""
    columns = recording.columns
    names = joint_columns(columns)
    revolute = [name for name in names if name.endswith("_deg")]
    for name in names:
        yield _signs(columns, (name,), f"column {name}")
    for a, b in combinations(names, 2):
        swapped = {a: columns[b], b: columns[a]}
        yield "joint-order", f"columns {a} and {b} look exchanged", "put them in order", swapped
    yield from _unit_changes(columns, revolute)
    yield from _zero_changes(columns, revolute)
    if len(revolute) > 2:
        yield from _coupling_changes(columns, *revolute[1:3])
    for a, b in combinations(names, 2):
        yield _signs(columns, (a, b), f"columns {a} and {b}")
    yield _signs(columns, tuple(names), "all joint columns")


def _signs(columns, names, called):
    changed = {name: -columns[name] for name in names}
    verb = "looks" if len(names) == 1 else "look"
    return "joint-sign", f"{called} {verb} as if of the opposite sign", f"negate {called}", changed


def _zero_changes(columns, revolute):
    for name in revolute:
        for offset in _OFFSETS_DEG:
            symptom = f"the zero of column {name} looks displaced by {-offset:g} deg"
            joint = joint_number(name)
            remedy = (
                f"add {offset:g} deg to {name}, or correct theta_deg of joint {joint} of the robot"
            )
            yield "joint-zero", symptom, remedy, {name: columns[name] + offset}


def _coupling_changes(columns, second, third):
    for sign, word in ((1, "plus"), (-1, "less")):
        symptom = f"the angle of joint 3 looks like {third} {word} {second}"
        changed = {third: columns[third] + sign * columns[second]}
        yield "coupled-joints", symptom, "write coupled under joint 3 of the robot", changed


def _unit_changes(columns, revolute):
    small = [name for name in revolute if np.abs(columns[name]).max() < _TURN]
    all_columns = [tuple(revolute)] if len(revolute) > 1 else []
    for names in [*((name,) for name in revolute), *all_columns]:
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
