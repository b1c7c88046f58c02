"""Wider priors for effects that are far larger than usual.

The prior of an effect states its usual size. Under a prior that is much too narrow a large effect is shrunk towards
zero, the remainder counts as noise, and more noise gives the prior more weight: the fit stays at a wrong solution.
Such a prior-data conflict (Evans & Moshonov, Bayesian Analysis 1 (2006) 893) is decided by the evidence with the noise
estimated (MacKay, Neural Computation 4 (1992) 415, sections 4 and 5).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.core.distributions import chi2
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.least_squares.solver import Fit
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters
from workbench.fitting.priors.linear_posterior import LinearFit, Posterior, without_free

_WIDEST = 100.0
"""Typical sizes that a prior is widened to at most: nothing that is named an effect is larger."""
_STEPS = np.sqrt(10.0) ** np.arange(1, 5)
"""Factors by which a prior is widened on trial; half a decade of width changes the evidence little."""
_WORTHWHILE = float(np.log(1e3))
"""Gain of log evidence from which a prior is widened."""
_SHARE = 0.05
"""Share of the prior in what is known of a parameter, below which it has no part in the standard deviation."""
_BIAS = 0.1
"""Standard deviations by which a prior may shrink a parameter without being tested: of an effect many times larger
than usual a prior with a small share takes several."""
_CANCELLING = 100.0
"""Ratio of the sum of squared changes of predictions, parameter by parameter, to the square of their sum, from which
they cancel. Parameters that the samples distinguish have a ratio near 1, a few that are correlated up to 20; terms that
only their differences make visible have thousands."""
_SUSPICIOUS = 0.05
"""Chance below which the evidence of an effect's prior is computed at all."""
_EXACT = 1e-6
"""Residuals in units of sigma below which no effect can have been shrunk."""


def widened(model: Model, fit: Fit) -> Parameters:
    """The fit's parameters, with wider priors for linear effects in prior-data conflict; values stay.

    Linearised where the fit ended. The same object comes back where there is no conflict.
    """
    parameters = fit.parameters
    if fit.sigma_scale < _EXACT:
        return parameters
    linear = LinearFit.of(fit)
    posteriors = _Posteriors(linear)
    effects = _in_conflict(model, parameters, posteriors)
    if not effects:
        return parameters
    groups = list(effects)
    if len(effects) > 1:  # where none by itself explains enough, all of them together may
        groups.append(np.concatenate(effects))
    wider = linear.precision
    all_rows = np.concatenate(_rows_of_effects(model, linear))
    for rows in groups:
        wider = _widest_worthwhile(posteriors, wider, rows, np.sort(all_rows))
    if wider is linear.precision:
        return parameters
    table = list(parameters.table)
    for k, precision, new in zip(linear.rows, linear.precision, wider):
        if new != precision:
            prior = float(table[k].typical / np.sqrt(new))
            table[k] = replace(table[k], prior=prior)
    return Parameters(tuple(table), parameters.values, parameters.mask)


class _Posteriors:
    """Posteriors of a linear fit by the precisions (K,) of its priors, each of which several tests need."""

    def __init__(self, linear: LinearFit):
        self.linear, self._known = linear, {}

    def posterior_with(self, precision: np.ndarray) -> Posterior:
        key = precision.tobytes()
        if key not in self._known:
            self._known[key] = Posterior(self.linear, precision)
        return self._known[key]


def _in_conflict(
    model: Model, parameters: Parameters, posteriors: _Posteriors
) -> Sequence[np.ndarray]:
    """Rows, among the parameters with a prior, of each linear effect that may be in conflict with its prior.

    A screening test: the prior has a share in the posterior, and the estimates under weak priors of all effects are
    improbable under the prior predictive distribution.
    """
    linear = posteriors.linear
    rows_of_effects = _rows_of_effects(model, linear)
    variances = posteriors.posterior_with(linear.precision).variances(linear.noise)
    share = linear.precision * variances
    bias = linear.precision * np.abs(linear.deviation) * np.sqrt(variances)
    matters = (share > _SHARE) | (bias > _BIAS)
    rows_of_effects = [rows for rows in rows_of_effects if matters[rows].any()]
    if not rows_of_effects:
        return rows_of_effects
    precision = _weakened(linear.precision, np.concatenate(rows_of_effects))
    weak = posteriors.posterior_with(precision)
    noise = weak.next_noise(linear.noise)
    values = weak.values(noise)
    covariance = weak.covariance(noise)
    prior = 1 / linear.precision
    return [rows for rows in rows_of_effects if _is_conflict(values, covariance, prior, rows)]


def _rows_of_effects(model: Model, linear: LinearFit) -> Sequence[np.ndarray]:
    found = []
    for effect, span in zip(model.effects, model.spans):
        is_of_effect = (linear.rows >= span.start) & (linear.rows < span.stop)
        if effect.linear and effect.port != NOISE and is_of_effect.any():
            found.append(np.flatnonzero(is_of_effect))
    return found


def _weakened(precision: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Precisions with those of `rows` at the widest prior that is allowed."""
    weak = precision.copy()
    weak[rows] = np.minimum(weak[rows], _WIDEST**-2)
    return weak


def _is_conflict(values, covariance, prior, rows) -> bool:
    """Whether the estimates are improbable under the prior predictive distribution; prior (K,): variances."""
    expected = covariance[np.ix_(rows, rows)] + np.diag(prior[rows])
    square = values[rows] @ solve_positive(expected, values[rows])
    return bool(chi2.sf(square, len(rows)) < _SUSPICIOUS)


def _widest_worthwhile(posteriors: _Posteriors, precision, rows, effects) -> np.ndarray:
    """Precisions with those of `rows` lowered where that raises the evidence by enough; else the same object.

    effects (E,): numbers of the parameters of all linear effects.
    """
    linear = posteriors.linear
    weak = _weakened(precision, rows)
    starts = (linear.noise, posteriors.posterior_with(weak).next_noise(linear.noise))
    present = posteriors.posterior_with(precision)
    best = present.evidence(starts) + _WORTHWHILE
    chosen = precision
    for factor in _STEPS:
        trial = precision.copy()
        trial[rows] = np.maximum(trial[rows] / factor**2, weak[rows])
        posterior = posteriors.posterior_with(trial)
        value = posterior.evidence(starts)
        if value > best and not _cancels(linear, effects, present, posterior):
            best, chosen = value, trial
    return chosen


def _cancels(linear: LinearFit, effects: np.ndarray, before: Posterior, after: Posterior) -> bool:
    """Whether effects change by much that hardly shows in the predictions, since they cancel at the samples.

    That is no large effect but a fine structure that the effects cannot follow except by differences of large terms,
    which run away where no sample holds them. effects (E,): numbers of their parameters; the other parameters, such as
    the geometry, are eliminated: an effect that takes its own share back from them is no such difference.
    """
    noise = after.next_noise(linear.noise)
    change = (after.values(noise) - before.values(noise))[effects]
    of_effects = np.zeros(len(linear.normal), bool)
    of_effects[effects] = True
    normal, _ = without_free(linear.normal, of_effects)
    joint = change @ normal @ change
    one_by_one = change**2 @ np.diag(normal)
    return bool(one_by_one > _CANCELLING * joint)
