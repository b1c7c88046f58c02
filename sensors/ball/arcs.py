"""Candidates for balls of known radius from the arcs of single stripes, where stripes are dense and steps are sparse.

A light plane cuts a ball of radius R in a circle of radius r <= R about c. The centre is then c + n sqrt(R^2 - r^2) or
c - n sqrt(R^2 - r^2), n the plane's normal. Normals from neighbouring points, which other searches use, do not exist
where the nearest neighbours of a point all lie on its own stripe.
"""

import warnings
from dataclasses import dataclass

import numpy as np

_FEWEST = 10  # points of an arc
_GAP = 1 / 4  # of the radius: a larger gap between neighbours along a stripe ends an arc
_MAX_DISTANCE = 0.06  # of the radius: points nearer to a candidate's surface support it
_DIFFERENT = 0.3  # of the radius: candidates nearer to one another are one
_MOST_ARCS = 400
_TRIALS = 60
_SCATTER = 0.02  # of the radius, within which points belong to a circle


@dataclass(frozen=True)
class Arcs:
    """Stripes of a scan: `points` (3, n) mm, `stripe` (n,) label of the light plane of each point."""

    points: np.ndarray
    stripe: np.ndarray

    def candidates(self, radius: float, max_count: int = 8) -> list[tuple[int, np.ndarray, float]]:
        """(support, centre (3,) mm, radius) of balls of one radius (mm), the best supported first.

        support: number of points near the surface.
        """
        arcs = [self.points[:, place] for place in self.split(radius)]
        centres = [centre for arc in arcs for centre in centres_of(arc, radius)]
        if not centres:
            return []
        support = [self._support(centre, radius) for centre in centres]
        found: list[tuple[int, np.ndarray, float]] = []
        for k in np.argsort(support)[::-1]:
            centre = centres[k]
            if support[k] < _FEWEST or len(found) == max_count:
                break
            if all(np.linalg.norm(centre - ball[1]) > _DIFFERENT * radius for ball in found):
                found.append((support[k], centre, radius))
        return found

    def _support(self, centre: np.ndarray, radius: float) -> int:
        distance = np.linalg.norm(self.points - centre[:, None], axis=0)
        return int((np.abs(distance - radius) < _MAX_DISTANCE * radius).sum())

    def split(self, radius: float) -> list[np.ndarray]:
        """Numbers (k,) of the points of each arc in their order along it, longest arcs first.

        An arc is a stripe, cut where neighbours along it are far from one another.
        """
        arcs = []
        for label in np.unique(self.stripe):
            place = np.flatnonzero(self.stripe == label)
            points_of_stripe = self.points[:, place]
            order = _along_stripe(points_of_stripe)
            gaps = _steps(points_of_stripe[:, order]) > _GAP * radius
            pieces = np.split(place[order], np.flatnonzero(gaps) + 1)
            arcs += [part for part in pieces if len(part) >= _FEWEST]
        arcs.sort(key=lambda part: -len(part))
        return arcs[:_MOST_ARCS]


def _along_stripe(points: np.ndarray) -> np.ndarray:
    """(k,) order of the points (3, k) of one stripe along it: as they are given, or along their main axis.

    The shorter way counts. Scans give points row after row of the image. In space a floor behind a ball lies next to
    the ball's steep ends, so that an order along an axis mixes both and cuts the ends off.
    """
    given = np.arange(points.shape[1])
    axes = np.linalg.svd(points - points.mean(1, keepdims=True), full_matrices=False)[0]
    sorted_places = np.argsort(axes[:, 0] @ points)
    return min(given, sorted_places, key=lambda order: float(_steps(points[:, order]).sum()))


def _steps(points: np.ndarray) -> np.ndarray:
    """(k - 1,) distances between successive points (3, k)."""
    return np.linalg.norm(np.diff(points, axis=1), axis=0)


def centres_of(arc: np.ndarray, radius: float) -> list[np.ndarray]:
    """Both centres (3,) of a ball whose surface the arc (3, k) lies on; none where it is no arc of such a ball."""
    middle = arc.mean(1, keepdims=True)
    directions, _, _ = np.linalg.svd(arc - middle, full_matrices=False)
    flat = directions[:, :2].T @ (arc - middle)
    circle = _circle(flat, radius)
    if circle is None:
        return []
    place, size = circle
    centre = middle[:, 0] + directions[:, :2] @ place
    offset = np.sqrt(max(radius**2 - size**2, 0.0))
    normal = directions[:, 2]
    return [centre + offset * normal, centre - offset * normal]


def _circle(flat: np.ndarray, radius: float) -> tuple[np.ndarray, float] | None:
    """Centre (2,) and radius of the circle through most of the points (2, k), by RANSAC; None where there is none."""
    from skimage.measure import CircleModel, ransac

    def is_possible(model, *data) -> bool:
        return 0.1 * radius < _circle_of(model)[1] < 1.1 * radius

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a straight stripe makes no circle: that is an answer here
        model, inliers = ransac(
            flat.T,
            CircleModel,
            min_samples=3,
            residual_threshold=_SCATTER * radius,
            is_model_valid=is_possible,
            max_trials=_TRIALS,
            rng=0,
        )
    if model is None or inliers is None or inliers.sum() < _FEWEST:
        return None
    place, size = _circle_of(model)
    return place, min(size, radius)


def _circle_of(model) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of a scikit-image CircleModel; its attribute `params` ends with version 2.2."""
    if hasattr(model, "center"):
        return np.asarray(model.center, float), float(model.radius)
    return np.asarray(model.params[:2], float), float(model.params[2])
