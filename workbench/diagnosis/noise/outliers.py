"""Samples from another process, and noise that is not the same everywhere: looked at after the mean is explained."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2
from scipy.stats import f as fisher

# lengths of whitened residuals: below the first a sample counts in full, from the second on it hardly
# counts. Of Gaussian samples in three coordinates one in a hundred is above the first.
_FULL, _LITTLE = 3.4, 6.0
NAMED_AT = 0.01  # chance that any sample of a clean recording is called an outlier
_RATIO_ERROR = (
    0.64  # standard error of the 90 % quantile over the median of n Gaussian lengths, times sqrt(n)
)
_LEVELS, _EACH = 8, 30
"""Parts of a covariate at most, and samples in each at least: a median of thirty is known to a sixth."""


def robust_weights(white: np.ndarray) -> np.ndarray:
    """(n,) weights of samples from whitened residuals (m, n): Huber's, falling faster far out.

    The length's scale is that of the median sample, so that what is not yet explained makes no
    outliers. Huber, Ann. Math. Stat. 35 (1964); the tail after Hampel et al., Robust Statistics (1986).
    """
    length = lengths(white)
    weights = np.minimum(1.0, _FULL / np.maximum(length, 1e-300))
    return weights * np.minimum(1.0, _LITTLE / np.maximum(length, 1e-300)) ** 3


def lengths(white: np.ndarray) -> np.ndarray:
    """(n,) lengths of residuals (m, n) on the scale of a unit Gaussian in three coordinates."""
    m = len(white)
    square = (white**2).sum(0)
    # most residuals may be exactly zero: the others are then compared with a millionth of the longest
    spread = max(np.median(square) / chi2.ppf(0.5, m), 1e-12 * square.max(initial=0.0), 1e-300)
    if m == 3:
        return np.sqrt(square / spread)
    quantile = chi2.logsf(square / spread, m)
    return np.sqrt(chi2.isf(np.exp(np.maximum(quantile, -650.0)), 3))


def named(white: np.ndarray) -> np.ndarray:
    """(n,) bool: samples too far off for the noise of the others, over all samples together."""
    return alone(white) < NAMED_AT / white.shape[1]


def alone(white: np.ndarray) -> np.ndarray:
    """(n,) p-value of each sample of residuals (m, n) by itself, in noise with the tails that the bulk shows.

    Gaussian, but where nine tenths of the samples lie farther out than chance allows (1.5 standard errors): then
    Student's, with the degrees of freedom that their 90 % quantile over the median asks for.
    """
    length = lengths(white)
    tails = _tails(length)
    if tails is None:
        return chi2.sf(length**2, 3)
    return fisher.sf(length**2 / 3 * fisher.ppf(0.5, 3, tails) / (chi2.ppf(0.5, 3) / 3), 3, tails)


def _tails(length) -> float | None:
    """Degrees of freedom of Student's noise from lengths (n,) on a Gaussian's scale; None for a Gaussian."""

    def ratio(nu):
        return np.sqrt(fisher.ppf(0.9, 3, nu) / fisher.ppf(0.5, 3, nu))

    if not np.median(length) > 0:  # exact data: no noise whose tails could be estimated
        return None
    found, gauss = (
        np.quantile(length, 0.9) / np.median(length),
        np.sqrt(chi2.ppf(0.9, 3) / chi2.ppf(0.5, 3)),
    )
    if found < gauss * (1 + 1.5 * _RATIO_ERROR / np.sqrt(len(length))):
        return None
    return 2.0 if found >= ratio(2.0) else float(brentq(lambda nu: ratio(nu) - found, 2.0, 1e6))


def evened(white: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Residuals (m, n) divided by the spread that those with a like covariate x (n,) have."""
    return white / spread_along(white, x)


def spread_along(white: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) spread of residuals (m, n) with a like covariate x (n,), 1 on average: from medians of eighths, or fewer."""
    inner, most = np.unique(x), int(np.clip(white.shape[1] // _EACH, 2, _LEVELS))
    inner = inner if len(inner) <= most else np.quantile(x, np.arange(1, most) / most)
    part = np.searchsorted(inner, x)
    square = (white**2).sum(0)
    spread = np.array(
        [np.median(square[part == k]) if (part == k).any() else 1.0 for k in range(part.max() + 1)]
    )
    if not spread.max() > 0:
        return np.ones(len(part))
    each = np.sqrt(np.maximum(spread, 1e-12 * spread.max()))[part]
    return each / np.sqrt((each**2).mean())


def spread_with(
    white: np.ndarray, covariates: Mapping[str, np.ndarray]
) -> tuple[str, float] | None:
    """The covariate with which the spread of residuals (m, n) grows or falls, and its p-value over all of them.

    The score test of Breusch & Pagan (1979) as Koenker (J. Econometrics 17, 1981) made it independent
    of the noise's kurtosis; outliers taken out. None where no covariate varies.
    """
    kept = ~named(white)
    squares = (white[:, kept] ** 2).sum(0)
    if not np.ptp(squares) > 0:
        return None
    scores = {}
    for name, x in covariates.items():
        x = x[kept]
        if np.ptp(x) > 0 and np.isfinite(x).all():
            scores[name] = len(x) * np.corrcoef(squares, x)[0, 1] ** 2
    if not scores:
        return None
    highest = max(scores.values())
    name = next(
        name for name, score in scores.items() if score > highest * (1 - 1e-6)
    )  # as it was recorded
    return name, float(min(1.0, chi2.sf(scores[name], 1) * len(scores)))
