"""Terms that a diagnosis found likely and did not retain, as a part of the uncertainty of its corrected model.

A refused term is not in the model, but it may be there, with the probability p. The uncertainty is that of the mixture
of both models (Hoeting et al., Stat. Sci. 14 (1999) 382): where the model predicts x with the covariance P, and the
model with the term y with Q, the second moment about x is P + p (Q - P + (y - x)(y - x)'). Both models fit the
recording, so that a term which other parameters imitate adds little at its poses, however large it is by itself.
"""

from collections.abc import Sequence

import numpy as np

from workbench.core.distributions import norm
from workbench.core.solution import Stage
from workbench.diagnosis.validation.terms import Term
from workbench.files.considered import Considered, ConsideredModel
from workbench.jobs.robot.calibrate import Calibration, calibrate

_MIN_PROBABILITY = 0.05
"""Probability below which a refused term is not considered."""
_MAX_TERMS = 3
"""Terms that are considered at most, the most probable ones: each is a fit of its own."""
_FOLDS = 2  # of a calibration whose held-out error nobody reads


def considered_terms(
    refused: Sequence[Term], calibration: Calibration, stages: Sequence[Stage], rows_of
) -> Considered | None:
    """Models with a refused term each; None where there is nothing to add.

    stages: of the calibration; rows_of: makes the row of a plan of an effect. Raises InputError where the model with
    a term cannot be calibrated.
    """
    likely = [t for t in refused if t.finding.effects and probability(t) > _MIN_PROBABILITY]
    likely = sorted(_without_duplicates(likely, calibration), key=probability, reverse=True)
    models, squares = [], 0.0
    for number, term in enumerate(likely[:_MAX_TERMS], 1):
        wider = calibrate(
            calibration.recording,
            (*stages, _stage(number, term, stages[-1].loss, rows_of)),
            folds=_FOLDS,
            trust_data=True,
        )
        model = _model(wider, term)
        if not any(key.startswith(_prefixes(term)) for key in model.free):
            continue  # the recording determines nothing of it
        models.append(model)
        squares += model.probability * _mean_square(calibration, wider)
    if models:
        return Considered(tuple(models), float(np.sqrt(squares)))
    return None


def _stage(number: int, term: Term, loss: str, rows_of) -> Stage:
    rows = tuple(rows_of(effect) for effect in term.finding.effects)
    return Stage(f"refused {number}", term.title, rows, loss=loss, earn=False)


def _without_duplicates(terms: Sequence[Term], calibration: Calibration) -> list[Term]:
    """The terms without those that share a parameter with the model or with a more probable term, in their order.

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


def _model(wider: Calibration, term: Term) -> ConsideredModel:
    parameters = wider.solution.parameters
    return ConsideredModel(
        tuple(term.finding.effects),
        dict(zip(parameters.keys, parameters.values.tolist())),
        tuple(_free(wider)),
        wider.solution.covariance,
        probability(term),
    )


def _prefixes(term: Term) -> tuple[str, ...]:
    return tuple(f"{effect.where}.{effect.effect}." for effect in term.finding.effects)


def _mean_square(calibration: Calibration, wider: Calibration) -> float:
    """mm^2: squared distance between the predictions of two models at the recorded poses, and what their uncertainties
    differ by: one variance of the noise for each further parameter, over all coordinates."""
    residuals = [made.model.residual(made.solution.parameters)[:3] for made in (calibration, wider)]
    distance = float(((residuals[1] - residuals[0]) ** 2).sum(0).mean())
    further = len(_free(wider)) - len(_free(calibration))
    sigma = calibration.model.chain.sigma[:3]
    return distance + max(further, 0) * float((sigma**2).mean()) / sigma.shape[1]


def _free(calibration: Calibration) -> list[str]:
    parameters = calibration.solution.parameters
    return [key for key, free in zip(parameters.keys, parameters.mask) if free]


__all__ = ["considered_terms", "probability"]
