"""Where the fit of a ball or circle begins: spheres through a few points, half of which may be wrong."""

import numpy as np

_TRIES, _JUDGES, _BEST = 300, 2000, 8
_FIRST_JUDGES, _LEFT, _DRAWN = 250, 40, 10_000
# Less than half: with half of the points wrong, this share still lies on the ball.
_SHARE = 0.45
# A ball is at most this many times as large as the piece seen of it: beyond, it is a plane.
_LARGEST = 10.0


def start(
    points: np.ndarray, radius: float | None, random: np.random.Generator
) -> np.ndarray | None:
    """(d + 1,) centre and radius near the ball on which most of points (d, n) lie; None where there is none.

    Spheres through d + 1 random points each, judged by the distance within which nearly half of
    the points lie (least quantile of squares: Rousseeuw, J. Am. Stat. Assoc. 79, 1984); the best are
    fitted again to the half that is nearest. A known radius moves each sphere about its apex.
    """
    n = points.shape[1]
    points = points[:, random.permutation(n) if n <= _DRAWN else random.integers(0, n, _DRAWN)]
    middle = np.median(points, axis=1)
    size = float(np.median(np.linalg.norm(points - middle[:, None], axis=0))) or 1.0
    scaled = (points - middle[:, None]) / size
    judges = scaled[:, :_JUDGES]
    known = None if radius is None else radius / size
    found = _sensible(_through(scaled, random), scaled, known)
    if not found.shape[1]:
        return None
    found = found[:, np.argsort(_score(judges[:, :_FIRST_JUDGES], found))[:_LEFT]]
    best = found[:, np.argsort(_score(judges, found))[:_BEST]]
    again = np.stack([algebraic(_nearest(judges, one)) for one in best.T], axis=1)
    both = np.concatenate([best, _sensible(again, scaled, known)], axis=1)
    chosen = both[:, np.argmin(_score(judges, both))]
    return np.append(chosen[:-1] * size + middle, chosen[-1] * size if radius is None else radius)


def algebraic(points: np.ndarray) -> np.ndarray:
    """(d + 1,) centre and radius that minimise the sum of (|X - c|^2 - r^2)^2 over points (d, n).

    Kasa, IEEE Trans. Instrum. Meas. 25 (1976). A start only: the noise pulls it into the cap, by
    36 sigma^2 / R at 60 degrees.
    """
    middle = points.mean(1, keepdims=True)
    from_middle = points - middle
    square = (from_middle**2).sum(0)
    centre = np.linalg.lstsq(2 * from_middle @ from_middle.T, from_middle @ square, rcond=1e-14)[0]
    return np.append(centre + middle[:, 0], np.sqrt(square.mean() + centre @ centre))


def _through(points, random):
    """(d + 1, tries) spheres through d + 1 random points each."""
    d, n = points.shape
    chosen = points[:, random.integers(0, n, (_TRIES, d + 1))]
    first, rest = chosen[..., 0], chosen[..., 1:] - chosen[..., :1]
    matrix = 2 * rest.transpose(1, 2, 0)
    size = max(np.abs(matrix).max(initial=0.0), 1e-300)
    fine = (
        np.abs(np.linalg.det(matrix / size)) > 1e-12
    )  # four points in one plane determine no sphere
    centre = np.linalg.solve(matrix[fine], (rest**2).sum(0)[fine][..., None])[..., 0].T
    return np.concatenate([centre + first[:, fine], np.linalg.norm(centre, axis=0)[None]])


def _sensible(spheres, points, radius):
    """Those no larger than a ball can be; with a known radius, moved along the line from centre to points."""
    is_sphere = np.isfinite(spheres).all(0) & (spheres[-1] > 0)
    centres, radii = spheres[:-1, is_sphere], spheres[-1, is_sphere]
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
    """(m, n) distance of points (d, n) from spheres (d + 1, m), without sign."""
    square = (points**2).sum(0) - 2 * spheres[:-1].T @ points + (spheres[:-1] ** 2).sum(0)[:, None]
    return np.abs(np.sqrt(np.maximum(square, 0)) - spheres[-1][:, None])


def _score(points, spheres):
    place = int(_SHARE * points.shape[1])
    return np.partition(_distances(points, spheres), place, axis=1)[:, place]


def _nearest(points, sphere):
    distance = _distances(points, sphere[:, None])[0]
    return points[:, np.argsort(distance)[: max(len(sphere) + 1, int(_SHARE * len(distance)))]]
