"""Hand-eye of a 3-D camera from clouds of a ball, of any sensor from ball centres, and of a stationary instrument from
points on the flange, at flange poses."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from datasets.recording import Recording
from sensors.ball.fit import fit_ball
from sensors.ball.search import find_balls
from sensors.hand_eye.centres import Centres, hand_eye_from_centres
from sensors.hand_eye.result import HandEye
from workbench.core.errors import InputError

_FLAT = (
    0.01  # of the extent of a pose's points, within which they lie in the profiler's plane y = 0
)
_METRES = 1000.0
_UNITS = {"metres": 1000.0, "inches": 25.4, "micrometres": 1e-3}
_BETTER = (
    0.1  # of the RMS, below which another unit explains the centres and the stated one does not
)
_AGREES = 0.3  # by which a ratio of radii may differ from a ratio of units


def is_cloud(recording: Recording) -> bool:
    """Whether points of one pose leave the plane y = 0 of a profiler: they are a 3-D camera's."""
    points = recording.points.T
    points = points[:, np.isfinite(points).all(0)]
    if not points.size:
        return False
    extent = max(np.ptp(points[0]), np.ptp(points[2]), 1e-12)
    return bool(np.abs(points[1]).max() > _FLAT * extent)


def from_clouds(
    recording: Recording, flange: np.ndarray, progress: Callable[[str], None]
) -> tuple[HandEye, np.ndarray, tuple[str, ...]]:
    """Hand-eye, flange poses (P, 4, 4) and their names, from points on one ball. Raises InputError."""
    labels, first, pose = np.unique(recording.poses, return_index=True, return_inverse=True)
    ball = recording.balls.get(int(recording.ball[0]))
    radius = None if ball is None else float(ball[3])
    check_unit(recording, recording.points[pose == 0].T, radius)
    progress(f"a ball in each of {len(labels)} clouds")
    fits = []
    for k, label in enumerate(labels):
        fits.append(_ball(recording, recording.points[pose == k].T, radius, label))
    centres = np.stack([fit.centre for fit in fits], axis=1)
    sigma = float(np.sqrt(np.mean([(fit.std[:3] ** 2).mean() for fit in fits])))
    data = Centres(centres, flange[first], np.zeros(len(labels), int), sigma)
    if radius is not None:
        size = radius
    else:
        size = float(np.mean([fit.radius for fit in fits]))
    residual_mm = np.array([fit.rms for fit in fits])
    hand_eye = hand_eye_from_centres(data, size, residual_mm)
    return hand_eye, flange[first], tuple(f"pose {label:g}" for label in labels)


def from_ball_centres(
    recording: Recording, flange: np.ndarray, progress: Callable[[str], None]
) -> tuple[HandEye, np.ndarray, tuple[str, ...]]:
    """The same from measured ball centres (kind ball-centre). Raises InputError."""
    numbers, label = np.unique(recording.ball, return_inverse=True)
    progress(f"hand-eye from {recording.n} centres of {len(numbers)} balls")
    known: Mapping = recording.balls or {}
    first = known.get(int(numbers[0]))
    if recording.sigma is None:
        sigma = np.nan
    else:
        sigma = float(np.sqrt(np.mean(recording.sigma**2)))
    data = Centres(recording.points.T, flange, label, sigma)
    radius = float("nan") if first is None else float(first[3])
    hand_eye = hand_eye_from_centres(data, radius)
    _check_unit_of_centres(recording, data, hand_eye)
    return hand_eye, flange, tuple(f"sample {number:g}" for number in recording.sample_ids)


def from_external_points(
    recording: Recording, flange: np.ndarray, progress: Callable[[str], None]
) -> tuple[HandEye, np.ndarray, tuple[str, ...]]:
    """The same from points on the flange that a stationary instrument measured (kind external-point).

    The transform is T_base_sensor, and the target is the first reflector's place in the frame of the flange. Rows of
    reference targets that do not move with the robot are left out. Raises InputError.
    """
    rows = np.flatnonzero(recording.moving)
    numbers, label = np.unique(recording.reflector[rows], return_inverse=True)
    progress(f"hand-eye from {len(rows)} measured points of {len(numbers)} reflectors")
    sigma = np.nan
    if recording.sigma is not None:
        sigma = float(np.sqrt(np.mean(recording.sigma[rows] ** 2)))
    data = Centres(recording.points[rows].T, flange[rows], label, sigma, is_stationary=True)
    hand_eye = hand_eye_from_centres(data, float("nan"))
    _check_unit_of_centres(recording, data, hand_eye)
    names = tuple(f"sample {number:g}" for number in recording.sample_ids[rows])
    return hand_eye, flange[rows], names


def _check_unit_of_centres(recording: Recording, data: Centres, hand_eye: HandEye) -> None:
    """InputError where the centres fit the flange poses far better in another unit of length."""
    subject, keep = (
        ("points", "points keep") if data.is_stationary else ("ball centres", "balls keep")
    )
    rms = hand_eye.fit["rms_mm"]
    for name, factor in _UNITS.items():
        centres = replace(data, points=factor * data.points)
        other = hand_eye_from_centres(centres, hand_eye.radius)
        if other.fit["rms_mm"] < _BETTER * rms:
            raise InputError(
                f"{recording.name}, samples.csv, columns x_mm, y_mm, z_mm: expected {subject} in mm, found that the "
                f"{keep} their places to {rms:.3g} mm as recorded and to {other.fit['rms_mm']:.3g} mm if the "
                f"numbers are {name}; multiply them by {factor:g}"
            )


def _ball(recording, points, radius, label):
    """The ball of one cloud; InputError with its reason where there is none."""
    points = points[:, np.isfinite(points).all(0)]
    refused: list = []
    found = find_balls(points, radius, refused=refused) if radius is not None else []
    if found:
        return found[0]
    fit = fit_ball(points, radius=radius)
    if fit:
        return fit
    if refused:
        why = max(refused, key=lambda refusal: refusal.points).sentence
    else:
        why = fit.outcome
    raise InputError(
        f"{recording.name}, samples.csv, pose {label:g}: expected points on a ball, found none in "
        f"{points.shape[1]} points ({why}); take the pose out or scan the ball again"
    )


def check_unit(recording: Recording, points: np.ndarray, radius: float | None) -> None:
    """InputError where points (3, n) of a ball are in metres, judged by its certified radius (mm)."""
    points = points[:, np.isfinite(points).all(0)]
    reach = float(np.linalg.norm(points, axis=0).max(initial=0.0))
    if points.size:
        size = float(np.ptp(points, axis=1).max())
    else:
        size = 0.0
    if radius is None or not 0 < size < 2 * radius / _METRES * (1 + _AGREES):
        return
    raise InputError(
        f"{recording.name}, samples.csv, columns x_mm, y_mm, z_mm: expected points on a ball of radius {radius:g} mm, "
        f"found points within {size:.3g} of one another and {reach:.3g} from the sensor, as in metres; multiply them "
        "by 1000"
    )
