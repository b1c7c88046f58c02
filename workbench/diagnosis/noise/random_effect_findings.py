"""Random effects as findings, and the covariates that were not recorded through which an effect may cause one."""

import numpy as np

from robot_model.effects.drift import JointThermalDrift, LinkThermalGrowth
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import Backlash, TimeOffset
from workbench.diagnosis.levels import RANDOM_EFFECT_LEVEL
from workbench.diagnosis.linear.problem import Alternative, Finding, Located, Problem
from workbench.diagnosis.noise.random_effects import RandomEffect, directions, find_random_effect

QUANTISATION = "encoder-quantisation"
"""A finding on the data: readings of a joint with a random error, such as that of encoder counts."""
LABEL = "from sample to sample, with nothing that was recorded"
LAST_MOVE_LABEL = "from sample to sample, back along the last moves"
_COLUMNS = {
    "approach": "approach",
    "temperature": "temperature",
    "payload": "payload",
    "speed": "qdot",
}


def movement(random_effect: RandomEffect) -> float:
    """Sum of squares of all that it moves, in sigmas."""
    return float((random_effect.spread**2 * directions(random_effect.site, 1) ** 2).sum())


def random_effect_finding(random_effect: RandomEffect, problem: Problem) -> Finding:
    """In words of the vocabulary: rounding where it follows the reading's counts, else an unknown and what may lack."""
    size = float(np.sqrt(movement(random_effect) / len(problem.residual)))
    p, site = random_effect.p_value, random_effect.site
    given = (p, 1.0 - p, size, movement(random_effect))
    if random_effect.rounds < RANDOM_EFFECT_LEVEL:
        return Finding(QUANTISATION, site.where, "", (), *given)
    if site.where == "time" and len(site.rows) == 1:
        label = LAST_MOVE_LABEL
    else:
        label = LABEL
    others = unrecorded_causes(random_effect, problem)
    return Finding("unknown", site.where, label, (), *given, alternatives=others)


def unrecorded_causes(random_effect: RandomEffect, problem: Problem) -> tuple[Alternative, ...]:
    """Possible causes through a covariate that was not recorded, the most probable first."""
    site, covariates = random_effect.site, problem.covariates
    kurtosis, error = random_effect.kurtosis, random_effect.error
    has_two_values = abs(kurtosis + 2) < min(2 * error, abs(kurtosis))  # -2 is a coin's
    warm = _warm(site)
    if site.port == "joint" and site.where != "time":
        rows = [(Backlash.effect, site.where, "by the side of approach", "approach"), *warm]
        rows = rows if has_two_values else rows[::-1]
        rows.append(_loaded(site))
    else:
        rows = warm
    if site.port != "geometry":
        rows.append((TimeOffset.effect, "time", "", "speed"))
    return _unrecorded(rows, covariates)


def unrecorded(problem: Problem, place: Located) -> tuple[Alternative, ...]:
    """Possible causes of the residual at a place through a covariate that was not recorded.

    Where the place has a random effect besides, as of `unrecorded_causes`; where it goes with time, what changes with
    time.
    """
    found = find_random_effect(problem, RANDOM_EFFECT_LEVEL)
    if found is not None and found.site.where == place.where:
        return unrecorded_causes(found, problem)
    if "time" not in place.depends_on:
        return ()
    rows = [*_warm(place), *([_loaded(place)] if place.port == "joint" else [])]
    return _unrecorded(rows, problem.covariates)


def _warm(place) -> list[tuple]:
    if not place.where.startswith(("joint", "link")):
        return []
    effect = JointThermalDrift.effect if place.port == "joint" else LinkThermalGrowth.effect
    return [(effect, place.where, "", "temperature")]


def _loaded(place) -> tuple:
    return JointCompliance.effect, place.where, "", "payload"


def _unrecorded(rows, covariates) -> tuple[Alternative, ...]:
    """Rows (effect, where, variant, kind of covariate) whose covariate does not vary here, as alternatives."""
    varying = [name for name, x in covariates.items() if np.ptp(x) > 0]
    alternatives, share = [], 1.0
    for effect, where, variant, kind in rows:
        if any(_COLUMNS[kind] in name for name in varying):
            continue
        share /= 2
        why = "it needs what was not recorded"
        alternatives.append(Alternative(effect, where, variant, share, 1.0, why, kind))
    return tuple(alternatives)


def place_of(random_effect: RandomEffect) -> Located:
    """The place as the answer lists it: nothing goes with its movement, its size is the spread."""
    site, p = random_effect.site, random_effect.p_value
    return Located(site.where, site.port, (), 0.0, p, random_effect.spread)
