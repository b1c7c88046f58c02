"""Which terms may act side by side.

Variants of one law exclude one another. A smooth nonparametric alternative excludes the laws at its place that it can
make: those that read the same covariates, for a law is a function of these, too.
"""

from collections.abc import Sequence

import numpy as np

from robot_model.effects.coupling import JointCoupling
from robot_model.effects.nonparametric import SHARP_DEGREE
from robot_model.effects.transmission import TransmissionHarmonic
from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.linear.hypotheses import Hypothesis

_WAVE = TransmissionHarmonic.effect
CLOSE_GAIN = 6.0
"""Variances of noise: a difference of gains that chance makes once in seventy times."""
_SLOW = 6.0
"""Highest order of a harmonic that a smooth function of any angles follows over the range that a joint moves."""


def compatible(h: Hypothesis, other: Hypothesis) -> bool:
    """Whether two terms may act side by side."""
    if bool(h.smooth_covariates) != bool(other.smooth_covariates):
        if h.smooth_covariates:
            function, law = h, other
        else:
            function, law = other, h
        return not _represents_law(function, law)
    if h.smooth_covariates:
        return h.key != other.key or h.smooth_covariates != other.smooth_covariates
    return h.family != other.family or (h.coexists and h.label != other.label)


def only_generalises(other: Hypothesis, special: Hypothesis, chance: float) -> bool:
    """Whether another law contains this one as a special case, and what it has more explains no more than chance.

    It is then no other name: friction that does not grow with the load is backlash. chance: `CLOSE_GAIN` variances.
    """
    contains = any(special.effect in effect.subsumes for effect in other.effects)
    is_larger = other.where == special.where and other.rank > special.rank
    return contains and is_larger and other.gain <= special.gain + chance


def same_place(law: Hypothesis) -> tuple[str, ...]:
    """A law's place, and of a joint the links before and after it: they turn about its axis, too."""
    if not law.where.startswith("joint-"):
        return (law.where,)
    k = int(law.where.rpartition("-")[2])
    return law.where, f"link-{k}", f"link-{k - 1}" if k > 1 else "base"


def equivalent_places(where: str, names: Sequence[str], joints: int) -> tuple[str, ...]:
    """Other links, base or tool at which a function of these covariates makes the same: it may move in any direction.

    A twist in the frame of one link is, in that of a neighbour, mixed by the angle of the joint between them. Where the
    function reads this angle, it is such a function there as well. No joint is between the last link and the tool.
    """
    links = (f"link-{k}" for k in range(1, joints + 1))
    frames = ["base", *links, "tool"]
    if where not in frames:
        return ()
    by_joint = [f"q{k}" in names for k in range(1, joints + 1)]
    joins_next = by_joint + [True]
    first = last = frames.index(where)
    while first > 0 and joins_next[first - 1]:
        first -= 1
    while last < joints + 1 and joins_next[last]:
        last += 1
    return tuple(frame for frame in frames[first : last + 1] if frame != where)


def is_neighbour(place: str, other: str) -> bool:
    """Whether two places are the same, or of neighbouring links."""
    numbers = [int(p.rpartition("-")[2]) for p in (place, other) if "-" in p]
    return place == other or len(numbers) == 2 and abs(numbers[0] - numbers[1]) <= 1


def _represents_law(function: Hypothesis, law: Hypothesis) -> bool:
    """Whether a smooth function excludes a law: it acts on the same port and reads the same covariates.

    At a joint a function of any angles leaves none for slow waves and for another angle's share either.
    """
    if function.where not in same_place(law) or _is_too_fast(law):
        return False
    angles = all(name[0] == "q" for name in function.smooth_covariates)
    slow = law.effect == _WAVE and law.effects and law.effects[0].order <= _SLOW
    if angles and function.where == law.where and (slow or law.effect == JointCoupling.effect):
        return True
    function_covariates = set(function.smooth_covariates)
    return bool(law.reads & function_covariates)


def _is_too_fast(law: Hypothesis) -> bool:
    """Whether a wave has more cycles in these poses than the sharpest smooth function can follow."""
    is_scan = isinstance(law.source, Scan)
    return is_scan and np.pi * law.source.cycles(law.value) > SHARP_DEGREE
