"""Several balls in one scan, distinguished from table, posts and plates."""

from dataclasses import dataclass, replace

import numpy as np

from sensors.ball.arcs import Arcs, centres_of
from sensors.ball.fit import fit_ball
from sensors.ball.result import NOT_ON_BALL, BallFit
from sensors.ball.single_stripe import (
    LEAST_ARC,
    RadiusTest,
    Widths,
    most_probable_ball,
    undetermined,
    unlike_few,
    unlike_spheres,
)
from sensors.ball.votes import LEAST_POINTS, MOST_POINTS, ThinnedCloud
from sensors.stripe.surface_bias.surface_line import SMOOTH, UNKNOWN_SCATTER
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import symmetric_eigenvalues

# Where no radius is known, the smallest has this many spacings of points: the neighbours that make a normal then lie
# on a third of it.
_SMALLEST = 5
# Points of a stripe below which it does not tell where a ball is.
_LEAST_STRIPE = 5
# Points of a ball that was found are off its surface by up to this part of the radius.
_NARROW = 0.08
# Incidence of light and sight of points that are used where those of less determine no ball, rad.
_STEEPEST = np.deg2rad(75)
# Stripes among a point's neighbours below which they make no normal.
_FEW_STRIPES = 4
# Nothing is inside a solid ball; directions of its points spread two ways (a post's only one).
_INNER_RADIUS = 0.85
_INSIDE_SHARE = 0.1
_SPREAD = np.sin(np.deg2rad(4)) ** 2


def find_balls(
    points: np.ndarray,
    radii=None,
    *,
    radius_range: tuple[float, float] | None = None,
    sigma=None,
    view=None,
    at_limit=None,
    free: bool = False,
    form: float = 0.01,
    seed: int = 0,
    stripe=None,
    widths: Widths | None = None,
    width_scatter: float = UNKNOWN_SCATTER,
    refused: "list[Refusal] | None" = None,
    **options,
) -> list[BallFit]:
    """The balls in points (3, n) mm, or organised (3, H, W) with nan where nothing was seen; most points first.

    `radii` mm that occur (one or several), or `radius_range` (smallest, largest) mm where they are not known;
    with neither, from 5 times the points' spacing to 0.6 of the cloud's extent. `view` (3,) or (3, n)
    direction in which the sensor looks; without it the points are in the camera's frame. `at_limit` (n,)
    True for points at the limit of the field; of an organised scan these are the border's. `free`: fit
    the radius even where it is known. `form`: what of the RMS is not noise between neighbours, over the
    radius, above which a surface is no ball. `sigma` and `options` as in `fit_ball`. Each result speaks of all n
    points: `reason` is "elsewhere" for those of other surfaces. Deterministic for one seed; an
    empty list where there is no ball. Raises InputError where radii or shapes are not usable.
    `stripe` (n,) int light plane of each point: where few planes meet the points that no ball has yet, and radii are
    known, candidates come from the arcs of single stripes, which needs no neighbouring planes. `widths` of the lines
    tell balls that share a single stripe from one another; without them none is found there; `width_scatter`
    1 sigma of what all rows of an image have in common, see `LineShape`. With widths the caller
    corrects the centres of the lines, and then tests with `undetermined` whether few stripes determine the ball: their
    bias on a curved surface looks like a form of it. `refused` is given the
    candidates that are no balls, with the requirement that each fails: of those on the same points the best supported.

    Every point votes for the centre along its normal (for unknown radii, where its normal meets its
    neighbours': the ball pivot of Hough, US patent 3069654, in three dimensions); a peak of votes is
    a candidate, which geometric fits confirm or not.
    """
    points, at_limit = _flat(points, at_limit)
    present = np.flatnonzero(np.isfinite(points.sum(0)))
    if len(present) < LEAST_POINTS:
        return []
    rays = _rays(points, view)
    known = None if radii is None else sorted({float(r) for r in np.atleast_1d(radii)})
    cloud = ThinnedCloud(
        points[:, present], rays[:, present], _range(points[:, present], known, radius_range), seed
    )
    peaks = (
        [peak for radius in known for peak in cloud.of_radius(radius)]
        if known
        else cloud.of_range()
    )
    search = _Search(points, rays, at_limit, sigma, known, free, form, {**options, "seed": seed})
    search.stripe = None if stripe is None else np.asarray(stripe).ravel()
    search.widths, search.width_scatter = widths, width_scatter
    found = search.confirmed(cloud, peaks)
    if known and stripe is not None:
        found = search.with_arcs(cloud, found)
        if widths is not None:
            found = search.with_single_stripes(found)
    if refused is not None:
        refused += search.without_found(found)
    return found


def _flat(points, at_limit):
    points = np.asarray(points, float)
    if points.ndim not in (2, 3) or len(points) != 3:
        raise InputError(
            f"points: expected an array of shape (3, n) or (3, H, W), found {points.shape}; "
            "hand over one point a column"
        )
    if points.ndim == 3 and at_limit is None:
        at_limit = np.zeros(points.shape[1:], bool)
        at_limit[[0, -1]], at_limit[:, [0, -1]] = True, True
    return points.reshape(3, -1), None if at_limit is None else np.asarray(at_limit, bool).ravel()


def _rays(points, view):
    """(3, n) unit directions in which the sensor looks at each point."""
    rays = (
        points
        if view is None
        else np.broadcast_to(np.reshape(np.asarray(view, float), (3, -1)), points.shape)
    )
    return rays / np.maximum(np.linalg.norm(rays, axis=0), 1e-300)


def _range(points, known, radius_range):
    """Smallest and largest radius to look for, mm."""
    from scipy.spatial import cKDTree

    if known is not None and not 0 < known[0] <= known[-1] < np.inf:
        raise InputError(
            f"radii: expected positive lengths in mm, found {known}; measure the balls again"
        )
    if radius_range is not None and not 0 < radius_range[0] < radius_range[1] < np.inf:
        raise InputError(
            f"between: expected a smaller and a larger radius in mm, found {radius_range}; give both"
        )
    if known is not None or radius_range is not None:
        return (known[0], known[-1]) if known is not None else radius_range
    sample = np.random.default_rng(0).permutation(points.shape[1])[:MOST_POINTS]
    spacing = np.median(cKDTree(points[:, sample].T).query(points[:, sample[:2000]].T, 2)[0][:, 1])
    spacing *= np.sqrt(len(sample) / points.shape[1])  # points on surfaces
    return _SMALLEST * spacing, max(
        np.ptp(np.quantile(points, [0.01, 0.99], axis=1), axis=0).max() * 0.6, 30 * spacing
    )


@dataclass(frozen=True)
class Refusal:
    """A candidate that is no ball: `centre` (3,) and `radius` mm, number of points near its surface, and `why`.

    `is_fitted`: a ball fits its points, and fails another requirement.
    """

    centre: np.ndarray
    radius: float
    points: int
    why: str
    is_fitted: bool = False

    @classmethod
    def of_fit(cls, fit: BallFit, why: str) -> "Refusal":
        """A ball that is refused after its fit."""
        return cls(fit.centre, fit.radius, int(fit.inliers.sum()), why, True)

    @property
    def sentence(self) -> str:
        """The candidate and the requirement that it fails, in words."""
        place = ", ".join(f"{value:.1f}" for value in self.centre)
        return (
            f"a ball of radius {self.radius:.4g} mm at ({place}) mm with {self.points} points near its surface is "
            f"refused: {self.why}"
        )


@dataclass(frozen=True)
class BallStart:
    """Start of a fit: `centre` (3,) and `radius` mm, and the distances of its points, `rms` mm."""

    centre: np.ndarray
    radius: float
    rms: float = 0.0


class _Search:
    """Candidates against the whole cloud: each is fitted, judged, and its points are given to it."""

    def __init__(self, points, rays, at_limit, sigma, known, free, form, options):
        self.points, self.rays, self.at_limit, self.sigma = points, rays, at_limit, sigma
        self.known, self.free, self.form, self.options = known, free, form, options
        self.refused: list[Refusal] = []
        self.stripe: np.ndarray | None = None
        self.widths: Widths | None = None
        self.width_scatter = UNKNOWN_SCATTER

    def confirmed(self, cloud, peaks, fit_candidate=None, found=()) -> list[BallFit]:
        """Balls among the candidates and those `found` before, most points first; a point belongs to one ball only.

        fit_candidate: gives the ball at a candidate, `about_peak` where it is None.
        """
        found, unassigned = list(found), self.left(found)
        fit_candidate = fit_candidate or self.about_peak
        for _, centre, radius in sorted(peaks, key=lambda peak: -peak[0] / peak[2] ** 2):
            if any(np.linalg.norm(centre - ball.centre) < 0.5 * ball.radius for ball in found):
                continue
            ball = fit_candidate(cloud, centre, radius, unassigned)
            if ball is not None and all(
                np.linalg.norm(ball.centre - other.centre) > 0.5 * other.radius for other in found
            ):
                found.append(ball)
                unassigned &= ~ball.inliers
        return sorted(found, key=lambda ball: -int(ball.inliers.sum()))

    def left(self, found, reach: float = 0.0) -> np.ndarray:
        """(n,) bool: points on no ball of those found, and no nearer to its surface than `reach` of its radius."""
        unassigned = np.isfinite(self.points.sum(0))
        for ball in found:
            unassigned &= ~ball.inliers
            if reach:
                displacement = np.linalg.norm(self.points - ball.centre[:, None], axis=0)
                unassigned &= ~(np.abs(displacement - ball.radius) < reach * ball.radius)
        return unassigned

    def with_arcs(self, cloud, found) -> list[BallFit]:
        """With the balls that single stripes show among points of which neighbours hardly ever lie on other stripes."""
        unassigned = self.left(found, _NARROW)
        if found and not self._is_sparse(cloud, unassigned):
            return found
        arcs = Arcs(self.points[:, unassigned], self.stripe[unassigned])
        candidates = [candidate for radius in self.known for candidate in arcs.candidates(radius)]
        return self.confirmed(cloud, candidates, self.on_arcs, found)

    def _is_sparse(self, cloud, unassigned) -> bool:
        """Whether enough points that are `left` (n,) have neighbours on too few stripes for a normal."""
        present = np.flatnonzero(np.isfinite(self.points.sum(0)))[cloud.chosen]
        stripe_of_neighbours = np.sort(self.stripe[present][cloud.neighbours], axis=1)
        stripes = 1 + (np.diff(stripe_of_neighbours, axis=1) != 0).sum(1)
        return int((unassigned[present] & (stripes < _FEW_STRIPES)).sum()) >= LEAST_POINTS

    def without_found(self, found) -> "list[Refusal]":
        """Refused candidates on points that no ball has, of those on the same points the best supported."""
        unassigned = self.left(found, _NARROW)
        refused = []
        latest_first = list(self._supported(unassigned))[::-1]
        for ball, support in sorted(latest_first, key=lambda pair: -int(pair[1].sum())):
            if (support & unassigned).sum() >= LEAST_POINTS:
                refused.append(replace(ball, points=int(support.sum())))
                unassigned = unassigned & ~support
        if refused or found or not self.refused:
            return refused
        return [max(self.refused, key=lambda ball: ball.points)]

    def _supported(self, unassigned):
        """Each refused candidate with the points (n,) that are `left` near its surface."""
        for ball in self.refused:
            displacement = np.linalg.norm(self.points - ball.centre[:, None], axis=0)
            yield ball, unassigned & (np.abs(displacement - ball.radius) < _NARROW * ball.radius)

    def about_peak(self, cloud, centre, radius, unassigned) -> BallFit | None:
        """The ball at a peak of votes, None where there is none."""
        support = cloud.support_of(centre, radius)
        if len(support) < LEAST_POINTS:
            return self._refuse(centre, radius, len(support), "too few points face away from it")
        return self._refined_and_tested(cloud, cloud.points[:, support], centre, radius, unassigned)

    def on_arcs(self, cloud, centre, radius, unassigned) -> BallFit | None:
        """The ball at a candidate from arcs, None where there is none."""
        free = np.flatnonzero(unassigned)
        displacement = np.linalg.norm(self.points[:, free] - centre[:, None], axis=0)
        support = free[np.abs(displacement - radius) < _NARROW * radius]
        if len(support) < LEAST_POINTS:
            return self._refuse(centre, radius, len(support), "too few points lie near its surface")
        if alone := self._on_one_stripe(support):
            return self._refuse(centre, radius, len(support), alone)
        return self._refined_and_tested(cloud, self.points[:, support], centre, radius, unassigned)

    def with_single_stripes(self, found) -> list[BallFit]:
        """With the balls of known radius that single stripes show, where the widths of the line tell which it is."""
        unassigned = np.flatnonzero(self.left(found, _NARROW))
        found = list(found)
        for place in Arcs(self.points[:, unassigned], self.stripe[unassigned]).split(self.known[0]):
            if len(place) < LEAST_ARC:
                continue
            ball = self._on_arc(unassigned[place])
            if ball is not None and all(
                np.linalg.norm(ball.centre - other.centre) > 0.5 * other.radius for other in found
            ):
                found.append(ball)
        return sorted(found, key=lambda ball: -int(ball.inliers.sum()))

    def _on_arc(self, place) -> BallFit | None:
        """The ball that the points `place` (k,) of one stripe lie on, None where there is none or it is not certain."""
        is_on_arc = np.zeros(self.points.shape[1], bool)
        is_on_arc[place] = True
        balls = []
        why = "they lie on no circle of a ball"
        for radius in self.known:
            for centre in centres_of(self.points[:, place], radius):
                fit = self.fine(BallStart(centre, radius), radius, is_on_arc, _STEEPEST)
                if not fit:
                    why = fit.outcome
                elif all(
                    np.linalg.norm(fit.centre - other.centre) > 1e-3 * radius for other in balls
                ):
                    balls.append(fit)
        if not balls:
            return self._refuse(self.points[:, place].mean(1), self.known[0], len(place), why)
        choice = most_probable_ball(
            self.widths(place, np.array([[*fit.centre, fit.radius] for fit in balls]))
        )
        fit = balls[choice.number]
        if why := choice.why or undetermined(fit, with_form=False) or self._filled(fit):
            return self._refuse(fit.centre, fit.radius, len(place), why, True)
        test = self._unlike_spheres(fit, place)
        if test.why:
            return self._refuse(fit.centre, fit.radius, len(place), test.why, True)
        return fit.with_radius_note(test.warning)

    def _unlike_spheres(self, fit, place) -> RadiusTest:
        """Whether the widths at points `place` (k,) of one stripe confirm the known radius of a fit."""
        smooth = place[self._facing(fit, place) > SMOOTH]

        def ratios(spheres):
            return self.widths(smooth, spheres)

        return unlike_spheres(fit, self.points[:, smooth], ratios, self.width_scatter)

    def _facing(self, fit, place) -> np.ndarray:
        """(k,) cosine of the incidence of sight at points `place` (k,) of a ball."""
        outward = self.points[:, place] - fit.centre[:, None]
        return -(outward * self.rays[:, place]).sum(0) / fit.radius

    def _filled(self, fit) -> str:
        """Why a fit is no ball where points of the scan lie inside it, "" where they do not."""
        distance = np.linalg.norm(self.points - fit.centre[:, None], axis=0)
        inner_points = int((distance < _INNER_RADIUS * fit.radius).sum())
        if inner_points <= _INSIDE_SHARE * fit.inliers.sum():
            return ""
        return f"{inner_points} points lie inside it, as of a surface that is no ball"

    def _refined_and_tested(self, cloud, points, centre, radius, unassigned) -> BallFit | None:
        """A rough fit to some points (3, k), judged, and then the fine one."""
        known = radius if self.known else None
        rough = fit_ball(points, radius=known, start=np.append(centre, radius))
        why = rough.outcome if not rough else self.unlike(rough, cloud)
        if why:
            return self._refuse(centre, radius, points.shape[1], why)
        for incidence in (self.options.get("incidence"), _STEEPEST):
            fit = self.fine(rough, None if self.free else known, unassigned, incidence)
            if not fit and self.free and known is not None:
                # few stripes determine a centre, but no radius
                fit = self.fine(rough, known, unassigned, incidence)
            why = (
                fit.outcome if not fit else self.unlike(fit, cloud) or self.unlike_few(fit, radius)
            )
            if not why or incidence is None:
                break
        if not why:
            return fit
        return self._refuse(centre, radius, points.shape[1], why, bool(fit))

    def unlike_few(self, fit, radius) -> str:
        """Why a fit to points of one or few light planes is no ball of a known radius, "" for others."""
        if self.stripe is None:
            return ""
        alone = self._on_one_stripe(fit.inliers)
        if alone or not self.known:
            return alone
        return unlike_few(fit, radius, self.stripe, self.widths)

    def _on_one_stripe(self, chosen) -> str:
        """The same of chosen points."""
        count = np.unique(self.stripe[chosen], return_counts=True)[1]
        if count.sum() - count.max(initial=0) >= _LEAST_STRIPE:
            return ""
        return "its points lie on a single stripe, which many balls share"

    def _refuse(self, centre, radius, points, why, is_fitted=False) -> None:
        self.refused.append(Refusal(centre, radius, points, why, is_fitted))

    def fine(self, rough, radius, unassigned, incidence=None) -> BallFit:
        """Fit to all points near the rough ball; a result that speaks of the whole cloud. incidence: rad, of the points
        used."""
        box = np.flatnonzero(unassigned)
        reach = (1 + _NARROW) * rough.radius
        for axis, middle in zip(self.points, rough.centre):
            box = box[np.abs(axis[box] - middle) < reach]
        gap = np.abs(
            np.linalg.norm(self.points[:, box] - rough.centre[:, None], axis=0) - rough.radius
        )
        box = box[gap < max(_NARROW * rough.radius, 6 * rough.rms)]
        start = np.append(rough.centre, rough.radius if radius is None else radius)
        options = {
            name: value[..., box]
            if np.ndim(value) and np.shape(value)[-1] == self.points.shape[1]
            else value
            for name, value in {
                **self.options,
                "incidence": incidence,
                "sigma": self.sigma,
                "at_limit": self.at_limit,
            }.items()
        }
        fit = fit_ball(
            self.points[:, box], radius=radius, view=self.rays[:, box], start=start, **options
        )
        if not fit:
            return fit
        reason = np.full(self.points.shape[1], NOT_ON_BALL, np.uint8)
        residual = np.full(self.points.shape[1], np.nan)
        reason[box], residual[box] = fit.reason, fit.residual
        return replace(fit, reason=reason, residual=residual)

    def unlike(self, fit, cloud) -> str:
        """The requirement of a ball that a fit fails, "" for none: true to form, nothing inside, curved both ways."""
        displacement = cloud.points - fit.centre[:, None]
        distance = np.linalg.norm(displacement, axis=0)
        gap = distance - fit.radius
        shell = np.abs(gap) < _NARROW * fit.radius
        inner_points = int((distance < _INNER_RADIUS * fit.radius).sum())
        if shell.sum() < LEAST_POINTS:
            return f"{shell.sum()} points lie near its surface, expected {LEAST_POINTS}"
        if inner_points > _INSIDE_SHARE * shell.sum():
            return f"{inner_points} points lie inside it, as of a surface that is no ball"
        noise = np.median(np.abs(gap - gap[cloud.neighbours[:, 1]])[shell]) / 0.67449 / np.sqrt(2)
        spread = symmetric_eigenvalues(np.cov(displacement[:, shell] / distance[shell]))
        if not fit.rms**2 - noise**2 < (self.form * fit.radius) ** 2:
            return (
                f"its points are {fit.rms:.3g} mm RMS from it, more than {100 * self.form:g} % of its radius beyond "
                "noise"
            )
        if not spread[1] > _SPREAD:
            return "its points curve in one direction only, as on a post or a single stripe"
        return ""
