"""The camera: points to pixels and, exactly, pixels to rays.

Frame: x right, y down, z forward, mm; pixel (0, 0) is the centre of the top-left pixel, as in
OpenCV. Distortion: Brown's k1 k2 p1 p2 k3, with k4 k5 k6 the rational model, in OpenCV's order; or the four
coefficients k1 k2 k3 k4 of a fisheye lens (`sensors.camera.fisheye`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensors.camera import fisheye
from sensors.camera.undistort import BLOCK, Inverse, Workspace, fit_inverse, iterate
from workbench.core.errors import InputError

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
BROWN = 9
RATIONAL = 12
FISHEYE = 8
_FISHEYE_NAMES = (*NAMES[:4], "k1", "k2", "k3", "k4")
_MANY = 2 * BLOCK  # pixels, from which the fitted start of the inverse pays


@dataclass(frozen=True)
class Camera:
    """Intrinsics in px, `distortion` (5,), (8,) or (4,) of a fisheye, without unit, `size` (width, height) in px."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0,) * 5
    size: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, values: np.ndarray, size: tuple[int, int]) -> "Camera":
        """From values (9,), (12,) or (8,) in the order of `names`."""
        values = [float(v) for v in values]
        return cls(*values[:4], tuple(values[4:]), (int(size[0]), int(size[1])))

    @property
    def values(self) -> np.ndarray:
        """(9,), (12,) or (8,) in the order of `names`."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion is that of a fisheye lens."""
        return len(self.distortion) == fisheye.COEFFICIENTS

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values: fx, fy, cx, cy and the coefficients of the distortion."""
        return _FISHEYE_NAMES if self.is_fisheye else NAMES[: 4 + len(self.distortion)]

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) camera matrix, px."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """(2, n) px of points (3, n) mm in the camera frame."""
        bent = self.distort(points[:2] / points[2])
        return np.stack([self.fx * bent[0] + self.cx, self.fy * bent[1] + self.cy])

    def project_rows(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels (2, n), their derivative by the point (3, 2, n) and by `values` (P, 2, n)."""
        flat = points[:2] / points[2]
        bent, slope, by_coefficient = self.distort_rows(flat)
        focal = np.array([[self.fx], [self.fy]])
        by_point = np.empty((3, 2, points.shape[1]))
        np.multiply(slope, focal / points[2], out=by_point[:2])  # [by x or y, u or v]
        np.negative(by_point[0] * flat[0] + by_point[1] * flat[1], out=by_point[2])
        by_value = np.empty((len(self.values), 2, points.shape[1]))
        by_value[:4] = 0
        by_value[0, 0], by_value[1, 1], by_value[2, 0], by_value[3, 1] = bent[0], bent[1], 1, 1
        np.multiply(focal, by_coefficient, out=by_value[4:])
        return focal * bent + np.array([[self.cx], [self.cy]]), by_point, by_value

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(3, n) unit directions in the camera frame of pixels (2, n)."""
        flat = self.normalised(pixels)
        ray = np.stack([flat[0], flat[1], np.ones_like(flat[0])])
        return ray / np.sqrt((ray**2).sum(0))

    def normalised(self, pixels: np.ndarray) -> np.ndarray:
        """(2, n) x/z and y/z of pixels (2, n): the exact inverse of the distortion, by Newton's method.

        nan where a pixel lies beyond what the distortion can reach.
        """
        if self.is_fisheye:
            return fisheye.undistort(self.seen(pixels), self.distortion)
        if pixels.shape[1] < _MANY:
            return iterate(self, self.seen(pixels))
        flat = np.empty(pixels.shape)
        workspace = self.workspace()
        for first in range(0, pixels.shape[1], BLOCK):
            workspace.normalised(pixels[:, first : first + BLOCK], flat[:, first : first + BLOCK])
        return flat

    def pnp_view(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels (n, 2), camera matrix and distortion for cv2.solvePnP.

        Of a fisheye lens, whose distortion it does not know, the ideal points in focal lengths.
        """
        if self.is_fisheye:
            return np.ascontiguousarray(self.normalised(pixels).T), np.eye(3), np.zeros(5)
        return np.ascontiguousarray(pixels.T), self.matrix, np.array(self.distortion)

    def seen(self, pixels: np.ndarray) -> np.ndarray:
        """(2, n) distorted normalised image points of pixels (2, n)."""
        return np.stack([(pixels[0] - self.cx) / self.fx, (pixels[1] - self.cy) / self.fy])

    def workspace(self) -> Workspace | fisheye.FisheyeWorkspace:
        """For the exact inverse, a block at a time; the fitted start is made once a camera."""
        if self.is_fisheye:
            return fisheye.FisheyeWorkspace(self)
        return Workspace(self._inverse)

    @cached_property
    def _inverse(self) -> Inverse:
        return fit_inverse(self)

    def distort(self, flat: np.ndarray) -> np.ndarray:
        """(2, n) where the lens puts the ideal normalised image points (2, n)."""
        return self.distort_rows(flat)[0]

    def distort_rows(self, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distorted points (2, n), derivative by the ideal point (2, 2, n) [by x or y, x or y] and by coefficient.

        Brown, Photogramm. Eng. 32 (1966) and 37 (1971); OpenCV's `calib3d` equations. Kannala & Brandt for fisheyes.
        """
        if self.is_fisheye:
            return fisheye.distort_rows(flat, self.distortion)
        x, y = flat
        p1, p2 = self.distortion[2:4]
        x2 = x * x
        y2 = y * y
        xy = x * y
        r2 = x2 + y2
        radial, steep, denominator = self._radial(r2)
        tangential = 2 * (p1 * y + p2 * x)
        slope = np.empty((2, *flat.shape))
        slope[0, 1] = slope[1, 0] = 2 * (steep * xy + p1 * x + p2 * y)
        slope[0, 0] = radial + 2 * steep * x2 + tangential + 4 * p2 * x
        slope[1, 1] = radial + 2 * steep * y2 + tangential + 4 * p1 * y
        bent = (radial + tangential) * flat
        bent += np.array([[p2], [p1]]) * r2
        return bent, slope, self._by_coefficient(flat, r2, radial, denominator, xy)

    def _radial(self, r2):
        """Radial factor, its derivative by r2, and its denominator (None without k4 to k6)."""
        k1, k2, _, _, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0)[:8]
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        steep = k1 + r2 * (2 * k2 + 3 * r2 * k3)
        if len(self.distortion) <= 5:
            return radial, steep, None
        denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial /= denominator
        below_slope = k4 + r2 * (2 * k5 + 3 * r2 * k6)
        return radial, (steep - radial * below_slope) / denominator, denominator

    def _by_coefficient(self, flat, r2, radial, denominator, xy):
        rows = np.empty((len(self.distortion), *flat.shape))
        np.multiply(flat, r2 if denominator is None else r2 / denominator, out=rows[0])
        np.multiply(rows[0], r2, out=rows[1])
        np.multiply(rows[1], r2, out=rows[4])
        rows[2, 0] = rows[3, 1] = 2 * xy
        rows[2, 1] = r2 + 2 * flat[1] ** 2
        rows[3, 0] = r2 + 2 * flat[0] ** 2
        for k, power in zip(range(5, len(rows)), (0, 1, 4)):
            np.multiply(rows[power], -radial, out=rows[k])
        return rows


@dataclass(frozen=True, eq=False)
class StatedCamera:
    """A camera that is held, as a file states it: `camera`, and the `covariance` (V, V) of its values."""

    camera: Camera
    covariance: np.ndarray


def camera_from_keys(keys: dict, called: str) -> Camera:
    """A camera from `fx_px fy_px cx_px cy_px distortion width_px height_px`; InputError where they are not usable."""
    try:
        values = [float(keys[f"{name}_px"]) for name in NAMES[:4]] + [
            float(k) for k in keys["distortion"]
        ]
        size = (int(keys["width_px"]), int(keys["height_px"]))
    except (KeyError, TypeError, ValueError, OverflowError) as problem:
        raise InputError(
            f"{called}: expected fx_px, fy_px, cx_px, cy_px, distortion, width_px and height_px, "
            f"found none or no number for {problem}; write them again"
        ) from None
    is_stated = keys.get("model", "brown") == "fisheye"
    allowed = (FISHEYE,) if is_stated else (BROWN, RATIONAL)
    if len(values) not in allowed or not np.isfinite(values).all():
        raise InputError(
            f"{called}: expected {'4' if is_stated else '5 or 8'} finite distortion coefficients (4 with "
            f'model = "fisheye"), found {values}; calibrate the camera again'
        )
    if not _is_possible(np.array(values), np.array(size)):
        raise InputError(
            f"{called}: expected an image of 1 to {_LARGEST} pixels a side, focal lengths from 1/100 to 10,000 "
            f"times its size, a principal point within ten times its size and distortion coefficients below "
            f"{_STRONGEST:g}, found {values} for {size[0]} x {size[1]} pixels; calibrate the camera again"
        )
    return Camera.of(values, size)


_LARGEST = 100_000  # pixels a side; the largest sensors have some 20,000
_STRONGEST = 1e6  # of a distortion coefficient: telephoto lenses have high orders of some thousand


def _is_possible(values: np.ndarray, size: np.ndarray) -> bool:
    """Whether a camera with these parameters can exist; the bounds are far outside of any lens."""
    if size.min() < 1 or size.max() > _LARGEST:
        return False
    focal = values[:2]
    centre = values[2:4]
    distortion = values[4:]
    return bool(
        focal.min() >= size.max() / 100
        and focal.max() <= 1e4 * size.max()
        and (np.abs(centre) <= 10 * size).all()
        and np.abs(distortion).max() < _STRONGEST
    )


def camera_keys(camera: Camera) -> dict:
    """The keys that `camera_from_keys` reads."""
    return {
        **({"model": "fisheye"} if camera.is_fisheye else {}),
        **{f"{name}_px": float(value) for name, value in zip(NAMES[:4], camera.values)},
        "distortion": [float(k) for k in camera.distortion],
        "width_px": int(camera.size[0]),
        "height_px": int(camera.size[1]),
    }


def covariance_keys(covariance: np.ndarray | None) -> dict:
    """The keys that `covariance_from_keys` reads, of a covariance (V, V); none where it is not known."""
    if covariance is None or not np.isfinite(covariance).all():
        return {}
    return {"covariance": covariance.tolist()}


def covariance_from_keys(keys: dict, camera: Camera, called: str) -> np.ndarray | None:
    """(V, V) covariance of the camera's values, `covariance`; None without the key. InputError where it is none."""
    if "covariance" not in keys:
        return None
    count = len(camera.values)
    covariance = _as_array(keys["covariance"])
    if covariance.shape != (count, count) or not _is_covariance(covariance):
        raise InputError(
            f"{called}, key covariance: expected a symmetric, positive matrix of {count} x {count} finite numbers, "
            f"found another value of shape {covariance.shape}; remove the key or calibrate the camera again"
        )
    return covariance


_ROUNDING = 1e-6  # of a correlation


def _as_array(value: object) -> np.ndarray:
    """An array of numbers, empty where the value of a key is none."""
    try:
        return np.array(value, float)
    except (TypeError, ValueError):
        return np.empty(0)


def _is_covariance(matrix: np.ndarray) -> bool:
    variances = np.diag(matrix)
    if not np.isfinite(matrix).all() or (variances < 0).any():
        return False
    std = np.sqrt(np.maximum(variances, 1e-300))
    correlation = matrix / np.outer(std, std)
    if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
        return False
    smallest_eigenvalue = np.linalg.eigvalsh(correlation)[0]
    return bool(smallest_eigenvalue > -_ROUNDING)
