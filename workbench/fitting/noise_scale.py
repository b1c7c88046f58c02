"""The noise of a fit, estimated until it agrees with what the fit leaves.

A tracker's 3 um must not decide between poses while 70 um are unmodelled: one variance is added to all samples, so that
the reduced chi-square becomes 1 (Paule & Mandel, J. Res. NBS 87 (1982) 377). Where no sigma is known it is estimated
altogether.
"""

from dataclasses import replace

import numpy as np

from robot_model.system import RobotChain
from workbench.core.least_squares.linear_algebra import root_between
from workbench.core.least_squares.solver import Fit

NOISE_ROUNDS = 8
"""Most estimates of the noise of one model; three or four are usual."""
_SAME_NOISE = 0.02
"""Relative change of sigma that ends them: within the standard error of the noise of 1,000 samples."""
_LEAST_SHARE = 1e-4  # of the stated variance that the noise may have
_LEAST_FREE = 1.0  # degrees of freedom that a fit leaves at least
_NANOMETRE = 1e-6  # mm: nothing is measured better


def noise_scaled(
    chain: RobotChain, fit: Fit, fitted: np.ndarray | None = None, may_shrink: bool = True
) -> RobotChain:
    """The chain with sigmas widened until robustly weighted residuals agree with them.

    fitted (n,) bool: samples of the chain that the fit has; None for all. may_shrink: where positions and
    orientations are measured, the sigma of one kind may also be stated too large. It is then scaled down, as the two
    kinds are weighted against one another.
    """
    stated = 0 * chain.stated_sigma if chain.sigma_unknown else chain.stated_sigma
    of_fit = stated if fitted is None else stated[:, fitted]
    sigma = chain.sigma.copy()
    weights = fit.weights / fit.weights.mean()
    scales = may_shrink and len(fit.residual) > 3 and not chain.sigma_unknown
    for rows in (slice(0, 3), slice(3, 6)):  # positions, and orientations where they are measured
        squares = fit.residual[rows] ** 2 * weights / _share_of_degrees(fit, rows)
        if squares.size:
            if scales:
                share = float((squares / of_fit[rows] ** 2).mean())
            else:
                share = 1.0
            share = np.clip(share, _LEAST_SHARE, 1.0)
            sigma[rows] = np.sqrt(share * stated[rows] ** 2 + _extra(squares, of_fit[rows]))
    return replace(chain, sigma=sigma)


def _share_of_degrees(fit: Fit, rows: slice) -> float:
    """Share of the residuals of some components that the fit leaves as degrees of freedom.

    A kind that most parameters depend on would else seem free of noise, get all the weight, and be interpolated.
    """
    if fit.shares is None or not fit.shares[rows].size:
        return fit.degrees / fit.residual.size
    return max(float(fit.shares[rows].mean()), _LEAST_FREE / fit.residual[rows].size)


def is_settled(before: RobotChain, after: RobotChain) -> bool:
    """Whether two estimates of the noise agree."""
    return bool(np.allclose(after.sigma, before.sigma, rtol=_SAME_NOISE, atol=0))


def _extra(squares, sigma) -> float:
    """The variance v, at least 0, with mean(squares / (sigma^2 + v)) = 1; a nanometre's where no sigma is known."""

    def excess(v):
        return float((squares / (sigma**2 + v)).mean() - 1)

    high = 2 * float(squares.mean())  # twice: at the mean itself rounding may leave the sign open
    min_variance = max(1e-12 * high, _NANOMETRE**2)
    if high > min_variance and excess(min_variance) > 0:
        return root_between(excess, min_variance, high)
    return min_variance * (not sigma.any())
