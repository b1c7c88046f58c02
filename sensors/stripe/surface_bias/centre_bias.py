"""Bias of the stripe centres on a ball due to its curvature, and the uncertainty of this bias.

The bias (`surface_line`) follows from the squared widths of light plane and blur, and from the exponent
and the gloss of the surface's brightness. All are estimated from the stripes, with priors for lines and surfaces; an
error of one displaces all points of the ball, most where light or line of sight are grazing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.stripe.surface_bias.brightness import Brightness, brightness_law
from sensors.stripe.surface_bias.surface_line import LineShape, SurfaceLine

_STEP = 0.01  # of one standard deviation: of the difference quotients
_LAW = 0.1  # relative, of the bias: its law is of first order in width over radius


@dataclass(frozen=True)
class CentreBias:
    """`size` (n,) px along the scan line; `derivative` (m, n) px by errors that all points share.

    `covariance` (m, m) of these errors; `bend`: of the surface as bright as it was measured to be.
    """

    size: np.ndarray
    derivative: np.ndarray
    covariance: np.ndarray
    bend: SurfaceLine


def estimate_centre_bias(
    matt: SurfaceLine, shape: np.ndarray, known: LineShape | None
) -> CentreBias:
    """The pull of a ball from its bend if it were matt and lines (3, n): width px, `Stripes.shape`, and peak.

    known: the line as it is on other surfaces, None where that is not known.
    """
    law = brightness_law(matt, shape[0], shape[2])
    bend = law.applied(matt)
    line, of_squares = bend.fitted_line(shape[0], known)
    values = np.array([line.plane_width_mm**2, line.blur_px**2, law.exponent, law.gloss])

    def at(moved: Sequence[float]) -> np.ndarray:
        plane, blur = np.sqrt(np.maximum(moved[:2], 0.0))
        surface = Brightness(*moved[2:]).applied(matt)
        return np.nan_to_num(surface.centre_bias(LineShape(plane, blur), *shape[:2]))

    size = at(values)
    covariance = np.zeros((5, 5))
    covariance[:2, :2] = of_squares
    covariance[2:4, 2:4] = law.covariance
    covariance[4, 4] = _LAW**2
    rows = []
    for k, step in enumerate(_STEP * np.sqrt(np.diag(covariance)[:4])):
        moved = values + step * (np.arange(4) == k)
        rows.append((at(moved) - size) / step if step else np.zeros_like(size))
    return CentreBias(size, np.array([*rows, size]), covariance, bend)
