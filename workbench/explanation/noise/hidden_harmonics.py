"""Whether noise above the stated sigma may be transmission errors whose orders the recorded poses do not show.

A harmonic of a high order passes through complete periods from one pose to the next, so that one of unknown order at
another joint looks like white noise. It is found where its gain exceeds what the best of all orders at all joints
gains by chance. Where the harmonics of all other joints together could make the excess and each gain less, the two are
confounded.
"""

from collections.abc import Sequence

import numpy as np

from robot_model.effects.transmission import TransmissionHarmonic, high_orders, turning_joints
from workbench.core.distributions import chi2
from workbench.diagnosis.levels import MAJORITY, UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Alternative
from workbench.diagnosis.search.common_orders import rounded_order
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.noise.stated_noise import FROM_RESIDUALS, NoiseRatio

LABEL = "of an order that these poses do not show"
WHY = "a harmonic of a high order and of unknown phase looks like noise in few poses"
_LOWEST = float(high_orders(np.nan)[0].min())
_NUMBERS = 2  # amplitude and phase of a harmonic


def hidden_harmonics(
    found: NoiseRatio, terms: Sequence[Term], degrees: float, chain
) -> tuple[Alternative, ...]:
    """Harmonics at other joints as alternatives to noise larger than stated; () where these poses would show them.

    terms: those retained, of which one is a harmonic of a high order, else no gear is known to make them. degrees: of
    freedom of the residual. chain: of the bench.
    """
    if found.source != FROM_RESIDUALS or not found.factor > 1:
        return ()
    known = {harmonic.where for harmonic in _harmonics(terms)}
    others = [where for where in turning_joints(chain, 0.0) if where not in known]
    if not known or not others:
        return ()
    excess = degrees * (1 - found.factor**-2)
    if excess / len(others) > least_gain(len(others)):
        return ()
    probability = MAJORITY / len(others)
    name = TransmissionHarmonic.effect
    return tuple(Alternative(name, where, LABEL, probability, 1.0, WHY) for where in others)


def least_gain(joints: int) -> float:
    """Fall of the sum of squares, in variances, by which the best of all orders at some joints is significant."""
    searched = joints * len(high_orders(np.nan)[0])
    return float(chi2.isf(UNMODELLED_LEVEL / searched, _NUMBERS))


def _harmonics(terms: Sequence[Term]) -> list[TransmissionHarmonic]:
    """The retained harmonics of a high order."""
    effects = [effect for term in terms for effect in term.finding.effects]
    harmonics = [effect for effect in effects if isinstance(effect, TransmissionHarmonic)]
    return [harmonic for harmonic in harmonics if rounded_order(harmonic.order) >= _LOWEST]


__all__ = ["LABEL", "WHY", "hidden_harmonics", "least_gain"]
