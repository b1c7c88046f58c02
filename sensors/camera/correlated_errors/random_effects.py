"""Variance components of errors that many corners share, by restricted maximum likelihood.

Residuals r of a linear model with design J satisfy r = M (Z b + e), where M projects J out, e is white noise and the
random effects b of component j are independent with variance s_j. Z'Mr and r'r are sufficient for the variances.
Patterson & Thompson, Biometrika 58 (1971); Searle, Casella & McCulloch, Variance Components (1992), ch. 6.
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import chi2
from workbench.core.least_squares.linear_algebra import symmetric_eigen

_RANK = 1e-6  # relative eigenvalue of Z'MZ below which a combination of effects leaves no trace in the residuals
_LOWEST = 1e-8  # of the starting variance: a component at this bound is zero
_HIGHEST = 1e4
_NOISE = 100.0  # factor by which the noise may differ from what no effect explains
_STEPS = 100
_ROUNDING = 1e-12  # of the mean variance: keeps the covariance positive definite


@dataclass(frozen=True)
class Reduced:
    """Data of the variances: `gram` (q, q) = Z'MZ, `pull` (q,) = Z'Mr, `squares` r'r and its `degrees` of freedom.

    `component` (q,) index of the component of each effect, 0 to `count` - 1.
    """

    gram: np.ndarray
    pull: np.ndarray
    squares: float
    degrees: float
    component: np.ndarray
    count: int


@dataclass(frozen=True)
class Variances:
    """`noise` variance of e, `effects` (count,) variances, and `p_value` of residuals that are white noise alone."""

    noise: float
    effects: np.ndarray
    p_value: float


def restricted_variances(data: Reduced) -> Variances:
    """Restricted maximum likelihood; the p-value is that of the likelihood ratio with `count` degrees of freedom.

    The null hypothesis lies on the boundary of the parameters, for which this p-value is too large (conservative):
    Self & Liang, J. Am. Stat. Assoc. 82 (1987).
    """
    from scipy.optimize import minimize

    white = data.squares / data.degrees
    target = _likelihood(data)
    if target is None or white <= 0:
        return Variances(max(white, 0.0), np.zeros(data.count), 1.0)
    start = target.start(white)
    options = {"maxiter": _STEPS, "ftol": 1e-10}
    bounds = target.bounds(start)
    found = minimize(target, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    variances = np.exp(found.x)
    at_zero = found.x[1:] <= start[1:] + np.log(_LOWEST) + 1.0
    gain = max(target.of_white_noise(white) - target.numbers * found.fun, 0.0)
    p_value = float(chi2.sf(gain, data.count))
    return Variances(float(variances[0]), np.where(at_zero, 0.0, variances[1:]), p_value)


@dataclass(frozen=True)
class _Likelihood:
    """-2 log of the restricted likelihood of log variances (noise first) by number of data, and its gradient."""

    score: np.ndarray
    factors: tuple[np.ndarray, ...]
    products: tuple[np.ndarray, ...]
    residual_squares: float
    degrees: float

    def start(self, white: float) -> np.ndarray:
        """Noise from what the effects cannot explain, and an equal share of the remainder for each component."""
        noise = (
            self.residual_squares / self.degrees
            if self.degrees > 0 and self.residual_squares > 0
            else white
        )
        excess = max(float(self.score @ self.score) - len(self.score) * noise, 0.1 * noise)
        sizes = np.array([(factor**2).sum() for factor in self.factors])
        sizes[sizes == 0] = 1.0  # a component without effects may have any variance
        return np.log(np.r_[noise, excess / len(self.factors) / sizes])

    @property
    def numbers(self) -> float:
        return len(self.score) + self.degrees

    def bounds(self, start: np.ndarray) -> list[tuple[float, float]]:
        """Of the log variances: beyond them a residual would be a difference of large numbers."""
        low = np.log(_LOWEST)
        high = np.log(_HIGHEST)
        noise = start[0]
        log_factor = np.log(_NOISE)
        noise_bounds = (noise - log_factor, noise + log_factor)
        component_bounds = [(size + low, size + high) for size in start[1:]]
        return [noise_bounds, *component_bounds]

    def of_white_noise(self, white: float) -> float:
        """-2 log likelihood, not by number of data, without effects."""
        return self.numbers * (np.log(white) + 1)

    def __call__(self, logs: np.ndarray) -> tuple[float, np.ndarray]:
        from scipy.linalg import solve_triangular

        noise, *effects = np.exp(logs)
        total = noise * np.eye(len(self.score))
        for variance, product in zip(effects, self.products):
            total += variance * product
        total[np.diag_indices_from(total)] += _ROUNDING * np.trace(total) / len(total)
        lower = np.linalg.cholesky(total)
        whitened = solve_triangular(lower, np.column_stack([*self.factors, self.score]), lower=True)
        score = whitened[:, -1]
        squares = float(score @ score)
        cost = 2 * np.log(np.diag(lower)).sum() + squares
        cost += self.degrees * np.log(noise) + self.residual_squares / noise
        gradient = []
        place = 0
        for variance, factor in zip(effects, self.factors):
            of_component = whitened[:, place : place + factor.shape[1]]
            place += factor.shape[1]
            gradient.append(
                variance * float((of_component**2).sum() - ((of_component.T @ score) ** 2).sum())
            )
        # the traces of V^-1 dV add up to the order of V, and the squares of the solved score to its square
        of_noise = len(self.score) - squares - sum(gradient)
        of_noise += self.degrees - self.residual_squares / noise
        return float(cost) / self.numbers, np.array([of_noise, *gradient]) / self.numbers


def _likelihood(data: Reduced) -> _Likelihood | None:
    """None where the effects leave no trace in the residuals."""
    scale = _scales(data)
    values, vectors = symmetric_eigen(data.gram / np.outer(scale, scale))
    is_retained = values > _RANK * max(values[-1], 0.0)
    degrees = data.degrees - is_retained.sum()
    if not is_retained.any() or degrees < 1:
        return None
    root = np.sqrt(values[is_retained])
    score = (vectors[:, is_retained].T @ (data.pull / scale)) / root
    rows = root[:, None] * vectors[:, is_retained].T * scale
    factors = tuple(rows[:, data.component == j] for j in range(data.count))
    residual_squares = max(data.squares - float(score @ score), 1e-12 * data.squares)
    products = tuple(factor @ factor.T for factor in factors)
    return _Likelihood(score, factors, products, residual_squares, float(degrees))


def _scales(data: Reduced) -> np.ndarray:
    """(q,) root mean square trace of the effects of each component in the residuals: components differ in unit."""
    diagonal = np.maximum(np.diag(data.gram), 0.0)
    sums = np.bincount(data.component, diagonal, data.count)
    effect_counts = np.bincount(data.component, minlength=data.count)
    means = sums / np.maximum(effect_counts, 1)
    scales = np.sqrt(np.where(means > 0, means, 1.0))
    return scales[data.component]
