"""Parameters that cannot be negative, such as a compliance: held at zero where the least-squares estimate is negative.

The active-set method of bounded least squares (Lawson & Hanson, Solving Least Squares Problems (1974), ch. 23) without
its release step: what is held stays held. A negative compliance that noise makes would bend a corrected model the
wrong way, and an exported simulation would be unstable.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters


def solve_nonnegative(
    model: Model,
    fit: Fit,
    loss: str,
    steps: int,
    tied: Mapping[str, Sequence[str]] | None = None,
) -> tuple[Fit, frozenset[str]]:
    """The fit with every negative value of `Effect.nonnegative` parameters held at zero, and the keys of these.

    One parameter at a time, the most negative in standard deviations first: the others may then become positive.
    tied: parameters that are left out of the fit, and those that stand for them. One that stands for others of its
    effect is their combination, which may be negative.
    """
    bounded = _bounded(model) & ~np.isin(model.parameters.keys, _combinations(tied or {}))
    bounded_to_zero: list[str] = []
    while (worst := _most_negative(fit, bounded)) is not None:
        bounded_to_zero.append(fit.parameters.keys[worst])
        fit = solve(model, _at_zero(fit.parameters, worst), loss, steps)
    return fit, frozenset(bounded_to_zero)


def _combinations(tied: Mapping[str, Sequence[str]]) -> list[str]:
    """Parameters that stand for left-out parameters of the same effect at the same place."""
    return [
        partner
        for key, partners in tied.items()
        for partner in partners
        if partner.rpartition(".")[0] == key.rpartition(".")[0]
    ]


def _bounded(model: Model) -> np.ndarray:
    """(P,) bool: parameters of effects that cannot be negative."""
    bounded = np.zeros(len(model.parameters), bool)
    for effect, span in zip(model.effects, model.spans):
        bounded[span.start : span.start + effect.nonnegative] = True
    return bounded


def _most_negative(fit: Fit, bounded: np.ndarray) -> int | None:
    """Number of the free bounded parameter that is the most standard deviations below zero; None without one."""
    free = np.flatnonzero(fit.parameters.mask)
    values = fit.parameters.values[free]
    is_negative = bounded[free] & (values < 0)
    if not is_negative.any():
        return None
    precision = np.sqrt(np.maximum(np.diag(fit.normal), 0.0))
    return int(free[np.argmin(np.where(is_negative, values * precision, np.inf))])


def _at_zero(parameters: Parameters, number: int) -> Parameters:
    key = parameters.keys[number]
    return parameters.update({key: 0.0}).fix(key)
