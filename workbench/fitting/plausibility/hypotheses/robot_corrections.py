"""Mistakes in the robot file: another arm, another convention, one wrong length or twist."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from robot_model.files.loading import builtin_robots, load_robot
from workbench.core.robot_files.robot_file import CONVENTIONS
from workbench.fitting.plausibility.hypotheses.corrections import Correction, listed

ROBOT = "robot"
_FEW_NUMBERS = 4
_ALPHA, _RIGHT_ANGLE = 3, np.sin(np.deg2rad(1))
"""Column of the geometry, and the largest cosine of the angle between axes that are perpendicular."""


def robot_corrections(robot) -> Iterator[Correction]:
    """Every arm of the library with the same joints, the other Denavit-Hartenberg convention, and each right angle
    between axes with the opposite sign."""
    yield from _twists(robot)
    other = "craig" if robot.convention == "distal" else "distal"
    yield Correction(
        "convention",
        f"robot file of '{robot.name}'",
        f"is read in the convention '{CONVENTIONS[other]}' and not, as it states, '{CONVENTIONS[robot.convention]}'",
        f'write convention = "{CONVENTIONS[other]}", in a Denavit-Hartenberg table into the name of the file',
        frozenset({ROBOT}),
        _with_convention(other),
    )
    for name in builtin_robots():
        known = _known_robot(name)
        same_joints = (
            np.array_equal(known.prismatic, robot.prismatic)
            and known.mixing.shape == robot.mixing.shape
        )
        if same_joints and not _same_geometry(known, robot):
            yield Correction(
                "robot-file",
                f"robot file of '{robot.name}'",
                _difference(robot, known),
                f"use the robot '{name}' of the library, or correct the file",
                frozenset({ROBOT}),
                _with_robot(known),
            )


def _twists(robot):
    for joint in np.flatnonzero(np.abs(np.cos(robot.geometry[:, _ALPHA])) < _RIGHT_ANGLE):
        yield Correction(
            "geometry",
            f"robot file of '{robot.name}', alpha_deg of joint {joint + 1}",
            "has the opposite sign",
            "negate it",
            frozenset({ROBOT}),
            _with_twist(joint),
        )


def _with_twist(joint):
    """The sine of the angle between two axes changes sign."""

    def apply(robot, recording):
        geometry = robot.geometry.copy()
        geometry[joint, _ALPHA] *= -1
        return replace(robot, geometry=geometry), recording

    return apply


@cache
def _known_robot(name):
    return load_robot({"builtin": name})


def _same_geometry(correction, other) -> bool:
    """Whether two arms differ in the signs and couplings of joints alone, which have corrections of their own."""
    same = correction.convention == other.convention
    return bool(same and np.allclose(correction.geometry, other.geometry, atol=1e-3))


def _difference(robot, known) -> str:
    """'does not describe this arm, which is …', or the few numbers that differ from the library's file."""
    names = ("theta", "d", "a", "alpha", "beta")
    units = (180 / np.pi, 1.0, 1.0, 180 / np.pi, 180 / np.pi)
    different = np.argwhere(~np.isclose(robot.geometry, known.geometry, atol=1e-3))
    same_joints = robot.convention == known.convention and np.allclose(robot.mixing, known.mixing)
    if len(different) > _FEW_NUMBERS or not same_joints:
        return f"does not describe this arm, which is a {known.name}"
    numbers = [
        f"{names[c]}{k + 1} is {robot.geometry[k, c] * units[c]:.5g} instead of {known.geometry[k, c] * units[c]:.5g}"
        for k, c in different
    ]
    return f"differs from the data of a {known.name}: {listed(numbers)}"


def _with_convention(convention):
    """The numbers as they stand, read in the other convention; which axes are parallel is asked again."""

    def apply(robot, recording):
        parallel = np.abs(np.sin(robot.geometry[:, 3])) < np.sin(np.deg2rad(1))
        parallel[-1 if convention == "distal" else 0] = False
        arm = replace(robot, convention=convention, hayati=parallel)
        return arm, recording

    return apply


def _with_robot(known):
    return lambda robot, recording: (known, recording)
