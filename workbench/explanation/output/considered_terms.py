"""Terms that a diagnosis found likely and did not retain, as a part of the uncertainty of its corrected model.

A refused term is not estimated, but it may be there. Consider covariance analysis (Schmidt, Advances in Control Systems
3 (1966) 293; Bierman, Factorization Methods (1977), ch. 8): its parameters c stay at their null values with the second
moment E[c c'], and move the estimates x by S c, S = -P N_xc / s^2, with P the covariance of the estimates, N the normal
matrix and s the scale of the noise. Errors of the model at a target then hold what the term makes there by itself, and
what the estimates take over of it.
"""

from collections.abc import Sequence

import numpy as np

from workbench.core.distributions import norm
from workbench.core.effect import Effect
from workbench.core.least_squares.solver import normal_matrix
from workbench.core.solution import Stage
from workbench.diagnosis.validation.terms import Term
from workbench.files.considered import Considered
from workbench.jobs.robot.calibrate import Calibration, calibrate

_LEAST = 0.05
"""Probability below which a refused term is not considered."""
_FOLDS = 2  # of a calibration whose held-out error nobody reads


def considered_terms(
    refused: Sequence[Term], calibration: Calibration, stages: Sequence[Stage], rows_of
) -> Considered | None:
    """Covariance that the refused terms add to that of a calibration; None where there is nothing to add.

    stages: of the calibration; rows_of: makes the row of a plan of an effect. Raises InputError where the model with
    the terms cannot be calibrated.
    """
    likely = [t for t in refused if t.finding.effects and probability(t) > _LEAST]
    likely = _without_duplicates(likely, calibration)
    if not likely:
        return None
    added = tuple(
        Stage(
            f"refused {number}",
            term.title,
            tuple(rows_of(effect) for effect in term.finding.effects),
            loss=stages[-1].loss,
            earn=False,
        )
        for number, term in enumerate(likely, 1)
    )
    wider = calibrate(calibration.recording, (*stages, *added), folds=_FOLDS, trust_data=True)
    blocks = [_moments(wider, term.finding.effects, probability(term)) for term in likely]
    keys = tuple(key for keys, _ in blocks for key in keys)
    if not keys:
        return None
    moments = _block_diagonal([moments for _, moments in blocks])
    effects = tuple(effect for term in likely for effect in term.finding.effects)
    return Considered(effects, keys, *_covariance(calibration, wider, keys, moments))


def _without_duplicates(terms: Sequence[Term], calibration: Calibration) -> list[Term]:
    """The terms without those that share a parameter with the model or with a likelier one of them, in their order.

    They are variants of one effect at one place, such as backlash by gravity and by the side of approach.
    """
    used_keys = set(calibration.model.parameters.keys)
    distinct = []
    for term in sorted(terms, key=probability, reverse=True):
        effects = term.finding.effects
        parameter_keys = {
            p.key for effect in effects for p in effect.parameters(calibration.model.chain)
        }
        if parameter_keys.isdisjoint(used_keys):
            used_keys |= parameter_keys
            distinct.append(term)
    return [term for term in terms if any(term is other for other in distinct)]


def probability(term: Term) -> float:
    """Probability that the model with a refused term predicts better: of its held-out gain, else of its name."""
    if term.t_fall is None or not np.isfinite(term.t_fall):
        return float(np.clip(term.finding.probability, 0.0, 1.0))
    return float(norm.cdf(term.t_fall))


def _moments(
    wider: Calibration, effects: Sequence[Effect], chance: float
) -> tuple[list[str], np.ndarray]:
    """Keys (K,) of the estimated parameters of a term, and E[c c'] (K, K) where it is there by chance."""
    parameter_keys = {p.key for effect in effects for p in effect.parameters(wider.model.chain)}
    solution = wider.solution
    keys = [key for key in _free(wider) if key in parameter_keys]
    rows = [_free(wider).index(key) for key in keys]
    value = np.array([solution.parameters.values[solution.parameters.index[key]] for key in keys])
    second = np.outer(value, value) + solution.covariance[np.ix_(rows, rows)]
    return keys, chance * second


def _covariance(
    calibration: Calibration, wider: Calibration, keys, moments
) -> tuple[np.ndarray, float]:
    """(F + K, F + K) of the estimates and the considered parameters, and RMS mm of these at the recorded poses."""
    estimated = _free(calibration)
    # with the sigma of the calibration, which its covariance has
    model = wider.model.with_chain(calibration.model.chain)
    model = model if calibration.fitted is None else model.part(calibration.fitted)
    parameters = wider.solution.parameters
    parameters = parameters.only(np.isin(parameters.keys, [*estimated, *keys]))
    order = [_masked(parameters).index(key) for key in (*estimated, *keys)]
    information = normal_matrix(model, parameters)[np.ix_(order, order)]
    count = len(estimated)
    solution = calibration.solution
    shift = -solution.known.covariance @ information[:count, count:] / solution.noise_scale**2
    both = np.concatenate([shift, np.eye(len(keys))])
    covariance = both @ moments @ both.T
    # the normal matrix sums the squares of whitened residuals
    share = float(np.sum(information * covariance)) / model.chain.sigma.size
    recorded_rms_mm = _noise_distance(calibration) * np.sqrt(max(share, 0.0))
    covariance[:count, :count] += solution.covariance
    return covariance, float(recorded_rms_mm)


def _noise_distance(calibration: Calibration) -> float:
    """RMS mm of the distance that the sigmas make by which the calibration whitens positions."""
    positions = calibration.model.chain.sigma[:3]
    return float(np.sqrt((positions**2).sum(0).mean()))


def _free(calibration: Calibration) -> list[str]:
    return _masked(calibration.solution.parameters)


def _masked(parameters) -> list[str]:
    return [key for key, free in zip(parameters.keys, parameters.mask) if free]


def _block_diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    start = 0
    for block in blocks:
        end = start + len(block)
        joined[start:end, start:end] = block
        start = end
    return joined


__all__ = ["considered_terms", "probability"]
