"""The variance that a model misses, estimated from its mean squared error on unseen samples and a known noise.

Of N independent coordinates with the variance v = known + x, the mean square H has the likelihood
v^(-N/2) exp(-N H / (2 v)). H minus the known variance scatters by sqrt(2 / N) of it, as much as thirty parameters add
to the error of a hundred poses. Cut off at zero, such a difference adds a discrepancy to every second model that has
none, and nothing to the others. Its posterior mean is used instead. The prior has two parts of equal probability: no
discrepancy, and one whose size in units of the noise is half-Cauchy (Mitchell and Beauchamp, J. Am. Stat. Assoc. 83
(1988) 1023; Gelman, Bayesian Analysis 1 (2006) 515).
"""

import numpy as np

_PRESENT = 0.5  # prior probability of a discrepancy
_POINTS = 4000  # of the quadrature over its logarithm: steps of half a percent
_SMALLEST = 1e-4  # of the noise


def expected_discrepancy(mean_square: float, known: float, noise: float, coordinates: int) -> float:
    """Posterior mean of the variance that is missed.

    mean_square: of the error of a coordinate on unseen samples; known: its variance from noise and all other known
    causes; noise: variance of the noise, which scales the prior; coordinates: number of independent squares.
    """
    if not known > 0 or not noise > 0 or not mean_square > 0:
        return max(mean_square - known, 0.0)
    largest = 10 * max(np.sqrt(mean_square / noise), 1.0)
    size = np.geomspace(_SMALLEST, largest, _POINTS)
    missed = noise * size**2
    log_likelihood = _log_likelihood(mean_square, known + missed, coordinates)
    log_null = float(_log_likelihood(mean_square, known, coordinates))
    top = max(float(log_likelihood.max()), log_null)
    # half-Cauchy density times d(size), which is proportional to the size on a logarithmic grid
    weight = 2 / np.pi / (1 + size**2) * size * np.log(size[1] / size[0])
    weight *= _PRESENT * np.exp(log_likelihood - top)
    absent = (1 - _PRESENT) * np.exp(log_null - top)
    return float((weight * missed).sum() / (weight.sum() + absent))


def _log_likelihood(mean_square: float, variance, coordinates: int):
    return -0.5 * coordinates * (np.log(variance) + mean_square / variance)


__all__ = ["expected_discrepancy"]
