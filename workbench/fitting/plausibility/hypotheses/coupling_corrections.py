"""Mistakes in the robot file: a joint whose angle also follows the reading of an earlier joint, as of a parallelogram.

The drive of a joint acts through the joints before it. Where it stands on an earlier link, as that of a parallelogram
arm or of a FANUC joint 3, which is counted from the horizontal, the motion of the earlier joint moves the later one.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from datasets.importers.sources.dh_tables import DH_TABLE
from workbench.fitting.plausibility.hypotheses.corrections import Correction

CAUSE = "coupled-joints"
_RATIOS = (-1.0, 0.0, 1.0)
"""Of a parallelogram or a reading from the horizontal, and of readings that the controller has corrected for it."""
_SAME = 1e-3


def coupling_corrections(robot) -> Iterator[Correction]:
    """Every other whole ratio by which the reading of an earlier revolute joint moves a later one."""
    if robot.mixing.shape != (robot.joints,) * 2:
        return  # mimic joints of a URDF state their couplings
    revolute = np.flatnonzero(~robot.prismatic)
    for joint in revolute:
        for other in revolute[revolute < joint]:
            stated = robot.mixing[joint, other]
            for ratio in _RATIOS:
                if abs(ratio - stated) > _SAME:
                    yield coupling_correction(robot, (int(joint), int(other)), ratio)


def coupling_correction(robot, place: tuple[int, int], ratio: float) -> Correction:
    """Joint and other joint (indices) coupled with a ratio."""
    joint, other = place
    stated = float(robot.mixing[joint, other])
    subject = f"robot file of '{robot.name}', joint {joint + 1}"
    key = f"coupled = {{ joint = {other + 1}, ratio = {ratio:g} }}"
    remedy = f"write {key} under [[joint]] number {joint + 1} of robot.toml"
    if robot.source.startswith(DH_TABLE) and not stated:
        sign = "+" if ratio > 0 else "-"
        if abs(ratio) == 1:
            term = f"q{other + 1}"
        else:
            term = f"{abs(ratio):g}*q{other + 1}"
        remedy += f", or {sign} {term} into its theta in the table (q{joint + 1} {sign} {term})"
    if not stated:
        statement = f"lacks its coupling (its angle is {_angle(robot, place, ratio)})"
    elif ratio:
        statement = (
            f"is coupled to joint {other + 1} with a ratio of {stated:g} instead of {ratio:g}"
        )
    else:
        statement = f"is coupled to joint {other + 1}, and the readings are not"
        remedy = "remove its key coupled"
    return Correction(
        CAUSE,
        subject,
        statement,
        remedy,
        frozenset({f"coupling {joint}"}),
        _with_ratio(place, ratio),
    )


def _angle(robot, place: tuple[int, int], ratio: float) -> str:
    """ "reading 3 - reading 2": how a joint's angle follows from two readings."""
    joint, other = place
    sign = "-" if robot.mixing[joint, joint] < 0 else ""
    size = "" if abs(ratio) == 1 else f"{abs(ratio):g} "
    return f"{sign}reading {joint + 1} {'+' if ratio > 0 else '-'} {size}reading {other + 1}"


def _with_ratio(place: tuple[int, int], ratio: float):
    def apply(robot, recording):
        mixing = robot.mixing.copy()
        mixing[place] = ratio
        return replace(robot, mixing=mixing), recording

    return apply
