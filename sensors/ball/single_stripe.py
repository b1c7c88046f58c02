"""Choice among the balls that share one stripe, by the width of the laser's line on it.

A light plane cuts a ball of radius R in a circle of radius r. The same circle lies on a ball on the other side of the
plane, both sqrt(R^2 - r^2) away from it, and on balls of other radii. They turn their surface to the camera in other
ways, however, and where a surface is steeper the light plane makes a narrower or wider line
(`surface_line.SurfaceLine.width_square`). With ln(width^2 / expected^2) = offset + noise of the rows,
the offset N(0, 0.08^2) for all rows (the light plane's thickness changes with distance, a surface that lets light in
widens the line), the logarithm of the likelihoods' ratio is half the difference of their chi-squares.

A sphere of any radius R' >= r lies on the circle, too. The stated radius is a hypothesis that the widths test against
all of them (`unlike_spheres`), with the offset's sigma that the boards of the scanner's calibration show."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sensors.ball.result import OUTLIER, BallFit
from sensors.ball.solve import memory
from workbench.core.distributions import MEDIAN_TO_SIGMA

DETERMINED_MM = 0.1
"""1 sigma of the centre along any direction up to which a ball on few stripes counts as found."""
Widths = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(m, n) ln of the squared width of the line at chosen (n,) points over that expected on balls (m, 4), centre and
radius in mm; nan where a ball would not show the point, or clipped pixels leave the width to the model."""
LEAST_ARC = 20
"""Points of an arc from which on widths tell which ball it lies on."""
FEW_STRIPES = 3
"""Stripes up to which a ball has to be determined, and its lines as wide as on a ball, to count as found."""
_RADIUS_TOLERANCE, _CHANCE = (
    0.05,
    4.0,
)  # part of a known radius, and sigmas, by which that of the points may differ
_MAX_OUTLIER_SHARE = 0.5  # outliers, of the points used
_OFFSET = 0.08  # ln of width^2
_GRAIN = 5  # rows that a grain of speckle lasts at most: neighbours in it tell the same
_LEAST_SCATTER = 0.01
_BY_CHANCE = 0.05  # probability
_CLIPPED = 4.0  # sigmas beyond which rows count alike
_ODDS = 2 * np.log(1000)  # difference of chi-square
_UNLIKE = 9.0 + 2 * np.log(
    1e4
)  # chi-square of offset, slope and curvature beyond which no ball has these widths


_REFUSED_BY_CHANCE = 6.63  # 99 % of chi-square with 1 degree of freedom
_DETECTED = 14.9  # noncentrality that exceeds it with a probability of 90 %: (2.576 + 1.282)^2
_DETECTED_SHARE = 0.2  # of a radius: spheres that differ by more have to be distinguished
# of spheres' centres from the light plane, over the radius
_DISTANCES = np.linspace(-1.2, 1.2, 49)
_DENSER = 25  # distances about the best of them


@dataclass(frozen=True)
class Choice:
    """The most probable of some balls, `number` from 0, and `why` it is not certain, "" where it is."""

    number: int
    why: str


def most_probable_ball(ratios: np.ndarray) -> Choice:
    """The ball that the widths tell, by ratios (m, n) as `Widths` gives them."""
    offset = _medians(ratios)
    if not np.isfinite(offset).any():
        return Choice(0, f"{_SHARED}; {_NO_WIDTH}")
    scatters = [_scatter(row, middle) for row, middle in zip(ratios, offset)]
    scatter = max(min(scatters), _LEAST_SCATTER)
    variance = _GRAIN * scatter**2
    deviation = np.clip(ratios - offset[:, None], -_CLIPPED * scatter, _CLIPPED * scatter)
    deviation[np.isnan(deviation)] = _CLIPPED * scatter
    most_probable = int(np.argmin(scatters))
    independent = (
        _lasting(ratios[most_probable]) * scatter**2
        if np.isfinite(scatters[most_probable])
        else variance
    )
    square = _common(offset, ratios, independent) + (deviation**2).sum(1) / independent
    order = np.argsort(square)
    best = int(order[0])
    common = _common(offset, ratios, variance)
    if common[best] + _bent(deviation[best]) / variance > _UNLIKE:
        return Choice(best, "the line on it is not as wide as on a ball")
    if len(order) > 1 and square[order[1]] - square[best] < _ODDS:
        return Choice(best, f"{_SHARED}; the width of the line does not distinguish them")
    return Choice(best, "")


@dataclass(frozen=True)
class RadiusTest:
    """Test of a stated radius by the widths of one stripe: `why` they do not confirm it, "" where they do.

    `radii` (smallest, largest) mm of the spheres on the same circle that the widths admit at 99 %; `moves` mm, the
    farthest of their centres from that of the ball of the stated radius.
    """

    why: str
    radii: tuple[float, float] = (np.nan, np.nan)
    moves: float = np.nan

    @property
    def warning(self) -> str:
        """What the covariance of an accepted ball does not hold."""
        low, high = self.radii
        return (
            f"on a single stripe, the width of its line admits spheres of radius {low:.3g} to {high:.3g} mm, whose "
            f"centres are up to {self.moves:.2g} mm away: the sigmas hold for the stated radius only"
        )


def unlike_spheres(
    fit: BallFit, points: np.ndarray, widths: Callable[[np.ndarray], np.ndarray], scatter: float
) -> RadiusTest:
    """Whether the widths distinguish a ball of known radius from spheres of others on its circle.

    points (3, n) mm of the arc; widths: as `Widths`, of these points; scatter: 1 sigma of the offset. The stated radius
    is refused where another one explains the widths better by a chi-square that 1 % of right balls exceed (likelihood
    ratio, 1 degree of freedom). It has to be a test: a sphere whose radius is 20 % smaller or larger would be refused
    with a probability of 90 %, by the noncentrality that the expected widths of both give.
    """
    if points.shape[1] < LEAST_ARC:
        return RadiusTest(f"{_SHARED}; {_GRAZED}")
    circle = _Circle.of(fit, points)
    spheres = circle.spheres(fit.radius * _DISTANCES)
    ratios = widths(spheres)
    is_seen = np.isfinite(ratios[0])
    if is_seen.sum() < LEAST_ARC:
        return RadiusTest(f"{_SHARED}; {_NO_WIDTH}")
    stated = ratios[0, is_seen]
    row_sigma = max(_scatter(stated, np.median(stated)), _LEAST_SCATTER)
    variance = min(_memory(stated), _GRAIN) * row_sigma**2
    square = partial(_square, row_sigma=row_sigma, variance=variance, scatter=scatter)
    noncentrality = square(ratios[:, is_seen] - stated)
    fine_spheres = circle.spheres(
        _denser_distances(square(ratios[:, is_seen])[1:], fit.radius * _DISTANCES)
    )
    fine_square = square(widths(fine_spheres)[:, is_seen])
    excess = fine_square[0] - fine_square.min()
    admitted = fine_spheres[fine_square - fine_square.min() <= _REFUSED_BY_CHANCE]
    radii = (admitted[:, 3].min(), admitted[:, 3].max())
    moves = float(np.linalg.norm(admitted[:, :3] - fit.centre, axis=1).max())
    if excess > _REFUSED_BY_CHANCE:
        why = f"the line on it is as wide as on a sphere of radius {_range_text(radii)} mm"
        return RadiusTest(why, radii, moves)
    confusable_radii = spheres[noncentrality < _DETECTED, 3]
    if np.abs(confusable_radii / fit.radius - 1).max() <= _DETECTED_SHARE:
        return RadiusTest("", radii, moves)
    why = f"{NOT_DISTINGUISHED} of radius {_range_text(confusable_radii)} mm: scan more steps"
    return RadiusTest(why, radii, moves)


def _denser_distances(square: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Denser distances (k,) mm where the chi-square (m,) at distances (m,) mm, ascending, has its minimum."""
    is_near = np.flatnonzero(square - square.min() <= _REFUSED_BY_CHANCE)
    low, high = max(is_near[0] - 1, 0), min(is_near[-1] + 1, len(distances) - 1)
    return np.linspace(distances[low], distances[high], _DENSER)


@dataclass(frozen=True)
class _Circle:
    """Circle in which a light plane cuts a ball: the ball's `centre` (3,), the plane's unit `normal` (3,), their
    `distance` mm, and the circle's `radius_square` mm^2."""

    centre: np.ndarray
    normal: np.ndarray
    distance: float
    radius_square: float

    @classmethod
    def of(cls, fit: BallFit, points: np.ndarray) -> "_Circle":
        """That of points (3, n) on one stripe of a ball."""
        middle = points.mean(1)
        normal = np.linalg.svd(points - middle[:, None], full_matrices=False)[0][:, 2]
        distance = float(normal @ (fit.centre - middle))
        return cls(fit.centre, normal, distance, max(fit.radius**2 - distance**2, 0.0))

    def spheres(self, distances: np.ndarray) -> np.ndarray:
        """(1 + m, 4) centres and radii, mm, of spheres on the circle at distances (m,) mm from its plane.

        The ball itself comes first.
        """
        distances = np.r_[self.distance, distances]
        centres = self.centre + np.outer(distances - self.distance, self.normal)
        return np.column_stack([centres, np.sqrt(self.radius_square + distances**2)])


def _square(ratios: np.ndarray, row_sigma: float, variance: float, scatter: float) -> np.ndarray:
    """(m,) chi-square of ratios (m, n) whose rows differ by `variance` and share an offset of 1 sigma `scatter`."""
    offset = _medians(ratios)
    limit = _CLIPPED * row_sigma
    with np.errstate(invalid="ignore"):
        deviation = np.clip(ratios - offset[:, None], -limit, limit)
    deviation[np.isnan(deviation)] = limit
    common = offset**2 / (scatter**2 + variance / ratios.shape[1])
    return common + (deviation**2).sum(1) / variance


def _range_text(radii) -> str:
    return f"{min(radii):.3g} to {max(radii):.3g}"


NOT_DISTINGUISHED = "one stripe does not distinguish the ball from a sphere"
_GRAZED = "sight grazes nearly all of them, so that the width of the line says nothing"
_NO_WIDTH = (
    "the line is overexposed, so that its width is not known, or no ball would show these points"
)
_SHARED = "its points lie on a single stripe, which many balls share"


def _common(offset, ratios, variance):
    """(m,) chi-square of the offsets (m,), where `variance` of the ratios (m, n) lasts for one row."""
    return offset**2 / (_OFFSET**2 + variance / ratios.shape[1])


def _medians(ratios):
    """(m,) median of each row's finite values, infinite where most are not."""
    is_mostly_missing = np.isfinite(ratios).mean(1) < 0.5
    filled = np.where(is_mostly_missing[:, None], 0.0, ratios)
    return np.where(is_mostly_missing, np.inf, np.nanmedian(filled, axis=1))


def _scatter(row, middle) -> float:
    """1 sigma of the rows of one ball about a parabola along the stripe, robust."""
    if not np.isfinite(middle):
        return np.inf
    return MEDIAN_TO_SIGMA * float(np.median(np.abs(_without_parabola(row))))


def _without_parabola(row) -> np.ndarray:
    """(k,) finite values of a row less the parabola along the stripe that fits them."""
    seen = np.isfinite(row)
    place = np.linspace(-1, 1, len(row))[seen]
    return row[seen] - np.polyval(np.polyfit(place, row[seen], 2), place)


def _lasting(row) -> float:
    """Rows for which errors of the widths last, at most: 2 sigma above what their autocorrelation shows.

    The variance of an integrated autocorrelation time t of n values is t^2 2 (2 t + 1) / n (Madras & Sokal, Journal of
    Statistical Physics 50, 1988, with a window of t).
    """
    time, count = _memory(row), int(np.isfinite(row).sum())
    return min(time * (1 + 2 * np.sqrt(2 * (2 * time + 1) / count)), _GRAIN)


def _memory(row) -> float:
    """Rows for which errors of the widths last, by their autocorrelation."""
    residual = _without_parabola(row)
    limit = _CLIPPED * MEDIAN_TO_SIGMA * float(np.median(np.abs(residual)))
    return memory(np.clip(residual, -limit, limit))


def _bent(deviation: np.ndarray) -> float:
    """Part of the sum of squares that a slope and a curvature along the stripe explain."""
    place = np.linspace(-1, 1, len(deviation))
    basis = np.linalg.qr(np.stack([np.ones_like(place), place, place**2], axis=1))[0]
    return float(np.square(basis[:, 1:].T @ deviation).sum())


def centre_sigma(fit: BallFit) -> float:
    """mm, 1 sigma of a ball's centre along the direction that is known least.

    A form that the points follow moves it as errors do that all points share. A form that is as likely by chance is
    part of the noise, which the covariance holds.
    """
    count = int(fit.inliers.sum())
    form = np.nan_to_num(fit.form) if fit.form_probability < _BY_CHANCE else 0.0
    shared = 1 + count * (form / max(fit.rms, 1e-12)) ** 2
    largest = np.linalg.eigvalsh(fit.covariance[:3, :3])[-1]
    return float(np.sqrt(max(largest, 0.0) * shared))


def undetermined(fit: BallFit, with_form: bool = True) -> str:
    """Why a ball on a single stripe or few does not count as found, "" where it does.

    with_form: False for centres of the line that are not corrected for its curved surface yet, whose bias is a form.
    """
    noise_sigma = centre_sigma(replace(fit, form=0.0))
    sigma = centre_sigma(fit) if with_form else noise_sigma
    if sigma <= DETERMINED_MM:
        return ""
    form = ", with the form that its points follow" if sigma > noise_sigma else ""
    return (
        f"its few stripes determine its centre to {sigma:.2g} mm (1 sigma{form}), "
        f"expected {DETERMINED_MM:g} mm or less"
    )


def unlike_few(fit: BallFit, radius: float, stripe: np.ndarray, widths: Widths | None) -> str:
    """Why a fit to few of the stripes (n,) is no ball of the known radius (mm), "" where it is or has more stripes.

    Arcs of two objects make a ball of any radius, an arc and a bit of another one make a ball of this one. With widths,
    the form of the points does not count: who knows the line corrects its centres, and tests the corrected ones.
    """
    stripe_of_inliers = stripe[fit.inliers]
    if len(np.unique(stripe_of_inliers)) > FEW_STRIPES:
        return ""
    if abs(fit.radius - radius) > max(_RADIUS_TOLERANCE * radius, _CHANCE * float(fit.std[-1])):
        return f"its points lie on a ball of radius {fit.radius:.4g} mm"
    outlier_count = int((fit.reason == OUTLIER).sum())
    if outlier_count > _MAX_OUTLIER_SHARE * len(stripe_of_inliers):
        return (
            f"{outlier_count} points near its surface do not lie on it, {len(stripe_of_inliers)} do"
        )
    return undetermined(fit, widths is None) or _unlike_widths(fit, stripe, widths)


def _unlike_widths(fit: BallFit, stripe: np.ndarray, widths: Widths | None) -> str:
    """Why the lines of a fit are not those on a ball, "" where they are or where their widths are not known."""
    ball = np.append(fit.centre, fit.radius)[None]
    for label in np.unique(stripe[fit.inliers]) if widths is not None else ():
        place = np.flatnonzero(fit.inliers & (stripe == label))
        if len(place) >= LEAST_ARC and (why := most_probable_ball(widths(place, ball)).why):
            return why
    return ""
