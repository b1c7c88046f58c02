"""Wider priors for effects that are far larger than usual.

The prior of an effect states its usual size. Under a prior that is much too narrow a large effect is shrunk towards
zero, the remainder counts as noise, and more noise gives the prior more weight: the fit stays at a wrong solution.
Such a prior-data conflict (Evans & Moshonov, Bayesian Analysis 1 (2006) 893) is decided by the evidence with the noise
estimated (MacKay, Neural Computation 4 (1992) 415, sections 4 and 5).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.distributions import chi2
from workbench.core.least_squares.linear_algebra import covariance_of, solve_positive
from workbench.core.least_squares.solver import Fit
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters

_WIDEST = 100.0
"""Typical sizes that a prior is widened to at most: nothing that is named an effect is larger."""
_STEPS = np.sqrt(10.0) ** np.arange(1, 5)
"""Factors by which a prior is widened on trial; half a decade of width changes the evidence little."""
_WORTHWHILE = float(np.log(1e3))
"""Gain of log evidence from which a prior is widened."""
_SHARE = 0.05
"""Share of the prior in what is known of a parameter, below which its width does not matter."""
_SUSPICIOUS = 0.05
"""Chance below which the evidence of an effect's prior is computed at all."""
_EXACT = 1e-6
"""Residuals in units of sigma below which no effect can have been shrunk."""
_ROUNDS = 6  # of the noise and the parameters in turn, which converge within four
_FLOOR = 1e-9  # precision, in typical sizes, of a parameter without a prior


def widened(model: Model, fit: Fit) -> Parameters:
    """The fit's parameters, with wider priors for linear effects in prior-data conflict; values stay.

    Linearised where the fit ended. The same object comes back where there is no conflict.
    """
    parameters = fit.parameters
    if fit.sigma_scale < _EXACT:
        return parameters
    size = parameters.typical[parameters.mask]
    precision = parameters.precision[parameters.mask] * size**2
    problem = _Linearised.of(fit, size, precision)
    effects = _in_conflict(model, parameters, problem, precision)
    if not effects:
        return parameters
    groups = list(effects)
    if len(effects) > 1:  # where none by itself explains enough, all of them together may
        groups.append(np.concatenate(effects))
    wider = precision
    for rows in groups:
        wider = _widest_worthwhile(problem, wider, rows)
    if wider is precision:
        return parameters
    table = list(parameters.table)
    for k, own, new, unit in zip(np.flatnonzero(parameters.mask), precision, wider, size):
        if new != own:
            table[k] = replace(table[k], prior=float(unit / np.sqrt(new)))
    return Parameters(tuple(table), parameters.values, parameters.mask)


def _in_conflict(model, parameters, problem, precision) -> Sequence[np.ndarray]:
    """Rows, among the free parameters, of each linear effect that may be in conflict with its prior.

    A screening test: the prior has a share in the posterior, and the estimates under weak priors of all effects are
    improbable under the prior predictive distribution.
    """
    every = _rows_of_effects(model, parameters)
    if not every:
        return every
    share = precision * np.diag(problem.covariance(precision, problem.noise))
    every = [rows for rows in every if (share[rows] > _SHARE).any()]
    if not every:
        return every
    weak = _weakened(precision, np.concatenate(every))
    noise = problem.next_noise(weak, problem.noise)[0]
    _, _, values, covariance = problem.next_noise(weak, noise)
    prior = 1 / np.maximum(precision, 1e-300)
    return [rows for rows in every if _is_conflict(values, covariance, prior, rows)]


def _rows_of_effects(model, parameters) -> Sequence[np.ndarray]:
    place = np.cumsum(parameters.mask) - 1
    linear = (
        place[np.flatnonzero(parameters.mask[span]) + span.start]
        for effect, span in zip(model.effects, model.spans)
        if effect.linear and effect.port != NOISE
    )
    return [rows for rows in linear if len(rows)]


def _weakened(precision, rows) -> np.ndarray:
    """Precisions with those of `rows` at the widest prior that is allowed."""
    weak = precision.copy()
    weak[rows] = np.minimum(weak[rows], _WIDEST**-2)
    return weak


def _is_conflict(values, covariance, prior, rows) -> bool:
    """Whether the estimates are improbable under the prior predictive distribution; prior (F,): variances."""
    expected = covariance[np.ix_(rows, rows)] + np.diag(prior[rows])
    square = values[rows] @ solve_positive(expected, values[rows])
    return bool(chi2.sf(square, len(rows)) < _SUSPICIOUS)


def _widest_worthwhile(problem, precision, rows) -> np.ndarray:
    """Precisions with those of `rows` lowered where that raises the evidence by enough; else the same object."""
    best, chosen = problem.evidence(precision, rows) + _WORTHWHILE, precision
    for factor in _STEPS:
        trial = precision.copy()
        trial[rows] = np.maximum(trial[rows] / factor**2, np.minimum(trial[rows], _WIDEST**-2))
        value = problem.evidence(trial, rows)
        if value > best:
            best, chosen = value, trial
    return chosen


@dataclass(frozen=True)
class _Linearised:
    """A fit, linear about where it ended; F free parameters in typical sizes, about their null values.

    `normal` (F, F) and `gradient` (F,): of half the whitened sum of squares `squares` of `count` residuals; `away`
    (F,): present values; `noise`: present variance of the whitened residuals.
    """

    normal: np.ndarray
    gradient: np.ndarray
    squares: float
    count: int
    away: np.ndarray
    noise: float

    @classmethod
    def of(cls, fit: Fit, size: np.ndarray, precision: np.ndarray) -> "_Linearised":
        parameters = fit.parameters
        away = (parameters.pack() - parameters.nulls[parameters.mask]) / size
        squares = fit.sigma_scale**2 * fit.degrees
        trust = max(1.0, squares / fit.residual.size)  # of the priors in the solver
        return cls(
            fit.normal * np.outer(size, size),
            -trust * precision * away,  # where a solve ends, the gradient of the whole cost is zero
            squares,
            fit.residual.size,
            away,
            squares / fit.degrees,
        )

    def covariance(self, precision: np.ndarray, noise: float) -> np.ndarray:
        """(F, F) under priors and a variance of the residuals."""
        return covariance_of(self.normal / noise, precision + _FLOOR)

    def evidence(self, precision: np.ndarray, rows: np.ndarray) -> float:
        """Log evidence of the priors of `rows`, largest over the variance of the noise; others' terms are left out."""
        weak = _weakened(precision, rows)
        starts = (self.noise, self.next_noise(weak, self.noise)[0])
        return max(self._evidence_from(noise, precision, rows) for noise in starts)

    def _evidence_from(self, noise, precision, rows) -> float:
        for _ in range(_ROUNDS):
            noise, squares, values, covariance = self.next_noise(precision, noise)
        sign, log_volume = np.linalg.slogdet(covariance)
        if sign <= 0:
            return -np.inf
        misfit = squares / noise + values @ (precision * values)
        volume = np.log(precision[rows]).sum() + log_volume
        return float(0.5 * (volume - misfit - self.count * np.log(noise)))

    def next_noise(self, precision, noise):
        """Variance of the residuals after a solution with `noise`; their squares, the values and the covariance."""
        covariance = self.covariance(precision, noise)
        values = covariance @ ((self.normal @ self.away - self.gradient) / noise)
        step = values - self.away
        squares = self.squares + 2 * self.gradient @ step + step @ self.normal @ step
        squares = max(float(squares), 1e-12 * self.squares)
        spent = float((covariance * self.normal).sum() / noise)
        return squares / max(self.count - spent, 1.0), squares, values, covariance
