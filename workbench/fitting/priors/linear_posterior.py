"""Posterior of a linear fit under Gaussian priors, as a function of the priors and of the variance of the noise.

Parameters without a prior are eliminated once (Schur complement). For each set of priors one eigen-decomposition of
the normal matrix relative to the precisions (Golub & Van Loan, Matrix Computations, 4th ed. (2013), section 8.7) gives
the solution, its covariance and its evidence for every variance of the noise (MacKay, Neural Computation 4 (1992) 415,
sections 4 and 5).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.linear_algebra import pseudo_inverse, symmetric_eigen
from workbench.core.least_squares.solver import Fit

_NOISE_RANGE = (1e-6, 1e4)  # of the present variance, in which the most probable one is looked for
_NOISE_STEPS = 200
_ROUNDS = 6  # of the noise and the parameters in turn, which converge within four


@dataclass(frozen=True)
class LinearFit:
    """A fit, linear about where it ended, of its K free parameters that have a prior, in units of their typical size.

    `rows` (K,): their numbers among all parameters; `precision` (K,): of their priors; `deviation` (K,): present values
    less their null values. `normal` (K, K) and `gradient` (K,): second and first derivative of half the whitened sum of
    squares, with the other free parameters eliminated, of which the data determine `eliminated`. `squares`: present
    sum of `count` squared residuals; `noise`: their present variance.
    """

    rows: np.ndarray
    precision: np.ndarray
    deviation: np.ndarray
    normal: np.ndarray
    gradient: np.ndarray
    eliminated: int
    squares: float
    count: int
    noise: float

    @classmethod
    def of(cls, fit: Fit) -> "LinearFit":
        """The fit with its priors. Raises InputError where the normal matrix is not finite."""
        parameters = fit.parameters
        size = parameters.typical[parameters.mask]
        precision = parameters.precision[parameters.mask] * size**2
        from_null = (parameters.pack() - parameters.nulls[parameters.mask]) / size
        has_prior = precision > 0
        normal, eliminated = without_free(fit.normal * np.outer(size, size), has_prior)
        squares = fit.sigma_scale**2 * fit.degrees
        trust = max(1.0, squares / fit.residual.size)  # of the priors in the solver
        return cls(
            np.flatnonzero(parameters.mask)[has_prior],
            precision[has_prior],
            from_null[has_prior],
            normal,
            # where a solve ends, the gradient of the whole cost is zero
            -trust * (precision * from_null)[has_prior],
            eliminated,
            squares,
            fit.residual.size,
            squares / fit.degrees,
        )


def without_free(normal: np.ndarray, retained: np.ndarray) -> tuple[np.ndarray, int]:
    """(K, K) normal matrix (F, F) of the parameters `kept` (F,) bool after elimination of the others, and their rank.

    The Schur complement: what remains where parameters without a prior have been solved for.
    """
    others = normal[np.ix_(~retained, ~retained)]
    coupling = normal[np.ix_(~retained, retained)]
    inverse = pseudo_inverse(others) if len(others) else others
    rank = int(np.rint((inverse * others).sum()))
    reduced = normal[np.ix_(retained, retained)] - coupling.T @ inverse @ coupling
    return (reduced + reduced.T) / 2, rank


class Posterior:
    """Of a linear fit's K parameters, under priors of some precision (K,), for any variance of the residuals."""

    def __init__(self, linear: LinearFit, precision: np.ndarray):
        scale = 1 / np.sqrt(precision)
        matrix = linear.normal * np.outer(scale, scale)
        values, vectors = symmetric_eigen(matrix)
        self._linear = linear
        self._information = np.maximum(values, 0.0)
        self._basis = vectors * scale[:, None]  # in it the prior is the identity
        self._gradient = self._basis.T @ linear.gradient
        self._away = vectors.T @ (linear.deviation / scale)

    def covariance(self, noise: float) -> np.ndarray:
        """(K, K) of the parameters."""
        return (self._basis * self._shrinkage(noise)) @ self._basis.T

    def variances(self, noise: float) -> np.ndarray:
        """(K,) diagonal of the covariance."""
        return self._basis**2 @ self._shrinkage(noise)

    def values(self, noise: float) -> np.ndarray:
        """(K,) solution."""
        return self._linear.deviation + self._basis @ self._step(noise)

    def next_noise(self, noise: float) -> float:
        """Variance of the residuals about the solution that the variance `noise` leads to."""
        degrees_used = self._linear.eliminated + (1 - self._shrinkage(noise)).sum()
        squares = self._squares(self._step(noise))
        return squares / max(self._linear.count - degrees_used, 1.0)

    def evidence(self, starts: Sequence[float]) -> float:
        """Log evidence, up to a constant, at the best variance of the residuals that is reached from some starts."""
        return max(self._evidence_from(noise) for noise in starts)

    def _evidence_from(self, noise: float) -> float:
        for _ in range(_ROUNDS):
            before = noise
            noise = self.next_noise(noise)
        return self._log_evidence(before, noise)

    def most_probable_noise(self) -> float:
        """Variance of the residuals under which the data are most probable."""
        grid = np.geomspace(*_NOISE_RANGE, _NOISE_STEPS)
        return float(max(grid, key=lambda noise: self._log_evidence(noise, noise)))

    def _log_evidence(self, before: float, noise: float) -> float:
        """Log evidence at a variance of the residuals; before: the variance that the solution is of."""
        step = self._step(before)
        misfit = self._squares(step) / noise + ((self._away + step) ** 2).sum()
        volume = np.log(self._shrinkage(before)).sum() + self._linear.eliminated * np.log(before)
        return float(0.5 * (volume - misfit - self._linear.count * np.log(noise)))

    def _shrinkage(self, noise: float) -> np.ndarray:
        """(K,) share of the prior in each direction."""
        return 1 / (1 + self._information / noise)

    def _step(self, noise: float) -> np.ndarray:
        """(K,) from the present values to the solution, in the basis."""
        return -self._shrinkage(noise) * (self._gradient / noise + self._away)

    def _squares(self, step: np.ndarray) -> float:
        """Sum of squared residuals after a step (K,)."""
        linear = self._linear
        squares = linear.squares + 2 * self._gradient @ step + step @ (self._information * step)
        return max(float(squares), 1e-12 * linear.squares)


__all__ = ["LinearFit", "Posterior", "without_free"]
