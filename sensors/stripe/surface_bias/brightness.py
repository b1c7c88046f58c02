"""Brightness of a surface under light of different incidence, measured on the line itself.

The light of a line falls off across it as its surface turns away from the light, and its centre moves with that
(`surface_line`). A matt surface (Lambert) is as bright as the cosine m of the incidence. Real ones are
not: ambient light, translucency and roughness fill their dark side (Oren & Nayar, Proc. SIGGRAPH, 1994, 239), gloss
lifts their bright side. Here

    ln brightness = const + p ln m + s (m - 1),

p = 1 and s = 0 for a matt surface. Both come from the light that the stripes hold, where it tells more than what is
known of surfaces in general.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from sensors.stripe.surface_bias.surface_line import SMOOTH, SurfaceLine
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.least_squares.linear_algebra import inverse_positive

_SURFACES_VARY = np.array([0.5, 1.0])  # std of exponent and gloss among surfaces in general
_FEWEST = 20
_REWEIGHTED = 12
_GRAIN = 5  # rows that a grain of speckle lasts at most: neighbours in it tell the same
_LEAST_SCATTER = 1e-3  # of ln brightness


@dataclass(frozen=True)
class Brightness:
    """The law of a surface: `exponent` p and `gloss` s, and their `covariance` (2, 2)."""

    exponent: float = 1.0
    gloss: float = 0.0
    covariance: np.ndarray = field(
        default_factory=lambda: np.diag(_SURFACES_VARY**2), compare=False
    )

    def applied(self, bend: SurfaceLine) -> SurfaceLine:
        """A bend whose changes of brightness are those of a matt surface, with those of this surface."""
        share = self.exponent + self.gloss * bend.incidence_cosine
        return replace(bend, shade=bend.shade * share, brightening=bend.brightening * share)


def brightness_law(bend: SurfaceLine, width: np.ndarray, peak: np.ndarray) -> Brightness:
    """The law from widths (n,) px and peaks (n,) grey values of the lines at the points of `bend`.

    A line holds the light peak * width, spread over the slope of the light plane. Least absolute deviations by
    reweighting, with the law of a matt surface as prior, at places that neither light nor sight graze.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        light = np.log(width * peak * np.abs(bend.slope))
    usable = np.isfinite(light) & (bend.incidence_cosine > SMOOTH) & (bend.facing > SMOOTH)
    if usable.sum() < _FEWEST or not np.ptp(bend.incidence_cosine[usable]) > 0:
        return Brightness()
    cosine = bend.incidence_cosine[usable]
    rows = np.stack([np.ones(usable.sum()), np.log(cosine), cosine - 1])
    level = light[usable] - rows[1]  # beyond a matt surface
    precision = np.array([0.0, *_SURFACES_VARY**-2.0])
    found = np.zeros(3)
    weight = np.ones(usable.sum())
    for _ in range(_REWEIGHTED):
        misfit = np.abs(level - found @ rows)
        scatter = max(MEDIAN_TO_SIGMA * float(np.median(misfit)), _LEAST_SCATTER)
        weight = np.minimum(1, scatter / np.maximum(misfit, _LEAST_SCATTER)) / scatter**2 / _GRAIN
        covariance = inverse_positive((rows * weight) @ rows.T + np.diag(precision))
        found = covariance @ (rows @ (weight * level))
    return Brightness(1 + float(found[1]), float(found[2]), covariance[1:, 1:])
