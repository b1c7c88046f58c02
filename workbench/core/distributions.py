"""Tail probabilities and quantiles of the distributions that tests use: normal, chi-square, Student, Fisher.

They are those of `scipy.stats`, computed by the same functions of `scipy.special`. `scipy.stats` itself
takes about half a second to import, which every command would pay.
"""

import numpy as np
from scipy import special


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
"""Values up to which the distribution of signed ranks is enumerated."""


def signed_rank_p_value(values: np.ndarray) -> float:
    """p-value that values (n,) are symmetric about 0, against larger ones: Wilcoxon's signed-rank test.

    Zeros are left out. Up to 50 values the distribution is exact, also for tied ranks; of more values it is normal.
    Source: Wilcoxon, Biometrics Bulletin 1 (1945) 80; ties: Lehmann, Nonparametrics (1975), sec. 3.2.
    """
    values = np.asarray(values, float)
    values = values[values != 0]
    _, group, counts = np.unique(np.abs(values), return_inverse=True, return_counts=True)
    ranks = (2 * np.cumsum(counts) - counts + 1)[group]  # doubled, so that those of ties are whole
    statistic = int(ranks[values > 0].sum())
    if len(values) > _EXACT:
        deviation = statistic - ranks.sum() / 2
        return float(norm.sf(deviation / np.sqrt((ranks.astype(float) ** 2).sum() / 4)))
    probability = np.zeros(int(ranks.sum()) + 1)
    probability[0] = 1.0
    for rank in ranks:
        shifted = np.concatenate([np.zeros(rank), probability[:-rank]])
        probability = (probability + shifted) / 2
    return float(probability[statistic:].sum())
