"""Noise along one known direction of each row: the likelihood of a variance component next to a linearised fit.

An error of one column displaces every measured point along one known line. The
model of a direction d_i for each row i is a variance component, Cov(r_i) = s^2 I + t^2 d_i d_i^T, next to base, tool
and geometry with its prior. Standard deviations s and t maximise the restricted likelihood (Patterson & Thompson,
Biometrika 58, 1971), in which the parameters of the fit are integrated out.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from workbench.fitting.plausibility.linearised_fit import LinearisedFit

_STEPS = np.array([0.5, 0.25, 0.1, 0.04, 0.015])
_START_SHARES, _START_RATIOS = (0.7, 0.3), (0.5, 1.5)
_FLOOR = 1e-6
_WIDE = 1e-6  # precision of a coefficient in units of the norm of its column


@dataclass(frozen=True)
class DirectedNoise:
    """Variance components of one direction, in the units of the linearised fit.

    `isotropic`: standard deviation s of a component. `deviation`: t, of the error along the direction.
    `log_likelihood`: restricted, up to a constant. `errors` (n,): predicted error of each row along the direction.
    """

    isotropic: float
    deviation: float
    log_likelihood: float
    errors: np.ndarray


class VarianceModel:
    """Restricted likelihood of the residual of a linearised fit under a variance component along given directions."""

    def __init__(self, linear: LinearisedFit):
        self.columns = (linear.unit[:, None] * linear.baseline).reshape(
            len(linear.unit), *linear.readings.shape[1:]
        )
        self.residual = linear.residual.reshape(linear.readings.shape[1:])
        flat = self.columns.reshape(len(self.columns), -1)
        self.prior = linear.matrix - flat @ flat.T
        self.pull = linear.gradient - flat @ linear.residual

    def with_columns(self, columns: np.ndarray) -> "VarianceModel":
        """The model with further parameters, given by columns (K, m, n); a wide prior keeps them finite."""
        extended = copy(self)
        extended.__dict__.pop("undirected", None)
        size = np.sqrt(np.maximum((columns**2).sum((1, 2)), _FLOOR**2))
        extended.columns = np.concatenate([self.columns, columns / size[:, None, None]])
        count = len(columns)
        extended.prior = np.zeros((len(extended.columns), len(extended.columns)))
        extended.prior[:-count, :-count] = self.prior
        extended.prior[range(-count, 0), range(-count, 0)] = _WIDE
        extended.pull = np.concatenate([self.pull, np.zeros(count)])
        return extended

    @cached_property
    def undirected(self) -> DirectedNoise:
        """The fit with isotropic noise alone."""
        directions = np.zeros_like(self.residual)
        start = np.array([self._start, -np.inf])
        moves = np.array([[1.0, 0.0]])
        return self._best(directions, [start], moves)

    def fit(self, directions: np.ndarray) -> DirectedNoise:
        """Maximum of the restricted likelihood for directions (m, n): the derivative of each row by its error."""
        moves = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
        return self._best(directions, self._starts(directions), moves)

    def quick_gain(self, directions: np.ndarray) -> float:
        """Gain of log likelihood over isotropic noise that a variance component brings at the best of a few points."""
        best = max(self._value(directions, start)[0] for start in self._starts(directions))
        return best - self.undirected.log_likelihood

    def _starts(self, directions) -> list[np.ndarray]:
        size = np.sqrt(max(float((directions**2).sum(0).mean()), _FLOOR**2))
        return [
            self._start + np.log([share, ratio / size])
            for share, ratio in product(_START_SHARES, _START_RATIOS)
        ]

    @property
    def _start(self) -> float:
        return float(np.log(max(np.sqrt((self.residual**2).mean()), _FLOOR)))

    def _best(self, directions, starts: Sequence[np.ndarray], moves) -> DirectedNoise:
        """Pattern search from the best of several starts; logarithms of s and t."""
        value, point = max(
            ((self._value(directions, start)[0], start) for start in starts),
            key=lambda pair: pair[0],
        )
        for step in _STEPS:
            improved = True
            while improved:
                improved = False
                for move in (*moves, *-moves):
                    tried = point + step * move
                    new_value = self._value(directions, tried)[0]
                    if new_value > value + 1e-6 and tried[0] > np.log(_FLOOR):
                        value, point, improved = new_value, tried, True
        value, errors = self._value(directions, point)
        isotropic, deviation = np.exp(point)
        return DirectedNoise(float(isotropic), float(deviation), value, errors)

    def _value(self, directions, logarithms) -> tuple[float, np.ndarray]:
        """Restricted log likelihood at (log s, log t), and the predicted errors (n,) along the directions."""
        variance, variance_along = np.exp(2 * logarithms)
        squares = (directions**2).sum(0)
        shrinkage = variance_along / (variance + variance_along * squares)
        whitened = self._weighted(self.columns, directions, shrinkage) / variance
        flat = self.columns.reshape(len(self.columns), -1)
        rows = whitened.reshape(len(flat), -1)
        matrix = self.prior + rows @ flat.T
        gradient = self.pull + rows @ self.residual.ravel()
        factor = np.linalg.cholesky(matrix + 1e-12 * np.trace(matrix) * np.eye(len(matrix)))
        solved = np.linalg.solve(factor, gradient)
        moved = np.linalg.solve(factor.T, solved)
        left = self.residual - np.tensordot(moved, self.columns, 1)
        weighted = self._weighted(self.residual, directions, shrinkage) / variance
        m = len(self.residual)
        log_det = m * len(squares) * np.log(variance)
        log_det += np.log1p(variance_along * squares / variance).sum()
        log_det += 2 * np.log(np.diag(factor)).sum()
        value = -0.5 * (log_det + float((self.residual * weighted).sum()) - float(solved @ solved))
        return value, shrinkage * (directions * left).sum(0)

    @staticmethod
    def _weighted(values, directions, shrinkage):
        """Values (..., m, n) multiplied by s^2 times the inverse covariance of each row."""
        projection = (values * directions).sum(-2)
        return values - directions * (shrinkage * projection)[..., None, :]
