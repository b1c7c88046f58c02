"""Variances of errors that groups of measurements share, by restricted maximum likelihood.

y = J x + Z u + e, e independent of known sigma, u of kinds that have a variance each. All that a
linear model says of them is the small matrix R = Z'P Z and g = Z'P y, P
the weight matrix W less what the unknowns x take, W - W J (J'W J)^-1 J'W.
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.linear_algebra import pseudo_inverse

_ROUNDS = 60
_CONVERGED = 1e-3  # of a variance, or of what it is known to
_FEWEST = 3.0  # shared errors that must remain orthogonal to the unknowns: fewer do not determine a variance
_GROWS = 10.0  # times what a variance is known to, that it may grow by in one step


@dataclass(frozen=True)
class VarianceComponents:
    """`variance` (K,) of each kind, and `std` (K,) of these, inf where the data tell nothing; `signed` (K,) the same
    where nothing forbids it to be negative."""

    variance: np.ndarray
    std: np.ndarray
    signed: np.ndarray

    @property
    def expected(self) -> np.ndarray:
        """(K,) the variance to count on: the mean of what a normal distribution leaves above nought.

        One that comes out as nought is known to its std only; to take it for nought states sigmas too small.
        """
        from scipy.stats import norm

        known = np.isfinite(self.std)
        std = np.where(known, self.std, 1.0)
        upper_density = np.exp(norm.logpdf(self.signed / std) - norm.logcdf(self.signed / std))
        return np.where(known, np.maximum(self.signed + std * upper_density, 0.0), self.variance)


def estimate_components(gram: np.ndarray, pull: np.ndarray, kind: np.ndarray) -> VarianceComponents:
    """Variances of E shared errors of kinds 0 to K - 1.

    own (E, E) is R and pull (E,) is g at zero variances, kind (E,) int. Fisher's scoring (Patterson & Thompson,
    Biometrika 58 (1971); Harville, J. Am. Stat. Assoc. 72 (1977)); a variance that would be
    negative is 0. With T the variances found, R and g become (1 + R T)^-1 R and (1 + R T)^-1 g.
    """
    count = int(kind.max(initial=-1)) + 1
    estimable = np.array(
        [_left(gram[np.ix_(kind == k, kind == k)]) >= _FEWEST for k in range(count)], bool
    )
    variance = np.zeros(count)
    std = np.full(count, np.inf)
    signed = np.zeros(count)
    for _ in range(_ROUNDS):
        before = variance
        solved, projected = _solution(gram, pull, variance[kind])
        known, score = _scoring(solved, projected, kind, count)
        signed = variance + score / np.maximum(np.diag(known), 1e-300)
        variance, std = _stepped(variance, known, score, estimable)
        if (np.abs(variance - before) <= _CONVERGED * np.where(np.isfinite(std), std, 0)).all():
            break
    return VarianceComponents(
        variance, std, np.where(variance > 0, variance, np.minimum(signed, 0.0))
    )


def _left(gram):
    """Effective number of errors of one kind after the unknowns are projected out: (tr R)^2 / tr R^2."""
    return float(np.trace(gram) ** 2 / max((gram**2).sum(), 1e-300)) if gram.size else 0.0


def _solution(gram, pull, variance):
    """R and g with the errors' variances (E,) in the weights."""
    mixed = np.linalg.solve(np.eye(len(gram)) + gram * variance, np.column_stack([gram, pull]))
    return mixed[:, :-1], mixed[:, -1]


def _scoring(solved, projected, kind, count):
    """Twice Fisher's information (K, K) of the variances, and twice the score (K,)."""
    square = solved**2
    known = np.array(
        [[square[np.ix_(kind == k, kind == m)].sum() for m in range(count)] for k in range(count)]
    )
    score = np.bincount(kind, projected**2 - np.diag(solved), count)
    return known.reshape(count, count), score


def _stepped(variance, known, score, estimable):
    """The next variances and what they are known to; those that would be negative are 0, one after the other."""
    free = estimable.copy()
    stepped = np.zeros_like(variance)
    std = np.full(len(variance), np.inf)
    step_target = known @ variance + score
    while free.any():
        inverse = pseudo_inverse(known[np.ix_(free, free)])
        stepped[:], std[:] = 0, np.inf
        stepped[free] = inverse @ step_target[free]
        std[free] = np.sqrt(2 * np.maximum(np.diag(inverse), 1e-300))
        if (stepped >= 0).all():
            break
        free[np.argmin(stepped / std)] = False
        stepped[:] = np.where(free, stepped, 0)
    single = np.sqrt(2 / np.maximum(np.diag(known), 1e-300))
    std = np.where(estimable & ~np.isfinite(std), single, std)
    return np.minimum(stepped, variance + _GROWS * np.where(np.isfinite(std), std, 0)), np.where(
        estimable, std, np.inf
    )
