"""Poses of an arm whose tip touches fixed points or planes, or whose laser beam passes through fixed points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot

_STEPS, _STEP_RAD, _DIFFERENCE = 80, 0.2, 1e-6
_SHARE_OF_LIMITS = 0.6
_LARGEST_START_MM = 700.0

Gap = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(m, n) mm that have to become zero, from rotations (n, 3, 3) and origins (n, 3) of the flange."""


@dataclass(frozen=True)
class TrueArm:
    """A robot whose geometry differs from its nominal one; geometry (J, 5), rad and mm."""

    robot: Robot
    geometry: np.ndarray

    @classmethod
    def of(cls, robot: Robot, rng: np.random.Generator, length_mm=0.3, angle_deg=0.05) -> "TrueArm":
        """An arm with random errors of its geometry, 1 sigma each."""
        sizes = np.array([np.deg2rad(angle_deg), length_mm, length_mm, np.deg2rad(angle_deg), 0.0])
        return cls(robot, robot.geometry + sizes * rng.normal(size=robot.geometry.shape))

    def flange(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (n, 3, 3) and origins (n, 3) mm of the flange at readings (n, R) in rad or mm."""
        frames = forward(self.robot, self.robot.mixing @ readings.T, self.geometry)
        return np.stack(frames.end, -1).transpose(1, 0, 2), frames.end_origin.T

    def limits(self) -> np.ndarray:
        """(R, 2) readings that are used."""
        unknown = np.array([-np.pi, np.pi])
        found = np.where(np.isfinite(self.robot.limits), self.robot.limits, unknown)
        found = np.clip(found, -np.pi, np.pi)
        middle = found.mean(1)
        half = np.ptp(found, axis=1) / 2
        return np.stack([middle - _SHARE_OF_LIMITS * half, middle + _SHARE_OF_LIMITS * half], 1)

    def solved(self, readings: np.ndarray, gap: Gap) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n, R) nearest to given ones at which `gap` vanishes, and (n,) True where it does.

        Gauss-Newton with steps of least norm, all rows at once; the Jacobian by finite differences.
        """
        for _ in range(_STEPS):
            value = gap(*self.flange(readings))
            columns = []
            for joint in range(readings.shape[1]):
                moved = readings.copy()
                moved[:, joint] += _DIFFERENCE
                columns.append((gap(*self.flange(moved)) - value) / _DIFFERENCE)
            jacobian = np.stack(columns, -1).transpose(1, 0, 2)
            step = -np.einsum("nrm,nm->nr", np.linalg.pinv(jacobian, rcond=1e-6), value.T)
            size = np.abs(step).max(1, keepdims=True)
            readings = readings + step * np.minimum(1.0, _STEP_RAD / np.maximum(size, 1e-12))
        value = gap(*self.flange(readings))
        limits = self.limits() * 1.3
        is_inside = ((readings >= limits[:, 0]) & (readings <= limits[:, 1])).all(1)
        return readings, is_inside & (np.abs(value).max(0) < 1e-6)

    def poses_with(
        self, count: int, rng: np.random.Generator, gap: Gap, sigma_mm: float
    ) -> np.ndarray:
        """(count, R) readings at which `gap` is zero but for noise. Raises ValueError where too few are found."""
        found = np.empty((0, self.robot.mixing.shape[1]))
        for _ in range(20):
            start = rng.uniform(*self.limits().T, size=(4 * count, found.shape[1]))
            is_near = np.abs(gap(*self.flange(start))).max(0) < _LARGEST_START_MM
            readings, solved = self.solved(start[is_near], gap)
            found = np.concatenate([found, readings[solved]])
            if len(found) >= count:
                return self._with_noise(found[:count], rng, gap, sigma_mm)
        raise ValueError(f"only {len(found)} of {count} poses were found")

    def _with_noise(self, readings, rng, gap: Gap, sigma_mm: float) -> np.ndarray:
        noise = sigma_mm * rng.normal(size=gap(*self.flange(readings)).shape)
        return self.solved(readings, lambda rotation, origin: gap(rotation, origin) - noise)[0]


def touching_point(tip: np.ndarray, point: np.ndarray) -> Gap:
    """The tip (3,) in the flange frame is at a point (3,) of the base frame."""
    return lambda rotation, origin: ((rotation @ tip + origin) - point).T


def touching_plane(tip: np.ndarray, normal: np.ndarray, offset: float) -> Gap:
    """The tip is on the plane normal . x = offset of the base frame."""
    return lambda rotation, origin: ((rotation @ tip + origin) @ normal - offset)[None]


def beam_through(beam: tuple[np.ndarray, np.ndarray], point: np.ndarray) -> Gap:
    """A beam (origin (3,), axes (3, 3) with z along it) of the flange passes through a point of the base frame."""
    start, axes = beam

    def gap(rotation, origin):
        in_flange = np.einsum("nji,nj->ni", rotation, point - origin) - start
        return (in_flange @ axes[:, :2]).T

    return gap
