"""Points on balls (kind ball-surface) as scans: one sample for each ball of each static pose.

The points of a scan share the pose, and all that an arm does to it. As samples of their own they would count what few
poses say as often as there are points, and a step or a drift could begin between two points of one scan.
"""

from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import ROOT, SCATTER, SECTION, Recording
from datasets.samples.columns import SIGMAS
from robot_model.chain import forward
from robot_model.files.loading import load_robot
from robot_model.measurements.ball_scan import FILE_KIND, KIND
from robot_model.measurements.ball_surface import BallSurface, numbers_of_scans, scan_numbers
from robot_model.robot import Robot
from sensors.hand_eye.circles import fit_circles
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.fitting.checked_samples import CheckedSamples

_POINT = ("x_mm", "y_mm", "z_mm")
_OF_POINTS = ("sigma_mm", *SIGMAS)
_FAR_SIGMAS = 6.0  # robust standard deviations beyond which a point is not of the ball's surface
_FEWEST = 4
_NUMBERS = 3  # that the points of a scan determine
_RATIO = 1.5  # of stated and shown noise, from which on they differ: no noise is known much better
_MAX_ROUNDS = 20  # by which the points of a scan settle


@dataclass(frozen=True)
class _Surface:
    """Fit of P scans: `centre` (3, P) mm, `section` (P,) mm or nan, `gram` (P, 3, 3), `gap` (n,) mm of each point."""

    centre: np.ndarray
    section: np.ndarray
    gram: np.ndarray
    gap: np.ndarray


def scans_of(robot: Robot, recording: Recording) -> Recording:
    """The recording with one row for each scan that determines its ball, in the order of their first points.

    recording: the moving rows, kind ball-surface. Its warnings say which scans and points are left out. The noise of
    points is none of a scan, whose pose has errors of its own: it is unknown. The column `SCATTER` is the RMS distance
    (mm) that the scatter of the points alone makes in each scan. Raises InputError where fewer than four
    scans determine a ball.
    """
    surface = BallSurface.of(recording)
    frames = forward(robot, robot.mixing @ recording.joints.T)
    scan, ball, first, centre = surface.scan_centres(frames)
    in_order = np.argsort(first, kind="stable")
    place = np.argsort(in_order)
    scan = place[scan]
    ball = ball[in_order]
    first = first[in_order]
    centre = centre[:, in_order]
    is_usable = np.isfinite(centre[0])
    radius = surface.balls[ball, 3]
    fitted, used = _fitted(surface.measured, scan, centre, radius, is_usable)
    scatter, points = _scatter(fitted.gap, scan, used, len(first))
    warnings = _left_out(recording, scan, first, is_usable, used)
    warnings += _stated_otherwise(recording, scatter)
    kept = np.flatnonzero(is_usable)
    columns = _means(recording, scan, used, first)
    columns |= dict(zip(_POINT, fitted.centre)) | {SECTION: fitted.section}
    root = _square_roots(fitted.gram).reshape(-1, 9)
    columns |= dict(zip(ROOT, root.T))
    columns |= {SCATTER: np.sqrt(_NUMBERS / np.maximum(points, 1)) * scatter}
    columns |= {"sample": scan_numbers(recording, first)}
    return replace(
        recording,
        measures=KIND,
        columns={name: cells[kept] for name, cells in columns.items()},
        sigma_mm=None,
        warnings=(*recording.warnings, *warnings),
    )


def _fitted(points, scan, centre, radius, is_usable) -> tuple[_Surface, np.ndarray]:
    """The fit of each usable scan without points far off its surface, and (n,) True for the points that count.

    Gross points displace the fit, which hides some of them: the points are chosen again after each fit.
    """
    of_usable = is_usable[scan]
    is_profile = bool((points[1] == 0).all())
    fit = _fit_profiles if is_profile else _fit_clouds
    used = of_usable
    fitted = fit(points, scan, used, centre, radius)
    for _ in range(_MAX_ROUNDS):
        near_points = _near_surface(fitted.gap, scan, used, of_usable)
        if (near_points == used).all():
            break
        used = near_points
        fitted = fit(points, scan, used, centre, radius)
    return fitted, used


def _near_surface(gap, scan, used, of_usable) -> np.ndarray:
    """(n,) True for points of usable scans within a multiple of the spread of the used ones; all of a scan of few."""
    count = scan.max() + 1
    spread = np.array([_spread(gap[used & (scan == k)]) for k in range(count)])
    near_points = of_usable & (np.abs(gap) <= _FAR_SIGMAS * spread[scan])
    is_left = np.bincount(scan[near_points], minlength=count) >= _FEWEST
    return near_points | (of_usable & ~is_left[scan])


def _spread(gap: np.ndarray) -> float:
    if len(gap):
        return MEDIAN_TO_SIGMA * float(np.median(np.abs(gap)))
    return np.inf


def _fit_profiles(points, scan, used, centre, radius) -> _Surface:
    """Circles by least squares of the distances in the plane; the sign of y is that of the nominal arm."""
    count = len(radius)
    present = np.unique(scan[used])
    label = np.searchsorted(present, scan).clip(0, len(present) - 1)
    flat = points[[0, 2]]
    names = [f"scan {k + 1}" for k in present]
    middle = np.full((2, count), np.nan)
    section = np.full(count, np.nan)
    middle[:, present], section[present] = fit_circles(flat, label, used, names)
    out = flat - middle[:, scan]
    distance = np.hypot(*out)
    # noise lies in the plane: a distance from the circle there, not one from the ball's surface in space
    steepness = (radius / section)[scan]
    rows = np.stack([-out[0] / distance, steepness, -out[1] / distance])
    y = np.sqrt(np.maximum(radius**2 - section**2, 0.0)) * np.where(centre[1] < 0, -1.0, 1.0)
    seen = np.stack([middle[0], y, middle[1]])
    return _Surface(seen, section, _gram(rows, scan, used, count), distance - section[scan])


def _fit_clouds(points, scan, used, centre, radius, steps: int = 10) -> _Surface:
    """Balls of known radius by Gauss-Newton."""
    count = len(radius)
    for _ in range(steps):
        out = points - centre[:, scan]
        distance = np.sqrt((out**2).sum(0))
        gap = distance - radius[scan]
        rows = out / distance
        gram = _gram(rows, scan, used, count)
        right = np.stack([_sums(row * gap, scan, used, count) for row in rows], axis=1)
        right = right / np.maximum(np.bincount(scan[used], minlength=count), 1)[:, None]
        is_fitted = np.isfinite(right).all(1) & (np.abs(np.linalg.det(gram)) > 1e-12)
        step = np.zeros((count, 3))
        step[is_fitted] = np.linalg.solve(gram[is_fitted], right[is_fitted][..., None])[..., 0]
        centre = centre + step.T
    return _Surface(centre, np.full(count, np.nan), gram, gap)


def _sums(values, scan, used, count) -> np.ndarray:
    return np.bincount(scan[used], values[used], count)


def _gram(rows, scan, used, count) -> np.ndarray:
    """(P, 3, 3) mean over the points of each scan of the products of rows (3, n)."""
    number = np.maximum(np.bincount(scan[used], minlength=count), 1)
    products = [[_sums(p * q, scan, used, count) / number for q in rows] for p in rows]
    return np.moveaxis(np.array(products), -1, 0)


def _square_roots(gram: np.ndarray) -> np.ndarray:
    """(P, 3, 3) symmetric square roots; nan where the scan is not usable."""
    roots = np.full_like(gram, np.nan)
    is_known = np.isfinite(gram).all((1, 2))
    values, vectors = symmetric_eigen(gram[is_known])
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    roots[is_known] = scaled @ vectors.swapaxes(1, 2)
    return roots


def _means(recording: Recording, scan, used, first) -> dict[str, np.ndarray]:
    """Columns with one value a scan: means of covariates over its points, else the value of its first point."""
    count = len(first)
    number = np.maximum(np.bincount(scan[used], minlength=count), 1)
    columns = {name: cells[first] for name, cells in recording.columns.items()}
    for name, cells in recording.covariates.items():
        if np.ptp(cells) > 0:
            columns[name] = _sums(cells, scan, used, count) / number
    return {name: cells for name, cells in columns.items() if name not in _OF_POINTS}


def _left_out(recording: Recording, scan, first, is_usable, used) -> tuple[str, ...]:
    """Sentences on scans and points that are left out."""
    warnings = []
    numbers = recording.sample_ids[first]
    lost = numbers[~is_usable]
    if len(lost):
        shown = ", ".join(f"{number}" for number in lost[:5])
        warnings.append(
            f"{len(lost)} of {len(first)} scans do not determine a ball and are left out: those that begin with "
            f"sample {shown}{', ...' if len(lost) > 5 else ''}. Measure more points there."
        )
    far_points = is_usable[scan] & ~used
    if far_points.any():
        warnings.append(
            f"{int(far_points.sum())} of {len(scan)} points are more than {_FAR_SIGMAS:g} standard deviations off "
            "the ball in their scan and are left out."
        )
    return tuple(warnings)


def _scatter(gap, scan, used, count) -> tuple[float, np.ndarray]:
    """Standard deviation (mm) of the points about the fits of their scans, and (P,) the points of each scan."""
    points = np.bincount(scan[used], minlength=count)
    degrees = int(np.maximum(points - _NUMBERS, 0).sum())
    return float(np.sqrt((gap[used] ** 2).sum() / max(degrees, 1))), points


def _stated_otherwise(recording: Recording, scatter: float) -> tuple[str, ...]:
    """A sentence where the stated noise of the points is not that which their scatter within the scans shows."""
    if recording.sigma is None or not scatter > 0:
        return ()
    stated = float(np.sqrt((recording.sigma**2).mean()))
    if 1 / _RATIO < stated / scatter < _RATIO:
        return ()
    return (
        f"The stated noise of a point is {stated:.3g} mm, but the points scatter by {scatter:.3g} mm within their "
        "scans. The scatter is used; correct sigma_mm.",
    )


def as_scans(samples: Recording) -> Recording:
    """The moving rows of a recording; points on balls as scans, about the nominal arm."""
    if samples.measures != FILE_KIND:
        return samples
    return scans_of(load_robot(samples.robot), samples)


def checked_scans(checked: CheckedSamples, *named) -> tuple[CheckedSamples, list]:
    """Checked points of balls as scans, and lists of sample numbers of points (or None) as numbers of the scans that
    hold any of them."""
    points = checked.recording
    numbers = numbers_of_scans(points)
    lists = [
        None if wanted is None else np.unique(numbers[np.isin(points.sample_ids, wanted)]).tolist()
        for wanted in named
    ]
    return replace(checked, recording=scans_of(checked.robot, points)), lists
