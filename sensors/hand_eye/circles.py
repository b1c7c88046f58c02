"""Circles in the profiles of a ball: which points lie on the ball, where the circle is, how noisy it is.

Everything here sees one profile at a time and knows nothing of the robot: what is trimmed, is
trimmed for what the profiler did. All profiles are fitted together, as sums by label.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.errors import InputError
from workbench.core.profiler_start import algebraic_circles, solved_by_label

_TRIPLES = 1500  # at 40 % of points on the ball 6 % of triples are good: some 90 of them
_STEPS = 30
_BINS = 24  # of the arc, for the noise along it
_CELL_RAD = 2 * np.pi / 96  # over which the noise of glancing incidence grows
_LEAST_POINTS = 4  # of a cell whose noise counts
_POINTS_OF_CELL = 8  # their RMS is twice the true one by chance in 1 of 10,000 cells
_SIGMAS = 3.5  # beyond it lies 1 point in 2000 of a normal distribution
_NOISY = 2.0  # an end that is this much noisier than the middle is glancing incidence or an edge
_FEWEST = 10


@dataclass(frozen=True)
class Circles:
    """One circle a profile: `centre` (2, P) x and z mm, `radius` (P,) mm, `rms` (P,) mm of its
    points' distances; `used` (n,) True where a point lies on the ball; `why` sentences on points
    without use."""

    centre: np.ndarray
    radius: np.ndarray
    rms: np.ndarray
    used: np.ndarray
    why: tuple[str, ...]


def find_circles(
    flat: np.ndarray, label: np.ndarray, names: Sequence[str], largest: float | None = None
) -> Circles:
    """Circles of profiles `flat` (2, n) mm with profile numbers `label` (n,) from 0.

    names: of the profiles, one a number, for sentences. largest: radius of the ball, where known; no section is
    larger. Consensus of three points
    (Fischler & Bolles, CACM 24 (1981)) at a width taken from the point-to-point noise, then the
    geometric fit, trimmed at 3.5 sigma and at ends that are twice as noisy as the middle.
    InputError where a profile holds fewer than ten points on a circle.
    """
    count = len(names)
    noise = _noise(flat, label)
    used = np.concatenate(
        [_consensus(flat[:, label == k], noise, largest, names[k]) for k in range(count)]
    )
    order = np.argsort(label, kind="stable")
    used = used[np.argsort(order, kind="stable")]
    for _ in range(_STEPS):
        centre, radius = fit_circles(flat, label, used, names)
        gap = _gaps(flat, label, centre, radius)
        is_inlier = _within_robust_spread(gap, label, used, count) & ~_ragged_ends(
            flat, label, used, centre, gap, count
        )
        if (is_inlier == used).all():
            break
        used = is_inlier
    square = np.bincount(label[used], gap[used] ** 2, count)
    number = np.bincount(label[used], minlength=count)
    return Circles(
        centre,
        radius,
        np.sqrt(square / np.maximum(number - 3, 1)),
        used,
        _words(label, used, names),
    )


def fit_circles(flat, label, used, names) -> tuple[np.ndarray, np.ndarray]:
    """Centres (2, P) and radii (P,) that minimise the sum of squared distances, by Gauss-Newton.

    names (P): of the profiles, for sentences. Started from Kasa's algebraic fit (IEEE Trans. Instrum. Meas. 25 (1976)).
    """
    points = flat[:, used]
    profile = label[used]
    count = len(names)
    _refuse_too_few(profile, names)
    *centre, radius = algebraic_circles(points, profile, count)
    centre = np.stack(centre)
    for _ in range(_STEPS):
        from_centre = points - centre[:, profile]
        length = np.hypot(*from_centre)
        radial = from_centre / length
        gap = length - radius[profile]
        step = solved_by_label([*radial, np.ones_like(gap)], gap, profile, count).T
        centre = centre + step[:2]
        radius = radius + step[2]
        if np.abs(step).max() < 1e-10:
            break
    return centre, radius


def _refuse_too_few(profile: np.ndarray, names) -> None:
    """Raise InputError where a profile has too few points for a circle."""
    number = np.bincount(profile, minlength=len(names))
    smallest = int(np.argmin(number))
    if number[smallest] < _FEWEST:
        raise InputError(
            f"{names[smallest]}: expected at least {_FEWEST} points on one circle, found {number[smallest]}; "
            "take the profile out or aim at the ball"
        )


def _gaps(flat, label, centre, radius):
    return np.hypot(*(flat - centre[:, label])) - radius[label]


def _noise(flat, label):
    """mm, from the distances of points from the line through their neighbours: the shape is smooth, the noise is not.

    In the order of x, at whatever distances. The median over profiles: a profile full of clutter does not set it.
    """
    order = np.lexsort((flat[0], label))
    (x, z), label = flat[:, order], label[order]
    width = x[2:] - x[:-2]
    is_same_profile = (label[2:] == label[:-2]) & (width > 0)
    share = np.divide(x[1:-1] - x[:-2], width, out=np.zeros_like(width), where=is_same_profile)
    bend = z[1:-1] - (1 - share) * z[:-2] - share * z[2:]
    bend = (bend / np.sqrt(1 + (1 - share) ** 2 + share**2))[is_same_profile]
    profile = label[2:][is_same_profile]
    spreads = [MEDIAN_TO_SIGMA * np.median(np.abs(bend[profile == k])) for k in np.unique(profile)]
    return max(float(np.median(spreads)), 1e-4) if spreads else 1e-4


def _consensus(flat, noise, largest, name):
    """(n,) True for the points of one profile within 6 noises of the circle that has most of them."""
    if flat.shape[1] < _FEWEST:
        raise InputError(
            f"{name}: expected at least {_FEWEST} points, found {flat.shape[1]}; "
            "take the profile out or aim at the ball"
        )
    draw = np.random.default_rng(0).integers(flat.shape[1], size=(3, _TRIPLES))
    centre, radius = _through(*(flat[:, d] for d in draw))
    biggest = 3 * np.ptp(flat, axis=1).max() if largest is None else largest * 1.02 + 4 * noise
    fair = np.isfinite(radius) & (radius < biggest)
    if not fair.any():
        raise InputError(
            f"{name}: expected an arc of a ball, found no circle smaller than {biggest:.4g} mm; "
            "check the radius or take the profile out"
        )
    centre = centre[:, fair]
    radius = radius[fair]
    thin = flat[:, :: max(flat.shape[1] // 400, 1)]  # enough to rank circles by
    gap = np.hypot(thin[0, :, None] - centre[0], thin[1, :, None] - centre[1]) - radius
    best = int(np.argmin(np.minimum((gap / (4 * noise)) ** 2, 1).sum(0)))
    distance = np.abs(np.hypot(*(flat - centre[:, best, None])) - radius[best])
    return distance < 6 * noise


def _through(a, b, c):
    """Centres (2, m) and radii (m,) of circles through three points each; inf where they are in line."""
    bx, by = b - a
    cx, cy = c - a
    b_square = bx**2 + by**2
    c_square = cx**2 + cy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        twice_area = 2 * (bx * cy - by * cx)
        from_a = (
            np.stack([cy * b_square - by * c_square, bx * c_square - cx * b_square]) / twice_area
        )
    return a + from_a, np.hypot(*from_a)


def _within_robust_spread(gap, label, used, count):
    """(n,) True within 3.5 sigma of each profile's own robust spread."""
    spread = np.array(
        [MEDIAN_TO_SIGMA * np.median(np.abs(gap[used & (label == k)])) for k in range(count)]
    )
    return np.abs(gap) < _SIGMAS * spread[label]


def _ragged_ends(flat, label, used, centre, gap, count):
    """(n,) True at the ends of arcs where the noise is twice that of the middle."""
    angle = _angles_from_middle(flat - centre[:, label], label, used, count)
    is_ragged = np.zeros(len(label), bool)
    for k in range(count):
        points = np.flatnonzero(label == k)
        first, last = _calm_range(angle[points], gap[points], used[points])
        is_ragged[points] = (angle[points] < first) | (angle[points] > last)
    return is_ragged


def _calm_range(angle, gap, used) -> tuple[float, float]:
    """First and last angle (rad) of the part of one arc between cells that are as calm as most.

    Cells are equally wide where most of them have enough points to tell twice the noise from chance; else they have
    equally many points, whatever their distance on the arc.
    """
    order = np.argsort(angle[used], kind="stable")
    sorted_angle, square = angle[used][order], gap[used][order] ** 2
    starts = _starts_of_wide_cells(sorted_angle)
    number = np.diff(np.append(starts, len(sorted_angle)))
    if len(starts) < 2 or np.median(number) < _POINTS_OF_CELL:
        size = max(_POINTS_OF_CELL, -(-len(sorted_angle) // _BINS))
        starts = np.arange(0, max(len(sorted_angle) - size + 1, 1), size)
    ends = np.append(starts[1:], len(sorted_angle))  # the last cell takes the remainder
    rms = np.sqrt(np.add.reduceat(square, starts) / (ends - starts))
    has_noise = ends - starts >= min(_LEAST_POINTS, len(sorted_angle))
    calm = np.flatnonzero(has_noise & (rms < _NOISY * np.median(rms[has_noise])))
    if not len(calm):
        return -np.inf, np.inf
    # what an earlier step has cut beyond these ends stays cut
    return sorted_angle[starts[calm[0]]], sorted_angle[ends[calm[-1]] - 1]


def _starts_of_wide_cells(sorted_angle):
    """Numbers of the first points of the cells of equal width (rad) that have points; sorted_angle: ascending."""
    cell = np.floor(sorted_angle / _CELL_RAD)
    return np.flatnonzero(np.diff(cell, prepend=-np.inf))


def _angles_from_middle(from_centre, label, used, count):
    """(n,) rad, angle about the centre from the middle of the used arc of each profile, -pi to pi."""
    angle = np.arctan2(from_centre[1], from_centre[0])
    used_label = label[used]
    used_angle = angle[used]
    sine = np.bincount(used_label, np.sin(used_angle), count)
    cosine = np.bincount(used_label, np.cos(used_angle), count)
    middle = np.arctan2(sine, cosine)
    from_middle = angle - middle[label]
    return np.angle(np.exp(1j * from_middle))


def _words(label, used, names):
    count = len(names)
    total = np.bincount(label, minlength=count)
    left_out = total - np.bincount(label[used], minlength=count)
    return tuple(
        f"{names[k]}: {left_out[k]} of {total[k]} points left out, off the circle or at its ragged ends"
        for k in np.flatnonzero(left_out > 0.02 * total)
    )
