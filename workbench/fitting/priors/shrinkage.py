"""Scale of the prior of effects of one kind, estimated from the data (empirical Bayes).

The joints of one arm have gears of one make and bearings of one size. What the torsion of those that
the data determine well has come out to be says how large that of the others may be: far less
than what a data sheet leaves open, and a hundred poses then need not pay for forty numbers one by one.
Empirical Bayes by the fixed point of the evidence: MacKay, Neural Computation 4 (1992) 415, eq. 3.9.
"""

from dataclasses import replace

import numpy as np

from workbench.core.least_squares.linear_algebra import posterior_of
from workbench.core.least_squares.solver import Fit, normal_matrix, solve
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters
from workbench.fitting.priors.linear_posterior import without_free

_ROUNDS = 100
_SAME = 0.02
"""Change of a family's log precision, times its effective parameters up to 1, that ends the rounds.

The scale of a family that the data shrink to nothing still changes when its predictions no longer do.
"""
_MIN_SCALE, _MAX_SCALE = (
    1e-3,
    30.0,
)  # typical sizes: a prior of a family is never tighter, or looser where it has none


def settled(
    model: Model,
    fit: Fit,
    loss: str,
    steps: int,
    only: np.ndarray | None = None,
    with_shares: bool = True,
) -> Fit:
    """The fit once more, with the priors of each family of effects as wide as its parameters turned out large.

    only (P,) bool: parameters whose priors may change; None for all. with_shares: as of `solve`.
    """
    normal = None if fit.gradient is None else fit.normal
    scaled = rescaled(model, fit.parameters, only, normal)
    if scaled is fit.parameters:
        return fit
    return solve(model, scaled, loss, steps, fit, with_shares)


def rescaled(
    model: Model,
    parameters: Parameters,
    only: np.ndarray | None = None,
    normal: np.ndarray | None = None,
) -> Parameters:
    """The same parameters with the common prior of every family of linear effects that maximises the evidence.

    A family is all free parameters of one effect, in one unit, at all its places, or as `Effect.shrinkage_groups`
    divides them. Their prior (1 sigma, in
    typical sizes, about null) becomes s with s^2 = sum x^2 / sum (1 - C_kk / s^2), C the covariance under it:
    the size of what is determined. Linearised at `parameters`. Never wider than the effect's own prior, or the one
    that `parameters` have. normal (F, F): whitened normal matrix of the data where it is known already.
    """
    family = _families(model, parameters)
    if only is not None:
        family = _renumbered(np.where(only[parameters.mask], family, -1))
    if family.max(initial=-1) < 0:
        return parameters
    size = parameters.typical[parameters.mask]
    normal = normal_matrix(model, parameters) if normal is None else normal
    normal = normal * np.outer(size, size)
    from_null = (parameters.pack() - parameters.nulls[parameters.mask]) / size
    present, widest = (
        table.precision[parameters.mask] * size**2 for table in (parameters, model.parameters)
    )
    precision_of_row = np.where(widest > 0, widest, _MAX_SCALE**-2)
    min_precision = np.minimum(precision_of_row, np.where(present > 0, present, precision_of_row))
    has_prior = (present > 0) | (family >= 0)  # the others have no prior, whatever the scales
    reduced, _ = without_free(normal, has_prior)
    precision = present.copy()
    precision[has_prior] = _scaled(
        reduced,
        from_null[has_prior],
        present[has_prior],
        min_precision[has_prior],
        family[has_prior],
    )
    prior = size / np.sqrt(np.maximum(precision, 1e-300))
    return _with_priors(parameters, family, prior)


def _families(model, parameters) -> np.ndarray:
    """(F,) number of the family of each free parameter, -1 for those of the chain, of noise and of laws not linear."""
    family = np.full(len(parameters), -1)
    names = {}
    for effect, span in zip(model.effects, model.spans):
        if effect.linear and effect.port != NOISE:
            groups = effect.shrinkage_groups() or [""] * (span.stop - span.start)
            table = parameters.table[span]
            kinds = [(effect.effect, group, p.unit) for group, p in zip(groups, table)]
            family[span] = [names.setdefault(kind, len(names)) for kind in kinds]
    return family[parameters.mask]


def _renumbered(family: np.ndarray) -> np.ndarray:
    """(F,) the same families with consecutive numbers from 0; -1 stays."""
    numbers = np.unique(family[family >= 0])
    return np.where(family < 0, -1, np.searchsorted(numbers, family))


def _scaled(normal, from_null, precision, min_precision, family):
    """(F,) precisions in which those of each family agree and the evidence is largest; the others' stay.

    precision: under which `deviation` solves the normal equations; least (F,): those of the effects' own priors.
    """
    right = normal @ from_null + precision * from_null
    precision = precision.copy()
    members = [family == k for k in range(family.max() + 1) if (family == k).any()]
    for _ in range(_ROUNDS):
        from_null, variances = posterior_of(normal, precision + 1e-9, right)
        before = precision.copy()
        degrees_used = 1 - precision * variances  # share of each number that the data determine
        for rows in members:
            square = max(
                (from_null[rows] ** 2).sum() / max(degrees_used[rows].sum(), 1e-3), _MIN_SCALE**2
            )
            precision[rows] = np.maximum(1 / square, min_precision[rows])
        changes = np.abs(np.log(np.maximum(precision, 1e-12) / np.maximum(before, 1e-12)))
        if all(_is_same(changes[rows], degrees_used[rows]) for rows in members):
            break
    return precision


def _is_same(changes: np.ndarray, degrees_used: np.ndarray) -> bool:
    """Whether changes (K,) of a family's log precision no longer matter; spent (K,): its effective parameters."""
    return bool(changes.max() * min(degrees_used.sum(), 1.0) <= _SAME)


def _with_priors(parameters, family, prior):
    table = list(parameters.table)
    for k, group, width in zip(np.flatnonzero(parameters.mask), family, prior):
        if group >= 0:
            table[k] = replace(table[k], prior=float(width))
    return Parameters(tuple(table), parameters.values, parameters.mask)
