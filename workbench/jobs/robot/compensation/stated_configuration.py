"""Configuration data of a robot program choose which of the solutions of the inverse kinematics a pose takes.

The data count the joints as the controller does. Where the robot file counts them as the maker of the controller, or a
mapping states how they differ ([controller]), they are read directly. Elsewhere each of the eight senses that the three
sides of the data may have is compared with the configurations of the recording: one of them has to fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from robot_model.chain import forward
from robot_model.controller_conventions import parts_like_controller
from robot_model.postures.configuration import configuration_signs, has_configurations
from robot_model.postures.task_priority import Task
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.core.text.row_numbers import listed_numbers
from workbench.files.solution_file import CalibratedArm
from workbench.files.targets import CONFIGURATION
from workbench.jobs.robot.compensation.compensate import search_readings
from workbench.jobs.robot.compensation.configuration_data import (
    ConfigurationData,
    parse_configuration,
)
from workbench.jobs.robot.compensation.configurations import with_start
from workbench.jobs.robot.compensation.revolutions import nearest_revolutions, recorded_middle

_STARTS, _ROUNDS = 10, 6  # of the search at positions where the first start led elsewhere
_ROUNDING_DEG = 0.01  # of a stored pose, next to the border between two signs
_NAMED = 6
_JOINTS = 6


@dataclass(frozen=True)
class _Wanted:
    """Constraints on the readings of m positions: between `low` and `high` (m, 6) deg, and `signs` (m, 3) of
    their configuration, 0 where any will do."""

    low: np.ndarray
    high: np.ndarray
    signs: np.ndarray

    def rows(self, chosen: np.ndarray) -> "_Wanted":
        """Those of some positions."""
        return _Wanted(self.low[chosen], self.high[chosen], self.signs[chosen])


def configured(programme, arm: CalibratedArm, start: str | None) -> tuple:
    """The programme with readings to start from, and sentences on them: those of `start`, else of its own data.

    programme: `workbench.files.targets.Programme`; start: as of `with_start`. Raises InputError as both.
    """
    if start is None:
        return with_stated_configuration(programme, arm)
    return with_start(programme, arm.robot, start), []


def with_stated_configuration(programme, arm: CalibratedArm) -> tuple:
    """The programme with readings in the stated configurations to start from, and sentences on them.

    programme: `workbench.files.targets.Programme`. It is returned as it is where it states no configuration of this
    robot, a robot with six rotary joints. Raises InputError where the data may mean several configurations.
    """
    column = programme.table.columns.get(CONFIGURATION)
    robot = arm.robot
    if column is None or not programme.anywhere or not has_configurations(robot):
        return programme, []
    stated = [parse_configuration(str(text)) for text in column]
    rows = np.array([k for k, signs in enumerate(stated) if signs is not None], int)
    if not rows.size:
        return programme, []
    data = [stated[k] for k in rows]
    is_alike = parts_like_controller(robot, data[0].maker)
    if programme.controller is not None or all(is_alike):
        readings, is_found = _found(
            programme.poses[rows], robot, _as_counted(data, programme, robot)
        )
        notes = []
    else:
        readings, is_found = _as_recorded(programme, arm, data, rows, is_alike)
        notes = [_recorded_sentence(data[0].maker)]
    starts = programme.readings.copy()
    starts[rows[is_found]] = readings[is_found]
    is_whole = is_found.all() and len(rows) == _count_poses(programme)
    with_configuration = replace(
        programme, readings=starts, anywhere=not is_whole, is_configured=True
    )
    return with_configuration, [*_sentences(column, rows, is_found), *notes]


def _count_poses(programme) -> int:
    is_joint = programme.is_joint
    if is_joint is None:
        return len(programme.readings)
    return int((~is_joint).sum())


def _as_counted(data: Sequence[ConfigurationData], programme, robot: Robot) -> _Wanted:
    """Configurations according to the controller: of readings as recorded, or changed as [controller] states."""
    signs = np.ones(_JOINTS)
    zeros = np.zeros(_JOINTS)
    if programme.controller is not None:
        signs = np.array(programme.controller.joint_signs, float)
        zeros = np.array(programme.controller.joint_zeros_deg)
    ends = [
        (np.stack([branch.low, branch.high], 1) - zeros[:, None]) * signs[:, None]
        for branch in data
    ]
    ends = np.sort(ends, axis=2)
    sides = _signs_of_sides(robot, signs) * [branch.sides for branch in data]
    sides[:, 2] = 0  # the limits of joint 5 say it
    return _Wanted(ends[..., 0], ends[..., 1], sides)


def _signs_of_sides(robot: Robot, signs: np.ndarray) -> np.ndarray:
    """(3,) signs of the configuration that belong to the sides of the data: behind axis 1, beyond the stretched arm,
    axis 5 negative.

    signs (6,): senses of the readings of the controller relative to those of the robot file.
    """
    frames = forward(robot, np.zeros((_JOINTS, 1)))
    axes = frames.z[:, :, 0]
    growing = np.diag(robot.mixing) * signs
    # the wrist in the direction in which growing readings of joint 2 lean the arm, seen from axis 1
    lean_sign = axes[0, 2] * growing[1]
    return np.sign([lean_sign, (axes[1] @ axes[2]) * growing[2], -growing[4]])


def _as_recorded(
    programme, arm: CalibratedArm, data, rows, is_alike: tuple[bool, bool]
) -> tuple[np.ndarray, np.ndarray]:
    """Readings (m, 6) rad in configurations of the recording, by the one sense of the data that fits, and (m,) True.

    is_alike: arm and wrist count like the controller, which fixes the senses of their sides. Raises InputError where
    no sense or several fit.
    """
    recorded = arm.configurations
    sides = np.array([branch.sides for branch in data]) * _signs_of_sides(
        arm.robot, np.ones(_JOINTS)
    )
    senses = [] if recorded is None else _senses(sides.any(0), is_alike)
    fitting = [sense for sense in senses if _are_recorded(sides * sense, recorded)]
    free = np.full((len(rows), _JOINTS), np.inf)
    readings = np.zeros((len(rows), _JOINTS))
    is_found = np.zeros(len(rows), bool)
    if len(fitting) == 1:
        wanted = _Wanted(-free, free, sides * fitting[0])
        readings, is_found = _found(programme.poses[rows], arm.robot, wanted)
    if not is_found.all():
        raise _ambiguous(programme, data[0].maker, rows[0], len(fitting))
    return nearest_revolutions(arm.robot, readings, recorded_middle(arm)), is_found


def _senses(is_stated: np.ndarray, is_alike: tuple[bool, bool]) -> list[tuple[int, ...]]:
    """The senses that the three sides may have: both of a stated side whose part counts unlike the controller."""
    is_known = (is_alike[0], is_alike[0], is_alike[1])
    possible_senses = [
        (1, -1) if is_branch_stated and not known else (1,)
        for is_branch_stated, known in zip(is_stated, is_known)
    ]
    return list(product(*possible_senses))


def _are_recorded(signs: np.ndarray, recorded: np.ndarray) -> bool:
    """Whether each configuration (m, 3), 0 for any, is one of the recorded ones (k, 3)."""
    differs = (signs[:, None] * recorded[None] < 0).any(2)
    return not differs.all(1).any()


def _ambiguous(programme, maker: str, row: int, count: int) -> InputError:
    text = programme.table.columns[CONFIGURATION][row]
    words = {
        0: "none of their meanings fits",
        1: "the only meaning of them that fits is not attainable in",
    }
    fitting = words.get(count, f"{count} of their possible meanings fit")
    return InputError(
        f"{programme.table.called}: expected configuration data ({text}, ...) of one meaning, found that the robot "
        f"file counts the joints with other zeros or senses than a controller of {maker} and that {fitting} the "
        "configurations of the recording; state [controller] joint_signs and joint_zeros_deg in a mapping file for "
        "--map, or joint readings to start from (--start)."
    )


def _found(poses: np.ndarray, robot: Robot, wanted: _Wanted) -> tuple[np.ndarray, np.ndarray]:
    """Readings (m, 6) rad as wanted at poses (m, 4, 4), and (m,) bool: where there are some."""
    rng = np.random.default_rng(0)
    task = Task.of(robot, {})
    readings = np.zeros((len(poses), _JOINTS))
    is_found = np.zeros(len(poses), bool)
    for starts in (1, *[_STARTS] * _ROUNDS):
        unsolved = np.repeat(np.flatnonzero(~is_found), starts)
        if not unsolved.size:
            break
        found, good = search_readings(
            robot, _starts(wanted.rows(unsolved), robot, rng), poses[unsolved], task
        )
        good &= _matches(robot, found, wanted.rows(unsolved))
        readings[unsolved[good]] = found[good]
        is_found[unsolved[good]] = True
    return readings, is_found


def _starts(wanted: _Wanted, robot: Robot, rng) -> np.ndarray:
    """(m, 6) rad: random readings within the wanted limits and those of the joints."""
    limits = np.where(np.isnan(robot.limits), [-np.pi, np.pi], robot.limits)
    low = np.maximum(np.deg2rad(wanted.low), limits[:, 0])
    high = np.minimum(np.deg2rad(wanted.high), limits[:, 1])
    return rng.uniform(np.minimum(low, high), np.maximum(low, high))


def _matches(robot: Robot, readings: np.ndarray, wanted: _Wanted) -> np.ndarray:
    """(m,) bool: whether readings (m, 6) rad are in the wanted configurations."""
    angles = np.rad2deg(readings)
    is_within = (angles >= wanted.low - _ROUNDING_DEG) & (angles <= wanted.high + _ROUNDING_DEG)
    differs = configuration_signs(robot, readings) * wanted.signs < 0
    return is_within.all(1) & ~differs.any(1)


def _recorded_sentence(maker: str) -> str:
    return (
        f"The robot file counts the joints with other zeros or senses than a controller of {maker}. One meaning of the "
        "data alone puts all positions into configurations of the recording, and it was taken, with revolutions of the "
        "joints nearest to the recorded ones ([controller] in a mapping file states another)."
    )


def _sentences(column, rows, is_found) -> list[str]:
    notes = []
    if is_found.any():
        notes.append(
            f"The configuration data of {is_found.sum()} of {len(column)} positions "
            f"({column[rows[is_found][0]]}, ...) chose their configuration."
        )
    if not is_found.all():
        notes.append(_unreached_sentence(column, rows[~is_found]))
    return notes


def _unreached_sentence(column, rows: np.ndarray) -> str:
    positions = listed_numbers(rows, _NAMED)
    return (
        f"No joint readings of the nominal arm in the stated configuration ({column[rows[0]]}) reach "
        f"position {positions}: another configuration is taken. Check these data."
    )


__all__ = ["with_stated_configuration"]
