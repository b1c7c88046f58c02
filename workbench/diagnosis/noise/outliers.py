"""Samples from another process, and noise that is not the same everywhere: looked at after the mean is explained."""

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import median

from workbench.core.distributions import chi2
from workbench.diagnosis.levels import LEAST_NUMBER, OUTLIER_WEIGHT

FULL_WEIGHT, _LITTLE = 3.4, 6.0
"""Lengths of whitened residuals up to which a sample counts in full, exceeded by one in a hundred Gaussian samples of
three coordinates, and from which on it hardly counts."""
_LEVELS = 8
"""Parts of a covariate at most, with `LEAST_NUMBER` samples in each."""


def robust_weights(white: np.ndarray) -> np.ndarray:
    """(n,) weights of samples from whitened residuals (m, n): Huber's, falling faster far out.

    The length's scale is that of the median sample, so that what is not yet explained makes no
    outliers. Huber, Ann. Math. Stat. 35 (1964); the tail after Hampel et al., Robust Statistics (1986).
    """
    length = lengths(white)
    weights = np.minimum(1.0, FULL_WEIGHT / np.maximum(length, 1e-300))
    return weights * np.minimum(1.0, _LITTLE / np.maximum(length, 1e-300)) ** 3


def robust_loss(white: np.ndarray) -> float:
    """Huber's loss of whitened residuals (m, n): half the squared lengths of samples, and linear in those far off."""
    length = lengths(white)
    far = length > FULL_WEIGHT
    return float(np.where(far, FULL_WEIGHT * length - FULL_WEIGHT**2 / 2, length**2 / 2).sum())


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


def spread_along(white: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) spread of residuals (m, n) with a like covariate x (n,), 1 on average: from medians of eighths, or fewer."""
    inner, most = np.unique(x), int(np.clip(white.shape[1] // LEAST_NUMBER, 2, _LEVELS))
    inner = inner if len(inner) <= most else np.quantile(x, np.arange(1, most) / most)
    part = np.searchsorted(inner, x)
    square = (white**2).sum(0)
    middle = median(square, part, np.arange(part.max() + 1))
    spread = np.nan_to_num(middle, nan=1.0)
    if not spread.max() > 0:
        return np.ones(len(part))
    each = np.sqrt(np.maximum(spread, 1e-12 * spread.max()))[part]
    return each / np.sqrt((each**2).mean())


def spread_with(
    white: np.ndarray, covariates: Mapping[str, np.ndarray]
) -> tuple[str, float] | None:
    """The covariate with which the spread of residuals (m, n) grows or falls, and its p-value over all of them.

    The score test of Breusch & Pagan (1979) as Koenker (J. Econometrics 17, 1981) made it independent
    of the noise's kurtosis; outliers left out. None where no covariate varies.
    """
    kept = robust_weights(white) > OUTLIER_WEIGHT
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
    # of covariates that say the same, the first, as it was recorded
    name = next(name for name, score in scores.items() if score > highest * (1 - 1e-6))
    return name, float(min(1.0, chi2.sf(scores[name], 1) * len(scores)))
