"""Bias of the centre of a laser line on a curved or tilted surface, whose stripe is asymmetric.

Across the stripe the light is exp(-f^2 / (2 s^2)) cos(incidence), f the distance from the light plane's
middle, s the light plane's 1 sigma. Along the scan line, v px from where f = 0,

    f = f1 v + f2 v^2,   ln cos(incidence) = const + l v,

so that to first order the light is g(v) (1 + l v - (f2 / f1) v^3 / a^2), a = s / f1 px and g the
Gaussian of 1 sigma a. Blur to the width w multiplies the Hermite polynomial of order n by (a / w)^n;
the fit of a Gaussian to what is left finds its centre off by

    c = a^2 (l - (f2 / f1) (3 - q a^2 / w^2)),

q = 3/2 where all pixels count alike and 0 where they count by their photons. On a flat board f2 is perspective's: its
nearer part is seen larger.

Blur acts along the line too. Where the line's course is c(r) over rows r (slope c', curvature c''), a row receives
light of its neighbours, from r + d with weights of variance b^2 (the blur's, in px^2). With A the light across the line
(its peak times its width a), the mean of that light is off by b^2 (c''/2 + c' A'/A), and its third central moment is
m = 3 b^2 (c' (a^2)' + c'^2 c'' b^2). Of a Gram-Charlier series with that moment, the fit takes q m / (6 w^2) off:

    c = b^2 (c''/2 + c' A'/A) - q m / (6 w^2).

On a ball of radius R this moves points by some b^2 / 2R across the surface, always outwards.
"""

from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.model import Camera
from workbench.core.least_squares.linear_algebra import inverse_positive

_STEP = 0.5  # px, of the difference quotients; a ball's radius is some hundred px, a board wider
_STEEPEST = 0.1  # cosine of the light's incidence below which nothing is lit
SMOOTH = 0.5
"""Cosine of incidence, of light and of sight, from which on a width follows the slope alone. Where incidence grazes
more, the silhouette or the shadow cuts the line, which is as wide as these let it be."""
UNKNOWN_SCATTER = 0.08
"""1 sigma of ln(width^2 / expected^2) of an image where boards do not tell it: the light plane's thickness changes with
distance, a surface that lets light in widens the line."""
_RATIOS = np.geomspace(1e-2, 1e3, 26)
_FEWEST_WIDTHS = 20
_REWEIGHTED = 12
_GRAIN = 5  # rows that a grain of speckle lasts at most: neighbours in it tell the same
_KNOWN_TO = 0.3  # relative, of the squared widths on other surfaces: they change with distance
_NO_WIDER = 0.01  # relative deviation of width^2 below which all lines count alike


@dataclass(frozen=True)
class SurfaceLine:
    """A surface's part in each of n stripe points: `slope` f1 (n,) mm/px, `bend` f2 (n,) mm/px^2, `shade` l (n,) 1/px;
    `incidence_cosine` (n,) cosine of the light's incidence, 1 where it is unknown where the light comes from; `facing`
    (n,) cosine between surface normal and line of sight; `offset` (n,) mm from the middle of the light plane. Along the
    line: `tilt` c' (n,), `curve` c'' (n,) 1/px, `widening` (n,) 1/px derivative of ln a and `brightening` (n,) 1/px of
    the logarithm of that cosine.
    """

    slope: np.ndarray
    bend: np.ndarray
    shade: np.ndarray
    incidence_cosine: np.ndarray
    facing: np.ndarray
    offset: np.ndarray
    tilt: np.ndarray
    curve: np.ndarray
    widening: np.ndarray
    brightening: np.ndarray

    def centre_bias(self, line: "LineShape", width: np.ndarray, ratio: np.ndarray) -> np.ndarray:
        """(n,) px bias of the centres of lines of `width` (n,) px along the scan line.

        ratio (n,): photon variance at the peak over that next to the line.
        """
        square = (line.plane_width_mm / self.slope) ** 2
        fitted = weighting(ratio)
        counted = fitted * np.minimum(square / width**2, 1.0)
        scan_bias = square * (self.shade - self.bend / self.slope * (3 - counted))
        return scan_bias + self._blur_along_line(line.blur_px**2, square, fitted / width**2)

    def width_square(self, line: "LineShape") -> np.ndarray:
        """(n,) px^2 of the lines' widths: (plane width / slope)^2 + blur^2 (1 + tilt^2)."""
        return np.array([line.plane_width_mm, line.blur_px]) ** 2 @ self._by_shape

    @property
    def on_light_plane(self) -> "SurfaceLine":
        """The same, with `slope` where the light plane's middle meets the surface; nan where it does not.

        With f = offset + f1 v + f2 v^2 the slope at f = 0 is sqrt(f1^2 - 4 f2 offset). The centre of a line is off by
        noise. Near the edge of a ball its slope changes so fast that the noise would be one of the expected width.
        """
        square = self.slope**2 - 4 * self.bend * self.offset
        with np.errstate(invalid="ignore"):
            return replace(self, slope=np.copysign(np.sqrt(square), self.slope), offset=0 * square)

    @property
    def _by_shape(self) -> np.ndarray:
        """(2, n) derivative of a squared width by those of the light plane and of the blur."""
        return np.stack([self.slope**-2, 1 + self.tilt**2])

    def _blur_along_line(
        self, blur: np.ndarray, square: np.ndarray, counted: np.ndarray
    ) -> np.ndarray:
        """(n,) px by blur of the variance `blur` (px^2) along the line; `square` a^2, `counted` q / w^2."""
        mean = blur * (self.curve / 2 + self.tilt * (self.widening + self.brightening))
        moment = self.tilt * 2 * square * self.widening + self.tilt**2 * self.curve * blur
        return mean - counted * blur * moment / 2

    def line_shape(self, width: np.ndarray) -> "LineShape":
        """Width of the light plane and blur from widths (n,) px of the lines alone, see `fitted_line`."""
        return self.fitted_line(width)[0]

    def fitted_line(
        self, width: np.ndarray, known: "LineShape | None" = None
    ) -> "tuple[LineShape, np.ndarray]":
        """Width of the light plane and blur from widths (n,) px of the lines, see `width_square`; and the covariance
        (2, 2) of their squares, mm^2 and px^2.

        Least absolute deviations of width^2 relative to itself, by reweighting, at places that neither light nor sight
        graze. known: the line on other surfaces; its squares are a prior, since few widths, or alike ones, do not
        distinguish light plane and blur. Zero where neither says anything.
        """
        square = np.asarray(width, float) ** 2
        shape = self._by_shape
        usable = np.isfinite(shape).all(0) & np.isfinite(square) & (square > 0)
        usable &= (self.incidence_cosine > SMOOTH) & (self.facing > SMOOTH)
        if usable.sum() < _FEWEST_WIDTHS:
            if known is None:
                return LineShape(0.0, 0.0), np.zeros((2, 2))
            return known, np.diag((_KNOWN_TO * known.squares) ** 2)
        relative = shape[:, usable] / square[usable]
        precision = np.zeros(2) if known is None else (_KNOWN_TO * known.squares) ** -2.0
        centre = np.zeros(2) if known is None else known.squares
        found = np.zeros(2)
        weight = np.ones(usable.sum())
        for _ in range(_REWEIGHTED):
            # scale of Laplace's distribution; neighbours in a grain tell the same
            prior_precision = precision * _GRAIN / weight.mean()
            found = _nonnegative(relative, weight, prior_precision, centre)
            weight = 1 / np.maximum(np.abs(found @ relative - 1), _NO_WIDER)
        information = relative @ relative.T * weight.mean() ** 2 / _GRAIN + np.diag(precision)
        return LineShape(*np.sqrt(found).tolist()), inverse_positive(information)


@dataclass(frozen=True)
class LineShape:
    """Laser line: `plane_width_mm` 1 sigma of the light plane; `blur_px` 1 sigma of the blur, pixel included.

    `scatter`: 1 sigma of ln(width^2 / expected^2) that all rows of an image have in common.
    """

    plane_width_mm: float
    blur_px: float
    scatter: float = UNKNOWN_SCATTER

    @property
    def is_scatter_known(self) -> bool:
        """Whether boards show the scatter."""
        return self.scatter != UNKNOWN_SCATTER

    @property
    def squares(self) -> np.ndarray:
        """(2,) of both, none below a thousandth."""
        return np.maximum(np.array([self.plane_width_mm, self.blur_px]) ** 2, 1e-6)


def _nonnegative(shape, weight, precision, centre) -> np.ndarray:
    """(2,) weighted least squares of found @ shape = 1 without negative numbers; shape (2, n), weight (n,), and a prior
    of `precision` (2,) about `centre` (2,)."""
    from scipy.optimize import nnls

    root, strong = np.sqrt(weight), np.sqrt(precision)
    rows = np.vstack([(shape * root).T, np.diag(strong)])
    return nnls(rows, np.concatenate([root, strong * centre]))[0]


def line_on_ball(
    camera: Camera,
    centre: np.ndarray,
    radius: float,
    pixels: np.ndarray,
    planes: np.ndarray,
    scan: np.ndarray,
    light: np.ndarray | None = None,
) -> SurfaceLine:
    """Change of the light plane and its light along the scan line at pixels (2, n) on a ball.

    centre (3,) and radius mm in the camera frame; planes (4, n) of the points; scan (2,) unit vector;
    light (3,) mm where the light comes from, None where that is unknown: then `shade` is 0. nan off the ball.
    """

    def surface(rays):
        axial = centre @ rays
        with np.errstate(invalid="ignore"):
            points = rays * (
                axial - np.sqrt(radius**2 - ((rays * axial - centre[:, None]) ** 2).sum(0))
            )
        return points, (points - centre[:, None]) / radius

    return _bend(camera, surface, pixels, planes, scan, light)


def line_on_boards(
    camera: Camera,
    normals: np.ndarray,
    heights: np.ndarray,
    pixels: np.ndarray,
    planes: np.ndarray,
    scan: np.ndarray,
    light: np.ndarray | None = None,
) -> SurfaceLine:
    """As `line_on_ball`, of points on flat boards n.X = h: unit normals (3, n) and heights (n,) mm, camera frame."""
    side = np.sign((normals * (0 if light is None else light[:, None])).sum(0) - heights)

    def surface(rays):
        return rays * (heights / (normals * rays).sum(0)), normals * side

    return _bend(camera, surface, pixels, planes, scan, light)


def _bend(camera, surface, pixels, planes, scan, light):
    """Difference quotients over the 3 x 3 places (scan line, line) about each pixel."""
    line_axis = np.array([scan[1], scan[0]])

    def at(scan_steps, offset):
        places = pixels + _STEP * (scan_steps * scan + offset * line_axis)[:, None]
        return _seen(surface, camera.rays(places), planes, light)

    middle = at(0, 0)
    low, high, before, after = at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    mixed = at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)
    by_scan = (high - low) / (2 * _STEP)
    by_line = (after - before) / (2 * _STEP)
    second, second_along_line = (
        (ends - 2 * middle)[0] / _STEP**2 for ends in (high + low, after + before)
    )
    slope = by_scan[0]
    crossed = mixed[0] / (4 * _STEP**2)
    tilt = -by_line[0] / slope
    return SurfaceLine(
        slope,
        second / 2,
        by_scan[1],
        np.exp(middle[1]),
        middle[2],
        middle[0],
        tilt,
        -(second_along_line + 2 * crossed * tilt + second * tilt**2) / slope,
        -(crossed + second * tilt) / slope,
        by_line[1] + by_scan[1] * tilt,
    )


def _seen(surface, rays, planes, light):
    """(3, n) of what rays see: distance from the light plane, logarithm of the cosine of the light's incidence, and
    cosine of the incidence of sight."""
    points, normals = surface(rays)
    distance = (planes[:3] * points).sum(0) + planes[3]
    facing = -(points * normals).sum(0) / np.sqrt((points**2).sum(0))
    if light is None:
        return np.stack([distance, 0 * distance, facing])
    to_light = light[:, None] - points
    cosine = (to_light * normals).sum(0) / np.sqrt((to_light**2).sum(0))
    return np.stack([distance, np.log(np.maximum(cosine, _STEEPEST)), facing])


def weighting(ratio: np.ndarray) -> np.ndarray:
    """(n,) q of the fit whose pixels of height g (peak 1) weigh 1 / (1 + ratio g): 3/2 for 0, 0 for large ratios."""
    x = np.linspace(-5, 5, 201)
    g = np.exp(-x * x / 2)
    weight = g**2 / (1 + _RATIOS[:, None] * g)
    table = -(weight * (x**4 - 3 * x * x)).sum(1) / (weight * x * x).sum(1)
    return np.interp(ratio, _RATIOS, table)
