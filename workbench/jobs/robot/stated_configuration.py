"""Configuration data of a robot program choose which of the solutions of the inverse kinematics a pose takes.

| maker | data | meaning |
|---|---|---|
| KUKA | T | bit k - 1 is 1 where axis k is negative |
| KUKA | S | bit 0: wrist centre behind axis 1; bit 1: axis 3 beyond the stretched arm; bit 2: axis 5 negative |
| ABB | cf1, cf4, cf6 | quadrant of axes 1, 4, 6: 0 from 0 to 90 deg, -1 from -90 to 0 deg |
| ABB | cfx | sum of 4: wrist centre behind axis 1; 2: behind the lower arm; 1: axis 5 negative |
| FANUC | F, N | axis 5 positive, negative |
| FANUC | U, D | wrist centre before, behind the lower arm |
| FANUC | T, B | wrist centre before, behind axis 1 |
| FANUC | t1, t4, t6 | revolutions of axes 1, 4, 6: 0 from -180 to 180 deg, 1 from 180 to 540 deg |

Sources: KUKA System Software, status and turn of a position; ABB RAPID reference, confdata; FANUC as measured on
ROBOGUIDE, the simulation by the maker, for CrossArm (github.com, `convert/configuration.py`).
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import forward
from robot_model.configuration import configuration_signs, has_configurations
from robot_model.robot import Robot
from robot_model.task_priority import Task
from workbench.files.targets import CONFIGURATION
from workbench.jobs.robot.compensate import search_readings

_KUKA = re.compile(r"(?:S (?P<status>\d+))?(?:, )?(?:T (?P<turn>\d+))?")
_FANUC = re.compile(r"([FN]) ([UD]) ([TB]), (-?\d+), (-?\d+), (-?\d+)")
_TRIES = 60
_ROUNDING_DEG = 0.01  # of a stored pose, next to the border between two signs
_NAMED = 6
_JOINTS = 6


@dataclass(frozen=True)
class _Stated:
    """`low`, `high` (6,) deg of the joint readings; `is_beyond`: joint 3 beyond the stretched arm, None: not stated;
    `is_behind`: wrist centre behind axis 1, None: not stated, or decided by the sign of joint 1."""

    low: np.ndarray
    high: np.ndarray
    is_beyond: bool | None
    is_behind: bool | None = None


def with_stated_configuration(programme, robot: Robot) -> tuple:
    """The programme with readings in the stated configurations to start from, and sentences on them.

    programme: `workbench.files.targets.Programme`. It is returned as it is where it states no configuration of this
    robot, a robot with six rotary joints.
    """
    column = programme.table.columns.get(CONFIGURATION)
    if column is None or not programme.anywhere or not has_configurations(robot):
        return programme, []
    stated = [_parsed(str(text)) for text in column]
    rows = np.array([k for k, one in enumerate(stated) if one is not None], int)
    if not rows.size:
        return programme, []
    readings, is_found = _found(programme, robot, stated, rows)
    made = replace(
        programme,
        readings=readings,
        anywhere=not is_found.all() or len(rows) < _count_poses(programme),
        is_configured=True,
    )
    return made, _sentences(column, rows, is_found)


def _count_poses(programme) -> int:
    is_joint = programme.is_joint
    return len(programme.readings) if is_joint is None else int((~is_joint).sum())


def _parsed(text: str) -> _Stated | None:
    """The limits that configuration data set; None for data of another maker."""
    kuka = _KUKA.fullmatch(text)
    if text and kuka:
        return _of_kuka(kuka["status"], kuka["turn"])
    fanuc = _FANUC.fullmatch(text)
    if fanuc:
        return _of_fanuc(*fanuc.groups())
    numbers = text.split(", ")
    if len(numbers) == 4 and all(re.fullmatch(r"-?\d+", number) for number in numbers):
        return _of_abb([int(number) for number in numbers])
    return None


def _of_kuka(status: str | None, turn: str | None) -> _Stated:
    low, high = np.full(_JOINTS, -np.inf), np.full(_JOINTS, np.inf)
    if status is not None:
        _set_sign(low, high, 4, bool(int(status) & 4))
    if turn is not None:
        for k in range(_JOINTS):
            _set_sign(low, high, k, bool(int(turn) >> k & 1))
    return _Stated(low, high, None if status is None else bool(int(status) & 2))


def _of_abb(numbers: list[int]) -> _Stated:
    low, high = np.full(_JOINTS, -np.inf), np.full(_JOINTS, np.inf)
    for k, quadrant in zip((0, 3, 5), numbers):
        low[k], high[k] = 90.0 * quadrant, 90.0 * (quadrant + 1)
    _set_sign(low, high, 4, bool(numbers[3] & 1))
    return _Stated(low, high, not numbers[3] & 2)


def _of_fanuc(flip: str, elbow: str, side: str, *revolutions: str) -> _Stated:
    low, high = np.full(_JOINTS, -np.inf), np.full(_JOINTS, np.inf)
    for k, count in zip((0, 3, 5), revolutions):
        low[k], high[k] = 360.0 * int(count) - 180, 360.0 * int(count) + 180
    _set_sign(low, high, 4, flip == "N")
    return _Stated(low, high, elbow == "D", side == "B")


def _set_sign(low: np.ndarray, high: np.ndarray, joint: int, is_negative: bool) -> None:
    if is_negative:
        high[joint] = 0.0
    else:
        low[joint] = 0.0


def _found(programme, robot: Robot, stated, rows) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, 6) rad in the stated configurations, and (m,) bool: for which of the rows there are some."""
    rng, task = np.random.default_rng(0), Task.of(robot, {})
    readings, is_found = programme.readings.copy(), np.zeros(len(rows), bool)
    for _ in range(_TRIES):
        left = np.flatnonzero(~is_found)
        if not left.size:
            break
        starts = np.stack([_start(stated[rows[k]], robot, rng) for k in left])
        found, good = search_readings(robot, starts, programme.poses[rows[left]], task)
        good &= _matches(robot, found, [stated[rows[k]] for k in left])
        readings[rows[left[good]]] = found[good]
        is_found[left[good]] = True
    return readings, is_found


def _start(stated: _Stated, robot: Robot, rng) -> np.ndarray:
    """(6,) rad: random readings within the stated limits and those of the joints."""
    limits = np.where(np.isnan(robot.limits), [-np.pi, np.pi], robot.limits)
    low = np.maximum(np.deg2rad(stated.low), limits[:, 0])
    high = np.minimum(np.deg2rad(stated.high), limits[:, 1])
    return rng.uniform(np.minimum(low, high), np.maximum(low, high))


def _matches(robot: Robot, readings: np.ndarray, stated) -> np.ndarray:
    """(m,) bool: whether readings (m, 6) rad are in the stated configurations."""
    angles = np.rad2deg(readings)
    low, high = (np.stack([getattr(one, name) for one in stated]) for name in ("low", "high"))
    is_within = (angles >= low - _ROUNDING_DEG) & (angles <= high + _ROUNDING_DEG)
    axes = forward(robot, robot.mixing @ readings.T).z
    growing = np.sign((axes[1] * axes[2]).sum(0) * robot.mixing[2, 2])
    signs = configuration_signs(robot, readings)
    beyond = signs[:, 1] * growing
    # the wrist in the direction in which positive readings of joint 2 lean the arm, seen from axis 1
    behind = signs[:, 0] * np.sign(axes[0, 2] * robot.mixing[1, 1])
    return (
        is_within.all(1)
        & (beyond * _wanted([one.is_beyond for one in stated]) >= 0)
        & (behind * _wanted([one.is_behind for one in stated]) >= 0)
    )


def _wanted(stated) -> np.ndarray:
    """(m,) 1, -1, or 0 where nothing is stated."""
    return np.array([0 if one is None else 1 if one else -1 for one in stated])


def _sentences(column, rows, is_found) -> list[str]:
    said = []
    if is_found.any():
        said.append(
            f"The configuration data of {is_found.sum()} of {len(column)} positions "
            f"({column[rows[is_found][0]]}, ...) chose their configuration."
        )
    if not is_found.all():
        missing = [str(row + 1) for row in rows[~is_found]]
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        said.append(
            f"No joint readings of the nominal arm in the stated configuration ({column[rows[~is_found][0]]}) reach "
            f"position {', '.join(missing[:_NAMED])}{more}: another configuration is taken. Check these data."
        )
    return said


__all__ = ["with_stated_configuration"]
