"""Suspected mistakes in scans of a ball at flange poses: gross errors, exchanged rows, the stated radius.

The ball stands still, so that sensor and flange pose together have to show it in one place. Rows that show it
elsewhere are left out of the fit one after another, and two of them whose poses fit exchanged are named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.ball.fit import fit_ball
from sensors.hand_eye.centres import Centres, hand_eye_from_centres
from sensors.hand_eye.motion import motion
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.errors import InputError
from workbench.core.profiler_start import circle_distances, find_start

_OUTLYING = 5.0
_LEAST_MM = 0.5  # less is what an arm that was never calibrated makes
_MOST_OFF_SHARE = 0.25
_SIGMAS, _LEAST_SHARE, _LEAST_SHARE_OF_CLOUDS = 4.0, 0.005, 0.001
"""A radius differs from the stated one beyond the sigmas and the share of it; that of profiles depends on the arm's
errors, that of clouds on the sensor alone."""
_ACCURATE_SHARE = 0.05  # of the radius: misfit of profiles that still say a radius
_NAMED = 6
_SWEEPS = 4
_VALLEYS, _STEPS = 4, 40  # of the start of a profiler
_NUMBERS = 10  # of hand-eye, ball and radius


@dataclass(frozen=True)
class Scans:
    """Scans of one ball: `seen` (3, P), poses (P, 4, 4) of the flange, `names` (P,), and the certified `radius` in mm.

    `seen` holds x, z and radius of the circle in each profile where `is_profile`, else the ball's centre in each cloud.
    """

    seen: np.ndarray
    poses: np.ndarray
    names: Sequence[str]
    radius: float
    is_profile: bool

    def with_poses(self, poses: np.ndarray) -> "Scans":
        """The scans at other poses (P, 4, 4)."""
        return replace(self, poses=poses)

    def take(self, places) -> "Scans":
        """Some of the scans."""
        names = [self.names[place] for place in np.arange(len(self.names))[places]]
        return replace(self, seen=self.seen[:, places], poses=self.poses[places], names=names)

    def fit(self) -> Callable[["Scans"], np.ndarray]:
        """A function of scans that gives the distances (P,) mm of the ball from its place, as these scans show it."""
        if self.is_profile:
            start = find_start(self.seen, self.poses, self.radius, _VALLEYS, _STEPS)
            return lambda scans: circle_distances(
                start.values, scans.seen, scans.poses, scans.radius
            )
        data = Centres(self.seen, self.poses, np.zeros(len(self.poses), int))
        found = hand_eye_from_centres(data, self.radius)

        def distances(scans: Scans) -> np.ndarray:
            in_base = scans.poses @ found.sensor
            places = np.einsum("pij,jp->pi", in_base[:, :3, :3], scans.seen) + in_base[:, :3, 3]
            return np.linalg.norm(places - found.target[:3, 3], axis=1)

        return distances


def rms_mm(scans: Scans) -> float:
    """RMS mm by which the ball is out of its place."""
    return float(np.sqrt(np.mean(scans.fit()(scans) ** 2)))


def trimmed_rms_mm(scans: Scans) -> float:
    """`rms_mm` without the scans that do not fit the others, at most a quarter of them."""
    wrong, _ = _outlying(scans)
    return rms_mm(scans.take(~wrong))


def pose_suspicions(scans: Scans) -> tuple[str, ...]:
    """Parts of sentences on scans whose flange poses do not fit the others, and on rotations that are missing."""
    missing = motion(scans.poses, "in-hand").sentences
    if missing:
        return tuple(
            f"the flange poses do not determine everything: {parameter}" for parameter in missing
        )
    wrong, distances = _outlying(scans)
    if not wrong.any():
        return ()
    pair = _exchanged(scans, wrong, distances)
    if pair is not None:
        first, second = (scans.names[place] for place in pair)
        return (
            f"the flange poses of {first} and {second} look exchanged: the ball then keeps its place; correct the "
            "order of these rows",
        )
    ordered = np.flatnonzero(wrong)[np.argsort(-distances[wrong])]
    words = [f"{scans.names[place]} ({distances[place]:.3g} mm)" for place in ordered[:_NAMED]]
    if len(ordered) > _NAMED:
        unlisted = [f"{len(ordered) - _NAMED} more"]
    else:
        unlisted = []
    return (
        f"the flange poses of {len(ordered)} of {len(distances)} scans do not fit those of the others: the ball seems "
        f"to be displaced in {', '.join([*words, *unlisted])}; check the pose and the file of these rows, and correct "
        "or remove them",
    )


def radius_suspicion(clouds: Sequence[np.ndarray], stated: float) -> str | None:
    """A part of a sentence where clouds (3, k) show a ball of another radius than the stated one, mm; else None."""
    found = []
    for points in clouds:
        try:
            found.append(fit_ball(points).radius)
        except InputError:
            continue
    if len(found) < 2:
        return None
    middle = float(np.median(found))
    spread = MEDIAN_TO_SIGMA * float(np.median(np.abs(np.array(found) - middle)))
    sigma = spread / np.sqrt(len(found))
    if abs(middle - stated) < max(_SIGMAS * sigma, _LEAST_SHARE_OF_CLOUDS * stated):
        return None
    return (
        f"the clouds show a ball of radius {middle:.4g} mm (standard deviation {sigma:.2g} mm), and --ball-radius "
        f"states {stated:g} mm; correct the radius, or the scale of the sensor"
    )


def profile_radius_suspicion(scans: Scans) -> str | None:
    """The same of profiles, whose flange poses tell how far each light plane passes from the ball's centre.

    The radius is fitted together with hand-eye and ball. Its sigma is the difference over the root of F, the fall of
    the sum of squares over the variance that is left.
    """
    wrong, _ = _outlying(scans)
    kept = scans.take(~wrong)
    degrees = kept.seen.size - _NUMBERS
    if degrees < 1 or motion(kept.poses, "profiles").sentences:
        return None
    stated, free = (
        find_start(kept.seen, kept.poses, radius, _VALLEYS, _STEPS)
        for radius in (scans.radius, None)
    )
    variance = free.rms**2 * kept.seen.size / degrees
    fall = (stated.rms**2 - free.rms**2) * kept.seen.size
    radius = float(free.values[9])
    deviation = abs(radius - scans.radius)
    if free.rms > _ACCURATE_SHARE * scans.radius:
        return None  # the poses of this arm are too inaccurate to tell
    if fall < _SIGMAS**2 * variance or deviation < _LEAST_SHARE * scans.radius:
        return None
    return (
        f"the profiles show a ball of radius {radius:.4g} mm (standard deviation "
        f"{deviation * np.sqrt(variance / fall):.2g} mm), and --ball-radius states {scans.radius:g} mm; "
        "correct the radius, or the scale of the sensor"
    )


def _outlying(scans: Scans) -> tuple[np.ndarray, np.ndarray]:
    """(P,) which scans do not fit the others, none where they are too many; (P,) mm by which the ball is displaced."""
    wrong = np.zeros(len(scans.poses), bool)
    for _ in range(_SWEEPS):
        distances = scans.take(~wrong).fit()(scans)
        found = distances > _limit(distances)
        if found.mean() > _MOST_OFF_SHARE:
            return np.zeros(len(wrong), bool), distances
        if (found == wrong).all():
            break
        wrong = found
    return wrong, distances


def _limit(distances: np.ndarray) -> float:
    """mm beyond which a scan does not fit the others."""
    return max(_OUTLYING * float(np.median(distances)), _LEAST_MM)


def _exchanged(
    scans: Scans, wrong: np.ndarray, scan_distances: np.ndarray
) -> tuple[int, int] | None:
    """Two outlying scans that fit with the pose of each other; None where there are none, or other scans are wrong."""
    places = np.flatnonzero(wrong)
    if len(places) != 2:
        return None
    distances = scans.take(~wrong).fit()
    pair = scans.take(places)
    distance = distances(pair.with_poses(pair.poses[::-1]))
    if (distance < _limit(scan_distances)).all():
        return (int(places[0]), int(places[1]))
    return None
