"""Statistical tests of a least-squares adjustment: variance factor, single observations, structure in residuals.

Everything here works on whitened residuals (m, n): m components of n samples, divided by their own sigma.
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import chi2, fisher, norm
from workbench.core.least_squares.linear_algebra import symmetric_eigen, thin_svd

_UNCONTROLLED = 1e-3  # redundancy below which an observation is hardly checked by the others
# Degrees of freedom of the t distribution fitted to the residuals. Never lighter than 8: a hundred residuals cannot
# show the tails that decide over a single sample, and a normal law would call 5 % of clean recordings with the tails
# of t with 5 degrees of freedom faulty (simulated; 0.7 % with this limit).
_HEAVIEST, _LIGHTEST = 3.0, 8.0
_PERMUTATIONS = 200


@dataclass(frozen=True)
class VarianceTest:
    """Chi-square test of the variance factor (global test).

    `factor`: square root of the a-posteriori variance factor, residual over stated sigma. `degrees` of freedom after
    the correction for heavy tails. `p_above` that noise alone gives a factor as large, `p_below` as small.
    """

    factor: float
    degrees: float
    p_above: float
    p_below: float


def variance_test(white: np.ndarray, degrees: float) -> VarianceTest:
    """Test whether residuals (m, n), whitened by the STATED sigma, have variance 1; `degrees` of freedom left.

    Baarda, A testing procedure for use in geodetic networks (1968); Koch, Parameter Estimation and Hypothesis Testing
    in Linear Models (1999), sec. 4.2.4. The chi-square law of a variance holds for normal noise only. The degrees of
    freedom are therefore reduced to those with which the observed scatter of the samples' squares agrees
    (Satterthwaite 1946; Box, Biometrika 40 (1953) 318).
    """
    squares = (white**2).sum(0)
    total = float(squares.sum())
    factor = np.sqrt(total / max(degrees, 1e-300))
    reduced = effective_degrees(squares, degrees, white.size)
    statistic = reduced * factor**2
    return VarianceTest(
        float(factor),
        reduced,
        float(chi2.sf(statistic, reduced)),
        float(chi2.cdf(statistic, reduced)),
    )


def effective_degrees(squares: np.ndarray, degrees: float, size: int) -> float:
    """Equivalent degrees of freedom of the mean of `squares` (n,), sums of `size` squares in all; at most `degrees`."""
    spread = float(squares.var(ddof=1)) if len(squares) > 1 else 0.0
    if spread <= 0:
        return float(degrees)
    equivalent = 2 * len(squares) * float(squares.mean()) ** 2 / spread
    return float(np.clip(equivalent * degrees / size, 1.0, max(degrees, 1.0)))


def redundancy(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n, m, m) redundancy matrix of every sample: covariance of its whitened residual.

    rows (F, m, n): whitened derivative; covariance (F, F) of the parameters for unit weight. Baarda (1968).
    """
    by_sample = rows.transpose(2, 1, 0)
    explained = by_sample @ covariance @ by_sample.transpose(0, 2, 1)
    return np.eye(rows.shape[1]) - explained


def standardised_squares(white: np.ndarray, redundancies: np.ndarray | None = None) -> np.ndarray:
    """(n,) squared residuals over their own covariance, scaled to m degrees of freedom each.

    The multivariate form of Baarda's w-test: v' R^-1 v, with directions that no other observation checks left out.
    """
    if redundancies is None:
        return (white**2).sum(0)
    matrix = (redundancies + redundancies.transpose(0, 2, 1)) / 2
    values, vectors = symmetric_eigen(matrix)
    projected = np.einsum("nmk,mn->nk", vectors, white)
    checked = values > _UNCONTROLLED
    squares = np.where(checked, projected**2 / np.where(checked, values, 1), 0).sum(1)
    return squares * white.shape[0] / np.maximum(checked.sum(1), 1)


@dataclass(frozen=True)
class TailFit:
    """Scale and tail of squared residuals: squares / (m scale^2) follow F(m, degrees)."""

    scale: float
    degrees: float


def fit_tail(squares: np.ndarray, components: int, least_scale: float = 0.0) -> TailFit:
    """Robust scale and degrees of freedom of a multivariate t distribution, from median and 90 % quantile.

    squares (n,): sums of `components` squares. Quantiles, so that up to about a tenth of outlying samples do not
    change them; heavier tails only make the test of single samples more cautious.
    """
    middle, high = np.quantile(squares, [0.5, 0.9])
    wanted = high / max(middle, 1e-300)
    low = np.log(_HEAVIEST)
    top = np.log(_LIGHTEST)
    for _ in range(40):
        degrees = np.exp((low + top) / 2)
        ratio = fisher.ppf(0.9, components, degrees) / fisher.ppf(0.5, components, degrees)
        if ratio > wanted:
            low = np.log(degrees)
        else:
            top = np.log(degrees)
    degrees = float(np.exp((low + top) / 2))
    scale = np.sqrt(middle / components / fisher.ppf(0.5, components, degrees))
    return TailFit(float(max(scale, least_scale)), degrees)


def outlying(
    squares: np.ndarray,
    components: int,
    least_scale: float = 0.0,
    level: float = 0.01,
    reference: np.ndarray | None = None,
) -> np.ndarray:
    """(n,) True for samples that do not belong to the distribution of the others.

    squares (n,): `standardised_squares`; reference (n,): samples to take the distribution from, else all. That is
    the fitted t distribution, so that this is Pope's tau test (NOAA TR NOS 65 NGS 1, 1976) with a robust scale;
    family-wise error `level` by Bonferroni.
    """
    known = squares if reference is None else squares[reference]
    if len(known) < 10:
        return np.zeros(len(squares), bool)
    tail = fit_tail(known, components, least_scale)
    if tail.scale**2 < np.finfo(float).tiny:  # the others fit exactly
        return squares > 0
    p = fisher.sf(squares / (components * tail.scale**2), components, tail.degrees)
    return p < level / len(squares)


def robust_sigma(squares: np.ndarray, components: int) -> float:
    """Sigma of one component from the median of sums of `components` squares (n,), for normal noise."""
    return float(np.sqrt(np.median(squares) / chi2.ppf(0.5, components)))


@dataclass(frozen=True)
class NeighbourTest:
    """Von Neumann's ratio of neighbouring residuals.

    `ratio`: mean squared difference over twice the variance, 1 for independent residuals and below 1 where neighbours
    agree. `p_value` of a ratio as small if residuals were exchanged at random.
    """

    ratio: float
    p_value: float


def neighbour_test(values: np.ndarray, neighbour: np.ndarray, seed: int = 0) -> NeighbourTest:
    """Whether values (m, n) resemble those of their neighbours (n,) more than chance explains.

    von Neumann, Ann. Math. Stat. 12 (1941) 367, for neighbours of any kind; the null distribution is that of random
    permutations, approximated by its mean and variance.
    """
    centred = values - values.mean(1, keepdims=True)
    total = 2 * float((centred**2).sum()) / values.shape[1]
    if total <= 0 or values.shape[1] < 8:
        return NeighbourTest(1.0, 1.0)
    rng = np.random.default_rng(seed)
    found = _difference(centred, neighbour) / total
    chance = [
        _difference(centred[:, rng.permutation(values.shape[1])], neighbour)
        for _ in range(_PERMUTATIONS)
    ]
    chance = np.array(chance) / total
    z = (found - chance.mean()) / max(chance.std(ddof=1), 1e-300)
    return NeighbourTest(float(found), float(norm.cdf(z)))


def _difference(values, neighbour):
    return float(((values - values[:, neighbour]) ** 2).sum(0).mean())


@dataclass(frozen=True)
class ChangeTest:
    """`place` (from 0) of the first value after the best change; `share` of the variance of all series by it."""

    place: int
    p_value: float
    share: float


def change_test(values: np.ndarray) -> ChangeTest:
    """Whether the mean of any of some series (m, n) changes at any place but the first and the last tenth.

    The largest standardised cumulative sum (CUSUM) over all series and places, with Bonferroni's bound on its p-value;
    slow drifts exceed it, too. Basseville & Nikiforov, Detection of Abrupt Changes (1993); Zeileis & Hornik, Statistica
    Neerlandica 61 (2007) 488, for scores of an estimate.
    """
    values = values - values.mean(1, keepdims=True)
    spread = values.std(1)
    values, n = values[spread > 0] / spread[spread > 0, None], values.shape[1]
    margin = max(n // 10, 2)
    places = np.arange(margin, n - margin + 1)
    if not len(places) or not len(values):
        return ChangeTest(0, 1.0, 0.0)
    sums = np.abs(np.cumsum(values, axis=1)[:, places - 1])
    largest = sums / np.sqrt(places * (n - places) / n)
    best = np.unravel_index(np.argmax(largest), largest.shape)
    z = float(largest[best])
    p = min(2 * norm.sf(z) * largest.size, 1.0)
    share = max(z**2 - 1, 0.0) / (n * len(values))
    return ChangeTest(int(places[best[1]]), float(p), share)


@dataclass(frozen=True)
class RegressionTest:
    """F-test of columns added to an adjustment; `share` of the residual variance that they explain beyond chance."""

    f: float
    p_value: float
    share: float


def regression_test(
    residual: np.ndarray, baseline: np.ndarray, columns: np.ndarray
) -> RegressionTest:
    """Partial F-test whether `columns` (N, P) explain a residual (N,) beyond the `baseline` (N, F) of the fit.

    Draper & Smith, Applied Regression Analysis, 3rd ed. (1998), ch. 6. Rank-deficient columns are allowed.
    """
    base = _orthonormal(baseline)
    remaining = residual - base @ (base.T @ residual)
    added = _orthonormal(
        columns - base @ (base.T @ columns), np.linalg.norm(columns, axis=0).max(initial=0)
    )
    explained = float(((added.T @ remaining) ** 2).sum())
    total = float(remaining @ remaining)
    first = added.shape[1]
    second = len(residual) - base.shape[1] - added.shape[1]
    if first < 1 or second < 1 or total <= 0:
        return RegressionTest(1.0, 1.0, 0.0)
    remaining_variance = max(total - explained, 1e-300) / second
    f = explained / first / remaining_variance
    share = 1 - remaining_variance / (total / (first + second))
    p_value = float(fisher.sf(f, first, second))
    return RegressionTest(float(f), p_value, float(max(share, 0.0)))


def _orthonormal(columns: np.ndarray, size: float | None = None) -> np.ndarray:
    """(N, r) orthonormal basis of the column space; size: below 1e-8 of it a direction is rounding."""
    basis, values, _ = thin_svd(columns)
    largest = values.max(initial=0) if size is None else max(size, 1e-300)
    return basis[:, values > 1e-8 * largest]


def p_text(p: float) -> str:
    """A p-value for a person: two digits, nothing finer than 1e-6."""
    return "p < 1e-6" if p < 1e-6 else f"p = {p:.2g}"
