"""Mistakes in the robot file: another arm, another convention, one wrong length or twist."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from robot_model import load_robot
from robot_model.robot import builtin_robots
from workbench.plausibility.corrections import Correction

ROBOT = "robot"


def robot_corrections(robot) -> Iterator[Correction]:
    """Every arm of the library with the same joints, and the other Denavit-Hartenberg convention."""
    other = "craig" if robot.convention == "distal" else "distal"
    yield Correction(
        "convention", f"robot file of '{robot.name}', key convention,", f"is '{robot.convention}' instead of '{other}'",
        f"write convention = \"{other}\"", frozenset({ROBOT}), _with_convention(other),
    )  # fmt: skip
    for name in builtin_robots():
        known = _known_robot(name)
        same_joints = np.array_equal(known.prismatic, robot.prismatic) and known.mixing.shape == robot.mixing.shape
        if same_joints and not _same_geometry(known, robot):
            yield Correction(
                "robot-file", f"robot file of '{robot.name}'", f"does not describe this arm, which is a {known.name}",
                f"use the robot '{name}'", frozenset({ROBOT}), _with_robot(known),
            )  # fmt: skip


@cache
def _known_robot(name):
    return load_robot({"builtin": name})


def _same_geometry(one, other) -> bool:
    same = one.convention == other.convention and np.allclose(one.mixing, other.mixing)
    return bool(same and np.allclose(one.geometry, other.geometry, atol=1e-3))


def _with_convention(convention):
    """The numbers as they stand, read in the other convention; which axes are parallel is asked again."""

    def apply(robot, recording):
        parallel = np.abs(np.sin(robot.geometry[:, 3])) < np.sin(np.deg2rad(1))
        parallel[-1 if convention == "distal" else 0] = False
        return replace(robot, convention=convention, hayati=parallel), recording

    return apply


def _with_robot(known):
    return lambda robot, recording: (known, recording)
