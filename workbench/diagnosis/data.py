"""What is wrong with the data rather than the model: outliers, and noise that is not the same everywhere."""

import numpy as np

from workbench.diagnosis.outliers import NAMED_AT, alone, apart, evened, spread_along, spread_with
from workbench.diagnosis.problem import Finding, Problem

CLAIMED = 1e-3
"""Chance that something is said about the data of a recording with nothing wrong."""
_SURE, _GAP = 1e-9, 0.05  # beyond any tail; and chance of a gap that parts outliers from heavy tails


def of_data(problem: Problem) -> tuple[np.ndarray, tuple[Finding, ...]]:
    """(n,) bool of the outliers, and findings on the data: a spread that is not the same everywhere, and outliers."""
    spread = _spread(problem)
    p = _outlying(problem, spread[0].depends_on[0] if spread else "") * problem.n
    found, least = p < NAMED_AT, float(max(p.min(initial=1.0), 1e-300))
    p = p / problem.n
    if least > CLAIMED or (least > _SURE and apart(p) > _GAP):
        return found, spread
    label = f"{found.sum()} of {problem.n}"
    return found, (*spread, Finding("outliers", "samples", label, (), least, 1.0 - least, 0.0, 0.0))


def unevenly(problem: Problem) -> np.ndarray | None:
    """(n,) how far the noise of each sample is spread, 1 on average; None where it is the same everywhere.

    Noise that grows with something makes functions of it out of nothing: all is to be judged with it evened.
    """
    found = _spread(problem)
    if not found:
        return None
    return spread_along(_white(problem), problem.covariates[found[0].depends_on[0]])


def evened_out(problem: Problem, spread: np.ndarray) -> Problem:
    """The problem whitened by the spread (n,) of each sample's noise."""
    factor = (1 / spread)[problem.sample]
    return problem.through(lambda rows: rows * factor, problem.weights / spread**2)


def _white(problem: Problem) -> np.ndarray:
    """(m, n) residuals of all that is kept, without the robust weights."""
    root = np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    return (problem.clear(problem.residual) / root).reshape(-1, problem.n)


def _outlying(problem: Problem, name: str) -> np.ndarray:
    """(n,) p-value of each sample by itself: that no part of the model brings it near by chance.

    Those with equally many coordinates are judged together; `name`: of the covariate that the spread goes with.
    """
    white = problem.clear(problem.residual) / np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    order = np.argsort(problem.sample, kind="stable")
    count, p = np.bincount(problem.sample, minlength=problem.n), np.ones(problem.n)
    for m in np.unique(count[count > 0]):  # a corner has two coordinates, a stripe one
        mine = order[count[problem.sample[order]] == m].reshape(-1, m)
        at, left = problem.sample[mine[:, 0]], white[mine].T
        p[at] = alone(evened(left, problem.covariates[name][at]) if name else left)
    return p


def _spread(problem: Problem) -> tuple[Finding, ...]:
    """Noise that is not the same everywhere, where that is beyond chance; samples of several kinds are not compared."""
    if len(problem.residual) % problem.n:
        return ()
    found = spread_with(_white(problem), problem.covariates)
    if found is None or found[1] > CLAIMED:
        return ()
    name, p = found
    return (Finding("noise-heteroscedastic", "noise", f"with {name}", (), p, 1.0 - p, 0.0, 0.0, (name,)),)


__all__ = ["CLAIMED", "evened_out", "of_data", "unevenly"]
