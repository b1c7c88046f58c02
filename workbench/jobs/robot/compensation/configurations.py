"""Which configuration of the arm the corrected targets take, where the search for readings starts, and what changes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.files.loading import load_robot
from robot_model.postures.configuration import (
    configuration_name,
    configuration_signs,
    has_configurations,
)
from robot_model.postures.task_priority import LEVER_MM
from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_vector
from workbench.files.targets import LIMIT_SLACK
from workbench.jobs.robot.compensation.compensate import nominal_poses

_NAMED = 6


def with_start(programme, robot: Robot, start: str | None):
    """The programme with other readings to start from: stated ones, or those of the nearest pose of a recording.

    programme: `workbench.files.targets.Programme`; start: joint readings in deg and mm, separated by commas, or the
    folder or name of a recording; None keeps what the programme has. Raises InputError.
    """
    if start is None:
        return programme
    if programme.poses is None:
        raise InputError(
            "--start: expected targets that are poses, found joint readings, which state the configuration; leave the "
            "option out"
        )
    readings = _start_readings(programme.poses, robot, start)
    if programme.is_joint is not None:
        readings = np.where(programme.is_joint[:, None], programme.readings, readings)
    return replace(programme, readings=readings)


def _start_readings(poses: np.ndarray, robot: Robot, start: str) -> np.ndarray:
    """(n, R) rad, mm: the stated readings for every pose, or those of a recording at its nearest pose."""
    stated = _numbers(start)
    if stated is None:
        return _nearest_readings(poses, robot, start)
    return np.tile(_checked(stated, robot), (len(poses), 1))


def _numbers(text: str) -> list[float] | None:
    """The numbers of a list; None for any other text."""
    try:
        return [float(part) for part in text.replace(";", ",").replace(",", " ").split()]
    except ValueError:
        return None


def _checked(stated: Sequence[float], robot: Robot) -> np.ndarray:
    """(R,) rad, mm. Raises InputError for another number of readings, or one beyond the limits of its joint."""
    slides = sliding(robot)
    for k in np.flatnonzero(~np.isfinite(stated)):
        raise InputError(
            f"--start: expected finite joint readings (deg, mm), found {stated[k]:g} in place {k + 1}; correct it"
        )
    if len(stated) != len(slides):
        raise InputError(
            f"--start: expected {len(slides)} joint readings (deg, mm) or a recording, found {len(stated)} numbers; "
            "write one for each joint, as in --start 0,-90,90,0,90,0"
        )
    readings = np.where(slides, stated, np.deg2rad(stated))
    low, high = robot.limits.T
    for k in np.flatnonzero((readings < low - 1e-9) | (readings > high + 1e-9)):
        raise InputError(
            f"--start: expected readings within the limits of the joints, found {stated[k]:g} for joint {k + 1}; "
            "correct it"
        )
    return readings


def _nearest_readings(poses: np.ndarray, robot: Robot, name: str) -> np.ndarray:
    """(n, R) readings of the recorded pose that is nearest to each target."""
    import datasets

    recording = datasets.read(name, False)
    if recording.n:
        recorded = recording.joints[recording.moving]
    else:
        recorded = np.empty((0, 0))
    if recorded.size == 0 or recorded.shape[1] != robot.mixing.shape[1]:
        raise InputError(
            f"--start {name}: expected a recording with {robot.mixing.shape[1]} joint readings, found "
            f"{recorded.shape[1]}; name another, or state readings"
        )
    recorded = _usable_readings(recording, recorded, robot, name)
    seen = nominal_poses(robot, recorded)
    best = np.empty(len(poses), int)
    for k, target in enumerate(poses):
        place = np.linalg.norm(seen[:, :3, 3] - target[:3, 3], axis=1)
        relative = target[:3, :3].T @ seen[:, :3, :3]
        angle = np.linalg.norm(rotation_vector(relative), axis=1)
        best[k] = int(np.argmin(np.hypot(place, LEVER_MM * angle)))
    return recorded[best]


def _usable_readings(recording, recorded: np.ndarray, robot: Robot, name: str) -> np.ndarray:
    """The readings (m, R) within the limits of the joints.

    Raises InputError for those of another robot, by its name or its slides, and where none is within the limits.
    """
    if recording.robot:
        other = load_robot(recording.robot, f"--start {name}")
        if other.name != robot.name or (sliding(other) != sliding(robot)).any():
            raise InputError(
                f"--start {name}: expected a recording of the robot '{robot.name}', found one of '{other.name}'; name "
                "another, or state readings"
            )
    low, high = robot.limits.T
    is_outside = (recorded < low - LIMIT_SLACK) | (recorded > high + LIMIT_SLACK)
    if is_outside.any(1).all():
        joint = int(np.argmax(is_outside.sum(0))) + 1
        raise InputError(
            f"--start {name}: expected samples within the limits of the joints, found none, most often for joint "
            f"{joint}; name another recording, or state readings"
        )
    return recorded[~is_outside.any(1)]


def configurations_json(robot: Robot, readings: np.ndarray) -> list[dict]:
    """Each configuration with the numbers of its targets, from 1; empty for arms that have no names for theirs.

    readings (n, R), nan where a target has none.
    """
    if not has_configurations(robot):
        return []
    rows: dict[str, list[int]] = {}
    for row, name in _named(robot, readings):
        rows.setdefault(name, []).append(row + 1)
    return [{"configuration": name, "rows": numbers} for name, numbers in rows.items()]


def _named(robot: Robot, readings: np.ndarray) -> list[tuple[int, str]]:
    """(row, configuration) of the targets that have readings."""
    rows = np.flatnonzero(np.isfinite(readings).all(1))
    signs = configuration_signs(robot, readings[rows])
    return [(int(row), configuration_name(signs_of_row)) for row, signs_of_row in zip(rows, signs)]


def configuration_changes(robot: Robot, readings: np.ndarray) -> list[str]:
    """A sentence where the configuration changes from one target to the next, and one where a joint turns far."""
    return [*_sign_changes(robot, readings), *_far_turns(robot, readings)]


def _sign_changes(robot: Robot, readings: np.ndarray) -> list[str]:
    if not has_configurations(robot):
        return []
    rows = np.flatnonzero(np.isfinite(readings).all(1))
    signs = configuration_signs(robot, readings[rows])
    places = []
    last = None
    side = np.zeros(signs.shape[1], int)
    for row, signs_of_row in zip(rows, signs):
        if (
            signs_of_row * side < 0
        ).any():  # a sign that is singular at a target keeps that of the targets before
            names = f"{configuration_name(side)}, then {configuration_name(signs_of_row)}"
            places.append(f"{last + 1} and {row + 1} ({names})")
        side = np.where(signs_of_row == 0, side, signs_of_row)
        last = row
    if not places:
        return []
    return [
        f"The configuration of the arm changes between targets {_listed_places(places)}: the arm passes a singular "
        "posture or moves far there. State readings for these targets, or a start for the search (--start)."
    ]


def _far_turns(robot: Robot, readings: np.ndarray) -> list[str]:
    """A joint that turns by more than half a revolution between two targets takes another revolution."""
    rows = np.flatnonzero(np.isfinite(readings).all(1))
    steps = np.abs(np.diff(readings[rows], axis=0)) * ~sliding(robot)
    places = [
        _step_words(rows[k : k + 2], joint, steps[k, joint])
        for k, joint in np.argwhere(steps > np.pi)
    ]
    if not places:
        return []
    return [f"A joint turns by more than 180 deg between targets {_listed_places(places)}."]


def _step_words(rows: np.ndarray, joint: int, step: float) -> str:
    """Two successive targets, by their rows, and the joint that turns by a step, rad, between them."""
    first, second = rows + 1
    return f"{first} and {second} (joint {joint + 1}, {np.rad2deg(step):.0f} deg)"


def _listed_places(places: Sequence[str]) -> str:
    if len(places) > _NAMED:
        unlisted = f" and {len(places) - _NAMED} more times"
    else:
        unlisted = ""
    return "; ".join(places[:_NAMED]) + unlisted
