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
