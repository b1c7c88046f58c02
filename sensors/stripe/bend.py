"""What a surface does to the line's centre: on a ball or a tilted board the stripe is not symmetric, its fit is pulled.

Across the stripe the light is exp(-f^2 / (2 s^2)) cos(incidence), f the distance from the sheet's
middle, s the sheet's 1 sigma. Along the scan line, v px from where f = 0,

    f = f1 v + f2 v^2,   ln cos(incidence) = const + l v,

so that to first order the light is g(v) (1 + l v - (f2 / f1) v^3 / a^2), a = s / f1 px and g the
Gaussian of 1 sigma a. Blur to the width w multiplies the Hermite polynomial of order n by (a / w)^n;
the fit of a Gaussian to what is left finds its centre off by

    c = a^2 (l - (f2 / f1) (3 - q a^2 / w^2)),

q = 3/2 where all pixels count alike and 0 where they count by their photons. On a flat board f2 is perspective's: its
nearer part is seen larger.
"""

from dataclasses import dataclass

import numpy as np

from sensors.camera.model import Camera

_STEP = 0.5  # px, of the difference quotients; a ball's radius is some hundred px, a board wider
_STEEPEST = 0.1  # cosine of the light's incidence below which nothing is lit
_RATIOS = np.geomspace(1e-2, 1e3, 26)


@dataclass(frozen=True)
class Bend:
    """A surface's part in each of n stripe points: `slope` f1 (n,) mm/px, `bend` f2 (n,) mm/px^2, `shade` l (n,) 1/px;
    `lit` (n,) cosine of the light's incidence, 1 where it is unknown where the light comes from; `away` (n,) mm from
    the sheet's middle.
    """

    slope: np.ndarray
    bend: np.ndarray
    shade: np.ndarray
    lit: np.ndarray
    away: np.ndarray

    def pull(self, sheet: float, width: np.ndarray, ratio: np.ndarray) -> np.ndarray:
        """(n,) px by which centres of lines of `width` (n,) px are found off along the scan line.

        sheet: mm, 1 sigma width of the light plane; ratio (n,): photon variance at the peak over that next to the line.
        """
        square = (sheet / self.slope) ** 2
        counted = weighting(ratio) * np.minimum(square / width**2, 1.0)
        return square * (self.shade - self.bend / self.slope * (3 - counted))

    def sheet(self, width: np.ndarray) -> float:
        """mm, 1 sigma of the sheet from widths (n,) px of its lines: they widen with the slope, blur does not.

        Straight line of width^2 by 1 / slope^2, what is far off left out three times over; 0 where widths say nothing.
        """
        steep, square = self.slope**-2, np.asarray(width, float) ** 2
        kept = np.isfinite(steep) & np.isfinite(square) & (square > 0)
        grown = 0.0
        for _ in range(4):
            if kept.sum() < 20:
                return 0.0
            grown, blur = np.polyfit(steep[kept], square[kept], 1, w=1 / square[kept])
            off = np.abs(square - grown * steep - blur) / square
            kept = off <= 3 * 1.4826 * np.median(off[kept])
        return float(np.sqrt(max(grown, 0.0)))


def bend_on_ball(
    camera: Camera,
    centre: np.ndarray,
    radius: float,
    pixels: np.ndarray,
    planes: np.ndarray,
    scan: np.ndarray,
    light: np.ndarray | None = None,
) -> Bend:
    """How the sheet and its light change along the scan line at pixels (2, n) on a ball.

    centre (3,) and radius mm in the camera frame; planes (4, n) of the points; scan (2,) unit vector;
    light (3,) mm where the light comes from, None where that is unknown: then `shade` is 0. nan off the ball.
    """

    def surface(rays):
        along = centre @ rays
        with np.errstate(invalid="ignore"):
            points = rays * (
                along - np.sqrt(radius**2 - ((rays * along - centre[:, None]) ** 2).sum(0))
            )
        return points, (points - centre[:, None]) / radius

    return _bend(camera, surface, pixels, planes, scan, light)


def bend_on_boards(
    camera: Camera,
    normals: np.ndarray,
    heights: np.ndarray,
    pixels: np.ndarray,
    planes: np.ndarray,
    scan: np.ndarray,
    light: np.ndarray | None = None,
) -> Bend:
    """As `bend_on_ball`, of points on flat boards n.X = h: unit normals (3, n) and heights (n,) mm, camera frame."""
    side = np.sign((normals * (0 if light is None else light[:, None])).sum(0) - heights)

    def surface(rays):
        return rays * (heights / (normals * rays).sum(0)), normals * side

    return _bend(camera, surface, pixels, planes, scan, light)


def _bend(camera, surface, pixels, planes, scan, light):
    low, middle, high = (
        _seen(surface, camera.rays(pixels + step * scan[:, None]), planes, light)
        for step in (-_STEP, 0.0, _STEP)
    )
    away, shade = (high - low) / (2 * _STEP)
    return Bend(
        away,
        (high[0] - 2 * middle[0] + low[0]) / (2 * _STEP**2),
        shade,
        np.exp(middle[1]),
        middle[0],
    )


def _seen(surface, rays, planes, light):
    """(2, n): distance from the sheet, and logarithm of the cosine of the light's incidence, of what rays see."""
    points, normals = surface(rays)
    away = (planes[:3] * points).sum(0) + planes[3]
    if light is None:
        return np.stack([away, 0 * away])
    towards = light[:, None] - points
    cosine = (towards * normals).sum(0) / np.sqrt((towards**2).sum(0))
    return np.stack([away, np.log(np.maximum(cosine, _STEEPEST))])


def weighting(ratio: np.ndarray) -> np.ndarray:
    """(n,) q of the fit whose pixels of height g (peak 1) weigh 1 / (1 + ratio g): 3/2 for 0, 0 for large ratios."""
    x = np.linspace(-5, 5, 201)
    g = np.exp(-x * x / 2)
    weight = g**2 / (1 + _RATIOS[:, None] * g)
    table = -(weight * (x**4 - 3 * x * x)).sum(1) / (weight * x * x).sum(1)
    return np.interp(ratio, _RATIOS, table)
