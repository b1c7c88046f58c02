"""The sigma of each kind of measurement, scaled to what a fit leaves."""

from dataclasses import replace

import numpy as np

from robot_model.system import RobotChain
from workbench.core.least_squares.linear_algebra import root_between
from workbench.core.least_squares.solver import Fit

_LEAST_SHARE = 1e-4  # of the stated variance that the noise may have


def noise_scaled(chain: RobotChain, fit: Fit) -> RobotChain:
    """Sigmas widened by one variance until robustly weighted residuals agree (Paule & Mandel 1982).

    Where positions and orientations are measured, the sigma of one kind may also be stated too large: it is scaled
    down, as the two kinds are weighed against one another.
    """
    stated = 0 * chain.stated_sigma if chain.sigma_unknown else chain.stated_sigma
    widened = chain.sigma.copy()
    spent = fit.residual.size / fit.degrees
    weights = fit.weights / fit.weights.mean()
    several = len(fit.residual) > 3 and not chain.sigma_unknown
    for rows in (slice(0, 3), slice(3, 6)):
        squares = fit.residual[rows] ** 2 * weights * spent
        if squares.size:
            least = float((squares / stated[rows] ** 2).mean()) if several else 1.0
            scale = np.sqrt(np.clip(least, _LEAST_SHARE, 1.0))
            widened[rows] = np.sqrt((scale * stated[rows]) ** 2 + _extra(squares, stated[rows]))
    return replace(chain, sigma=widened)


def _extra(squares, sigma):
    """The variance v, at least 0, with mean(squares / (sigma^2 + v)) = 1; floor: a nanometre."""

    def excess(v):
        return float((squares / (sigma**2 + v)).mean() - 1)

    high, least = 2 * float(squares.mean()) + 1e-12, 1e-12
    return root_between(excess, least, high) if excess(least) > 0 else least * (not sigma.any())


__all__ = ["noise_scaled"]
