"""Errors that points of a scanner share with their light plane and with their stripe."""

import numpy as np

from sensors.ball.shared import Shared
from sensors.light.planes import tilt_directions


def plane_error(
    points: np.ndarray,
    planes: np.ndarray,
    steps: np.ndarray,
    covariance: np.ndarray,
    unknown: np.ndarray | None = None,
) -> Shared:
    """Errors that points (3, n) in the camera frame share with all others of their light plane, for `fit_ball`.

    `planes` (4, S); `steps` (n,) int column of `planes` of each point; `covariance` (3 S, 3 S) of each
    plane's two tilts (rad, `tilt_directions`) and offset (mm), as of a `Scanner`. A plane that
    shifts by df at a point moves it along its ray by -df / (n.ray). `unknown` (m, 3, n): see `Shared`.
    """
    tilts = np.einsum("kis,is->ks", tilt_directions(planes)[..., steps], points)
    shift = np.concatenate([tilts, np.ones((1, points.shape[1]))])
    stretch = points / (planes[:3, steps] * points).sum(0)
    return Shared(np.asarray(steps), -shift[:, None] * stretch, np.asarray(covariance), unknown)


def stripe_error(error: np.ndarray, steps: np.ndarray, stripe_place: np.ndarray) -> np.ndarray:
    """(2, 3, n) mm by which a stripe's points move when it is shifted, and tilted along itself, by 1 px at its ends.

    `error` (3, n) mm for 1 px of a centre, along its line in the light plane; `steps` (n,) int of the
    stripes, `stripe_place` (n,) px places along them.
    """
    steps = np.unique(steps, return_inverse=True)[1]
    low = np.full(steps.max(initial=-1) + 1, np.inf)
    high = np.full(steps.max(initial=-1) + 1, -np.inf)
    np.minimum.at(low, steps, stripe_place)
    np.maximum.at(high, steps, stripe_place)
    tilt = (stripe_place - (low + high)[steps] / 2) / np.maximum((high - low)[steps] / 2, 1.0)
    return np.stack([error, error * tilt])
