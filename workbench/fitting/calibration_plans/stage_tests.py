"""Whether a stage of a plan is retained: it predicts held-out samples better, and fits more than chance.

Held-out gains of ten folds depend on one another, since any two fits share most of their samples, and their test asks
for a sign and not for a size. A term that shrinks to nothing changes predictions by a millionth of the noise, all in
one direction, and a term that follows the noise gains in most folds once in a while. Neither fits the samples better
than a random column would: the partial F-test says so.
"""

import numpy as np

from workbench.core.distributions import fisher

LEVEL = 0.05
"""Chance that a plan retains any stage that explains nothing."""


def is_retained(before, after, tests: int, fitted: np.ndarray) -> bool:
    """Whether a stage stays.

    before, after: steps with `model`, `fit` and `held_out`, without and with the stage; fitted (n,) True for the
    samples of the fit; tests: stages that are judged in the plan, among which `LEVEL` is shared (Bonferroni).
    """
    if not after.held_out.beats(before.held_out):
        return False
    sigma = after.model.at(fitted).sigma(after.fit.parameters)
    residuals = before.fit.residual, after.fit.residual
    degrees = before.fit.degrees, after.fit.degrees
    return partial_f_p_value(residuals, sigma, degrees) <= LEVEL / max(tests, 1)


def partial_f_p_value(residuals, sigma: np.ndarray, degrees: tuple[float, float]) -> float:
    """p-value that the smaller residual of a larger model is chance.

    residuals: two arrays (m, n), before and after; sigma: their 1 sigma, broadcast; degrees: of freedom left by each.
    A larger model spends at least one degree of freedom: terms that their prior shrinks to nothing spend a small part
    of one, and so small a gain is no evidence. Source: Seber & Lee, Linear Regression Analysis (2003), sec. 4.3.
    """
    degrees_used = max(degrees[0] - degrees[1], 1.0)
    remaining_degrees = max(degrees[1], 1.0)
    before, after = (float(((residual / sigma) ** 2).sum()) for residual in residuals)
    ratio = max(before - after, 0.0) / degrees_used / max(after / remaining_degrees, 1e-300)
    return float(fisher.sf(ratio, degrees_used, remaining_degrees))
