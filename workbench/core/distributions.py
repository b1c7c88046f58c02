"""Tail probabilities and quantiles of the distributions of tests: normal, chi-square, Student, F, signed ranks.

They are those of `scipy.stats`, computed by the same functions of `scipy.special`. `scipy.stats` itself
takes about half a second to import, which every command would pay.
"""

import numpy as np
from scipy import special

MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of normal deviations over the median of their absolute values."""


class norm:
    """The standard normal distribution."""

    @staticmethod
    def cdf(x):
        """Probability of a value up to x."""
        return special.ndtr(x)

    @staticmethod
    def sf(x):
        """Probability of a value above x."""
        return special.ndtr(np.negative(x))

    @staticmethod
    def isf(p):
        """The value that is exceeded with probability p."""
        return np.negative(special.ndtri(p))


class chi2:
    """The chi-square distribution with `degrees` of freedom."""

    @staticmethod
    def cdf(x, degrees):
        """Probability of a value up to x."""
        return special.chdtr(degrees, np.maximum(x, 0.0))

    @staticmethod
    def sf(x, degrees):
        """Probability of a value above x."""
        return special.chdtrc(degrees, np.maximum(x, 0.0))

    @staticmethod
    def logsf(x, degrees):
        """Logarithm of the probability of a value above x, minus infinity where that is too small for a number."""
        with np.errstate(divide="ignore"):
            return np.log(chi2.sf(x, degrees))

    @staticmethod
    def ppf(p, degrees):
        """The value that is not exceeded with probability p."""
        return 2.0 * special.gammaincinv(np.asarray(degrees) / 2.0, p)

    @staticmethod
    def isf(p, degrees):
        """The value that is exceeded with probability p."""
        return special.chdtri(degrees, p)


class student:
    """Student's t distribution with `degrees` of freedom."""

    @staticmethod
    def sf(x, degrees):
        """Probability of a value above x."""
        return special.stdtr(degrees, np.negative(x))

    @staticmethod
    def isf(p, degrees):
        """The value that is exceeded with probability p."""
        return np.negative(special.stdtrit(degrees, p))


class fisher:
    """Fisher's F distribution with `first` and `second` degrees of freedom."""

    @staticmethod
    def sf(x, first, second):
        """Probability of a value above x."""
        return special.fdtrc(first, second, np.maximum(x, 0.0))

    @staticmethod
    def ppf(p, first, second):
        """The value that is not exceeded with probability p."""
        return special.fdtri(first, second, p)

    @staticmethod
    def isf(p, first, second):
        """The value that is exceeded with probability p."""
        return 1.0 / special.fdtri(second, first, p)


_EXACT = 50
"""Differences up to which the distribution of the rank sum is counted; the normal one is right beyond."""


def signed_rank_sf(differences: np.ndarray) -> float:
    """Chance of at least this sum of positive ranks where differences (n,) are symmetric about zero.

    Wilcoxon's signed-rank test, one-sided: small where the differences are mostly positive. Zeros are left out and ties
    share their ranks. The distribution is exact up to 50 differences without zeros and ties, else normal.
    Wilcoxon, Biometrics Bulletin 1 (1945) 80; variance with ties: Pratt & Gibbons, Concepts of Nonparametric
    Theory (1981).
    """
    values = np.asarray(differences, float)
    nonzero = values[values != 0]
    if not len(nonzero):
        return 1.0
    _, place, ties = np.unique(np.abs(nonzero), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(ties) - (ties - 1) / 2)[place]
    total = float(ranks[nonzero > 0].sum())
    if len(nonzero) == len(values) <= _EXACT and ties.max() == 1:
        chances = _rank_sums(len(nonzero))
        return float(chances[round(total) :].sum())
    spread = np.sqrt((ranks**2).sum() / 4)
    return float(norm.sf((total - ranks.sum() / 2) / spread))


def _rank_sums(count: int) -> np.ndarray:
    """Probability of each sum of positive ranks, 0 to n (n + 1) / 2, where every sign is as likely as the other."""
    chances = np.ones(1)
    for rank in range(1, count + 1):
        gap = np.zeros(rank)
        chances = (np.concatenate([chances, gap]) + np.concatenate([gap, chances])) / 2
    return chances
