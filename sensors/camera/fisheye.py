"""Fisheye lenses: the distortion of Kannala and Brandt, IEEE Trans. Pattern Anal. Mach. Intell. 28 (2006).

A ray at the angle theta from the optical axis is seen at the distance f theta (1 + k1 theta^2 + k2 theta^4 +
k3 theta^6 + k4 theta^8) from the principal point, as in OpenCV's `fisheye` module and in the model "equidistant" of ROS
and Kalibr. As everywhere in this package, rays are (x/z, y/z, 1): they reach to less than 90 degrees from the axis.
"""

import numpy as np

COEFFICIENTS = 4
WIDEST = np.deg2rad(88.0)
"""rad, largest angle from the optical axis at which a ray is used."""
_STEPS = 20
_SETTLED = 1e-14
_SMALL = 1e-8  # squared radius below which series replace quotients


def distort_rows(flat: np.ndarray, coefficients) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distorted points (2, n) of ideal ones (2, n), derivative (2, 2, n) by these and (4, 2, n) by the coefficients."""
    k1 = coefficients[0]
    r2 = (flat**2).sum(0)
    is_small = r2 < _SMALL
    r = np.sqrt(np.where(is_small, 1.0, r2))
    theta = np.arctan(r)
    seen, slope = _seen_angle(theta, coefficients)
    factor = np.where(is_small, 1.0 + (k1 - 1 / 3) * r2, seen / r)
    # derivative of the factor by r, over r
    steep = np.where(is_small, 2 * (k1 - 1 / 3), (slope / (1 + r**2) - seen / r) / r**2)
    by_point = steep * flat[:, None] * flat[None]
    by_point[0, 0] += factor
    by_point[1, 1] += factor
    powers = theta[None] ** (2 * np.arange(1, COEFFICIENTS + 1)[:, None] + 1) / r
    powers = np.where(is_small, 0.0, powers)
    return factor * flat, by_point, powers[:, None] * flat[None]


def undistort(seen: np.ndarray, coefficients) -> np.ndarray:
    """Ideal points (2, n) of distorted ones (2, n), to rounding; nan beyond `WIDEST` and where the lens folds over."""
    radius = np.sqrt((seen**2).sum(0))
    theta = np.minimum(radius, WIDEST)
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            value, slope = _seen_angle(theta, coefficients)
            step = (value - radius) / slope
            theta = np.clip(theta - step, 0.0, np.pi / 2)
            if np.nanmax(np.abs(step), initial=0.0) < _SETTLED:
                break
        value, slope = _seen_angle(theta, coefficients)
        is_found = (np.abs(value - radius) < 1e-12) & (slope > 0) & (theta < WIDEST)
        factor = np.where(radius > 0, np.tan(theta) / np.where(radius > 0, radius, 1.0), 1.0)
    return np.where(is_found, factor * seen, np.nan)


def _seen_angle(theta, coefficients):
    """theta (1 + k1 theta^2 + ...) and its derivative."""
    k1, k2, k3, k4 = coefficients
    t2 = theta**2
    value = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
    return value, slope


class FisheyeWorkspace:
    """The inverse of a block of pixels, with the interface of `undistort.Workspace`."""

    def __init__(self, camera):
        self.camera = camera

    def normalised(self, pixels: np.ndarray, out: np.ndarray) -> None:
        """Ideal normalised points of pixels (2, m) into `out` (2, m)."""
        out[:] = undistort(self.camera.seen(pixels), self.camera.distortion)
