"""Start of the fit of a ball: spheres through a few points, half of which may be wrong."""

import numpy as np

from sensors.ball.solve import median

_TRIES = 300
_SCORING_POINTS = 2000
_BEST = 8
_FIRST_SCORING_POINTS = 250
_LEFT = 40
_DRAWN = 10_000
# Less than half: with half of the points wrong, this share still lies on the ball.
_SHARE = 0.45
# A ball is at most this many times as large as the piece seen of it: beyond, it is a plane.
_LARGEST = 10.0


def start(
    points: np.ndarray, radius: float | None, random: np.random.Generator
) -> np.ndarray | None:
    """(4,) centre and radius near the ball on which most of points (3, n) lie; None where there is none.

    Spheres through d + 1 random points each, judged by the distance within which nearly half of
    the points lie (least quantile of squares: Rousseeuw, J. Am. Stat. Assoc. 79, 1984); the best are
    fitted again to the half that is nearest. A known radius moves each sphere about its apex.
    """
    n = points.shape[1]
    drawn = random.permutation(n) if n <= _DRAWN else random.integers(0, n, _DRAWN)
    points = points.take(drawn, 1)
    middle = median(points)
    scaled = points - middle[:, None]
    size = float(median(np.sqrt(np.square(scaled).sum(0)))) or 1.0
    scaled /= size
    scoring_points = scaled[:, :_SCORING_POINTS]
    known = None if radius is None else radius / size
    found = _sensible(_through(scaled, random), scaled, known)
    if not found.shape[1]:
        return None
    found = found[:, np.argsort(_score(scoring_points[:, :_FIRST_SCORING_POINTS], found))[:_LEFT]]
    best = found[:, np.argsort(_score(scoring_points, found))[:_BEST]]
    refitted = algebraic(_nearest(scoring_points, best)).T
    all_candidates = np.concatenate([best, _sensible(refitted, scaled, known)], axis=1)
    chosen = all_candidates[:, np.argmin(_score(scoring_points, all_candidates))]
    return np.append(chosen[:-1] * size + middle, chosen[-1] * size if radius is None else radius)


def algebraic(points: np.ndarray) -> np.ndarray:
    """(..., 4) centre and radius that minimise the sum of (|X - c|^2 - r^2)^2 over points (..., 3, n).

    Kasa, IEEE Trans. Instrum. Meas. 25 (1976). A start only: the noise pulls it into the cap, by
    36 sigma^2 / R at 60 degrees.
    """
    middle = points.mean(-1, keepdims=True)
    from_middle = points - middle
    square = (from_middle**2).sum(-2)
    moments = np.swapaxes(from_middle, -1, -2)
    right = square[..., None, :] @ moments
    centre = (right @ np.linalg.pinv(2 * from_middle @ moments, rcond=1e-14))[..., 0, :]
    radius = np.sqrt(square.mean(-1) + (centre**2).sum(-1))
    return np.concatenate([centre + middle[..., 0], radius[..., None]], axis=-1)


def _through(points, random):
    """(d + 1, tries) spheres through d + 1 random points each."""
    d, n = points.shape
    chosen = points[:, random.integers(0, n, (_TRIES, d + 1))]
    first = chosen[..., 0]
    differences = chosen[..., 1:] - chosen[..., :1]
    matrix = 2 * differences.transpose(1, 2, 0)
    size = max(np.abs(matrix).max(initial=0.0), 1e-300)
    fine = (
        np.abs(np.linalg.det(matrix / size)) > 1e-12
    )  # four points in one plane determine no sphere
    centre = np.linalg.solve(matrix[fine], (differences**2).sum(0)[fine][..., None])[..., 0].T
    return np.concatenate([centre + first[:, fine], np.linalg.norm(centre, axis=0)[None]])


def _sensible(spheres, points, radius):
    """Those no larger than a ball can be; with a known radius, moved along the line from centre to points."""
    is_sphere = np.isfinite(spheres).all(0) & (spheres[-1] > 0)
    centres = spheres[:-1, is_sphere]
    radii = spheres[-1, is_sphere]
    if radius is None:
        is_small = radii < _LARGEST * np.abs(points).max()
        return np.concatenate([centres, radii[None]])[:, is_small]
    inward = centres - np.median(points, axis=1)[:, None]
    inward /= np.maximum(np.linalg.norm(inward, axis=0), 1e-300)
    # the point of the surface nearest to the points stays; the ball lies on either side of it
    apex = centres - radii * inward
    moved = np.concatenate([apex + radius * inward, apex - radius * inward], axis=1)
    return np.concatenate([moved, np.full((1, moved.shape[1]), radius)])


def _distances(points, spheres):
    """(m, n) distance of points (3, n) from spheres (d + 1, m), without sign."""
    square = (-2 * spheres[:-1]).T @ points
    square += (points**2).sum(0)
    square += (spheres[:-1] ** 2).sum(0)[:, None]
    np.sqrt(np.maximum(square, 0, out=square), out=square)
    square -= spheres[-1][:, None]
    return np.abs(square, out=square)


def _score(points, spheres):
    place = int(_SHARE * points.shape[1])
    distance = _distances(points, spheres)
    distance.partition(place, axis=1)
    return distance[:, place]


def _nearest(points, spheres):
    """(m, d, k) the points (3, n) that are nearest to each of some spheres (d + 1, m)."""
    distance = _distances(points, spheres)
    n = points.shape[1]
    count = min(max(len(spheres), int(_SHARE * n)), n)
    nearest = np.argpartition(distance, count - 1, axis=1)[:, :count]
    return points[:, nearest].transpose(1, 0, 2)
