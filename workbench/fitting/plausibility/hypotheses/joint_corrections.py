"""Mistakes in joint columns: signs, units, offsets and order."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from datasets.samples.columns import joint_columns, joint_number
from workbench.fitting.plausibility.hypotheses.corrections import (
    Correction,
    column_correction,
    listed,
    lost_decimal_points,
    named_columns,
    revolute_columns,
)

_MOST_SIGNS = 8
ANGLE_UNITS = {
    "radians": 180 / np.pi,
    "degrees that were converted from radians once too often": np.pi / 180,
    "gon": 0.9,
    "turns": 360.0,
    "tenths of a degree": 0.1,
    "milliradians": 0.18 / np.pi,
    "arc minutes": 1 / 60,
    "arc seconds": 1 / 3600,
}
_COMBINED_UNITS = ("radians", "gon")
_LENGTH_UNITS = {"m": 1000.0, "inches": 25.4, "cm": 10.0}
_OFFSETS = (90.0, -90.0, 180.0)
_WIDEST_DEG = 800.0
_SMALL_UNIT, _LEAST_COUNT = 0.06, 400.0
_LEAST_SEXAGESIMAL, _LAST_DIGIT = 20, 1e-6
"""Different readings, all of whose decimals are below .60 by chance once in 27,000; and a rounding error."""


def joint_corrections(robot, recording) -> Iterator[Correction]:
    """Every single mistake of one joint column, of two, or of all."""
    joints = joint_columns(recording.columns)
    yield from (sign_correction((name,)) for name in joints)
    if len(joints) > 2:
        yield sign_correction(tuple(joints), mistake_count=1)  # one convention, of all of them
    yield from _units(recording, joints)
    yield from _sexagesimal(recording)
    yield from lost_decimal_points(recording, revolute_columns(recording), _WIDEST_DEG)
    # an offset of the first joint is absorbed by the base, one of the last joint by the tool
    yield from _offsets(robot, [name for name in joints[1:-1] if name.endswith("_deg")])
    yield from _orders(joints)


def sign_vectors(recording) -> Iterator[Correction]:
    """Every combination of two or more joint columns with the opposite sign."""
    joints = [
        name for name in joint_columns(recording.columns) if np.ptp(recording.columns[name]) > 0
    ]
    if len(joints) > _MOST_SIGNS:
        joints = joints[:_MOST_SIGNS]
    for count in range(2, len(joints) + 1):
        yield from (sign_correction(names) for names in combinations(joints, count))


def order_vectors(recording) -> Iterator[Correction]:
    """Every cycle of three joint columns, in both directions."""
    joints = joint_columns(recording.columns)[:_MOST_SIGNS]
    for a, b, c in combinations(joints, 3):
        for names in ((a, b, c), (a, c, b)):
            first, second, third = names
            remedy = (
                f"name column {first} {third}, column {second} {first} and column {third} {second}"
            )
            sources = (second, third, first)
            yield _order(names, sources, "are exchanged in a cycle", remedy)


def unit_vectors(recording) -> Iterator[Correction]:
    """Every combination of two or more joint columns in radians or gon."""
    revolute = revolute_columns(recording)[:_MOST_SIGNS]
    for unit in _COMBINED_UNITS:
        factor = ANGLE_UNITS[unit]
        possible = [name for name in revolute if _could_hold(recording, name, factor)]
        for count in range(2, len(possible) + 1):
            yield from (_unit(names, unit, factor) for names in combinations(possible, count))


def sign_correction(names, mistake_count: int | None = None) -> Correction:
    """Joint columns with the opposite sign; mistake_count: elementary mistakes, one a column unless given."""
    if len(names) == 1:
        verb, pronoun = "has", "it"
    else:
        verb, pronoun = "have", "them"
    numbers = listed([joint_number(name) for name in names])
    return column_correction(
        "joint-sign",
        named_columns(names),
        f"{verb} the opposite sign",
        f"negate {pronoun}, or write sign = -1 for joint {numbers} of the robot file",
        lambda columns: {name: -columns[name] for name in names},
        names,
        mistake_count=mistake_count or len(names),
    )


def _units(recording, joints):
    revolute = revolute_columns(recording)
    for unit, factor in ANGLE_UNITS.items():
        fitting = [name for name in revolute if _could_hold(recording, name, factor)]
        yield from (_unit((name,), unit, factor) for name in fitting)
        if len(revolute) > 1 and (len(fitting) == len(revolute)):
            yield _unit(tuple(revolute), unit, factor, mistake_count=1)
    for unit, factor in _LENGTH_UNITS.items():
        yield from (_unit((name,), unit, factor) for name in joints if name.endswith("_mm"))


def _sexagesimal(recording) -> Iterator[Correction]:
    """Readings whose decimals are minutes, or minutes and seconds, of arc: 12.30 for 12 degrees 30 minutes.

    Decimals of degrees are below .60 in all of n readings with the probability 0.6^n.
    """
    for has_seconds, unit in ((False, "minutes"), (True, "minutes and seconds")):
        names = [
            name
            for name in revolute_columns(recording)
            if _could_be_sexagesimal(recording.columns[name], has_seconds)
        ]
        groups = [(name,) for name in names] + ([tuple(names)] if len(names) > 1 else [])
        for group in groups:
            yield column_correction(
                "joint-unit",
                named_columns(group),
                f"{'holds' if len(group) == 1 else 'hold'} degrees with {unit} of arc in the place of decimals",
                "convert to decimal degrees: divide the minutes by 60"
                + " and the seconds by 3600" * has_seconds,
                lambda columns, group=group, has_seconds=has_seconds: {
                    name: _decimal_degrees(columns[name], has_seconds) for name in group
                },
                group,
            )


def _could_be_sexagesimal(values: np.ndarray, has_seconds: bool) -> bool:
    """Whether the decimals of all readings (n,) are possible minutes, and seconds, and enough to be no chance."""
    different = np.unique(np.abs(values))
    minutes = 100 * (different % 1)
    possible = minutes < 60 - _LAST_DIGIT
    if has_seconds:
        possible &= 100 * ((minutes + _LAST_DIGIT) % 1) < 60
    return bool(len(different) >= _LEAST_SEXAGESIMAL and possible.all())


def _decimal_degrees(values: np.ndarray, has_seconds: bool) -> np.ndarray:
    """Decimal degrees of readings (n,) whose decimals are minutes, or minutes and seconds."""
    size = np.abs(values)
    minutes = 100 * (size % 1)
    if has_seconds:
        full_minutes = np.floor(minutes + _LAST_DIGIT)
        minutes = full_minutes + 100 * (minutes - full_minutes) / 60
    return np.sign(values) * (np.floor(size) + minutes / 60)


def _could_hold(recording, name, factor) -> bool:
    """Whether the readings stay within plausible angles once converted.

    In a small unit a joint that moves has large numbers; small ones would hardly move the joint once converted, and
    such a correction would hide the column instead of explaining it.
    """
    values = recording.columns[name]
    largest = np.abs(values).max()
    is_large_enough = factor > _SMALL_UNIT or largest > _LEAST_COUNT
    return bool(np.ptp(values) > 0 and largest * factor < _WIDEST_DEG and is_large_enough)


def _unit(names, unit, factor, mistake_count=None) -> Correction:
    return column_correction(
        "joint-unit",
        named_columns(names),
        f"{'holds' if len(names) == 1 else 'hold'} {unit}",
        f"convert to {'mm' if names[0].endswith('_mm') else 'degrees'}: multiply by {factor:.7g}",
        lambda columns: {name: factor * columns[name] for name in names},
        names,
        mistake_count=mistake_count or len(names),
    )


def _offsets(robot, revolute):
    for name in revolute:
        for offset in _OFFSETS:
            yield column_correction(
                "joint-offset",
                f"column {name}",
                f"is {'short of' if offset > 0 else 'beyond'} the zero of the robot file by {abs(offset):g} degrees",
                f"add {offset:g} degrees ({offset / 0.9:g} gon) to it{_change_of_theta(robot, name, offset)}",
                lambda columns, name=name, offset=offset: {name: columns[name] + offset},
                (name,),
            )


def _change_of_theta(robot, name, offset) -> str:
    """The change of the robot file that is the same as `offset` (deg) of a reading; "" where other joints move, too."""
    moved = robot.mixing[:, joint_number(name) - 1]
    joint = int(np.abs(moved).argmax())
    if np.count_nonzero(moved) > 1:
        return ""
    return f", or {offset * moved[joint]:g} to theta_deg of joint {joint + 1} of the robot file"


def _orders(joints):
    """Two columns swapped, all in reverse order, or all moved on in a cycle; slides have their place among them."""
    for a, b in combinations(joints, 2):
        yield _order((a, b), (b, a), "are swapped", "swap them back")
    if len(joints) > 2:
        yield _order(
            joints,
            joints[::-1],
            "are in reverse order",
            "name them in the order of the kinematic chain",
        )
        yield from (_moved_on(joints, places) for places in range(1, len(joints)))


def _moved_on(joints, places) -> Correction:
    """Columns that are named so many places too far on, in a cycle."""
    sources = joints[places:] + joints[:places]
    backward_steps = len(joints) - places
    if backward_steps < places:
        count, direction = backward_steps, "back"
    else:
        count, direction = places, "on"
    words = "one place" if count == 1 else f"{count} places"
    remedy = f"name the first of them {joints[-places]}"
    return _order(joints, sources, f"are moved {direction} by {words}", remedy)


def _order(names, sources, statement, remedy) -> Correction:
    return column_correction(
        "joint-order",
        named_columns(names),
        statement,
        remedy,
        lambda columns: {name: columns[source] for name, source in zip(names, sources)},
        names,
    )
