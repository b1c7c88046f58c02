"""A turntable that turns the object before a fixed scanner: its axis, its angle law, and motion of a scan.

The frame of a scan is the camera frame at table angle zero. A point p that the camera sees at angle theta stood at

    p_0 = R(axis, -phi) (p - point) + point,    phi = gain theta + sum_n c_n (cos(n theta) - 1) + s_n sin(n theta).

Harmonics are the periodic error of the table's encoder or gear (radial error motion and eccentricity, ISO 230-7);
what remains is a random error of each position.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sensors.scanner.motion import Motion, twists_of
from workbench.core.rigid import rotation_matrix, transform

FRAME = "turntable"
STEP_ERROR = "turntable-step-error"
ORDERS = (1, 2, 3)
"""Cycles per revolution of the harmonics that are tested."""
_STEP = 1e-6
_TINY = 1e-9
_WIDEST_GAP = 3.0  # over the usual gap between positions of a full turn


def is_full_revolution(commanded: np.ndarray) -> bool:
    """Whether positions (F,) rad go all the way round, so that no image is the first or the last one."""
    sorted_positions = np.sort(np.mod(commanded, 2 * np.pi))
    gaps = np.diff(sorted_positions, append=sorted_positions[:1] + 2 * np.pi)
    return bool(gaps.max() < _WIDEST_GAP * max(np.median(gaps), _TINY))


@dataclass(frozen=True)
class AngleError:
    """One part of the error of the table's angle: its `law` with the `source`, a `description`, how it is `tested`."""

    name: str
    law: str
    source: str
    description: str
    tested: str


_TESTED = "From images of a board on the table, by an F-test (p < 0.001)."
ANGLE_ERRORS = (
    AngleError(
        f"{STEP_ERROR}, scale",
        "dphi = (g - 1) theta",
        "ratio of gear or encoder",
        "The table rotates by a constant factor more or less than commanded.",
        _TESTED,
    ),
    AngleError(
        f"{STEP_ERROR}, periodic",
        "dphi = c_n (cos(n theta) - 1) + s_n sin(n theta), n = 1, 2, 3",
        "periodic error of a rotary encoder or worm gear: ISO 230-7; ISO 230-2, positioning",
        "The angle errs with one to three cycles per revolution.",
        f"{_TESTED} More than one cycle where the angles span more than 300 deg.",
    ),
    AngleError(
        f"{STEP_ERROR}, random",
        "dphi ~ N(0, sigma^2), independent at each position",
        "repeatability of positioning: ISO 230-2",
        "Each position has a random error, which no law corrects.",
        "The residual of the law beyond the noise of the corners; part of the covariance of each ball centre.",
    ),
)
"""What the angle of a turntable may hold; the diagnosis names them."""


@dataclass(frozen=True, eq=False)
class Turntable:
    """`axis` (3,) unit vector and `point` (3,) mm of the axis in the camera frame; a positive angle turns the object by
    the right-hand rule about `axis`.

    `harmonics` order -> (cosine, sine) in rad; `sigma` rad, random error of one position. `covariance` (P, P) of two
    tilts (rad) and two shifts (mm) of the axis across itself (`perpendicular`), of the gain, and of each harmonic's two
    amplitudes (rad).
    """

    axis: np.ndarray
    point: np.ndarray
    gain: float = 1.0
    harmonics: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    sigma: float = 0.0
    covariance: np.ndarray | None = None

    @property
    def perpendicular(self) -> np.ndarray:
        """(2, 3) unit vectors across the axis and each other."""
        first = np.eye(3)[np.argmin(np.abs(self.axis))]
        first = np.cross(self.axis, first)
        first = first / np.linalg.norm(first)
        return np.stack([first, np.cross(self.axis, first)])

    def angles(self, commanded: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """(F,) rad by which the object is turned at commanded angles (F,) rad.

        change (1 + 2 H,): of gain and harmonics.
        """
        change = np.zeros(1 + 2 * len(self.harmonics)) if change is None else change
        angles = (self.gain + change[0]) * commanded
        for k, (order, (cosine, sine)) in enumerate(self.harmonics.items()):
            angles = angles + (cosine + change[1 + 2 * k]) * (np.cos(order * commanded) - 1)
            angles = angles + (sine + change[2 + 2 * k]) * np.sin(order * commanded)
        return angles

    def poses(self, commanded: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """(F, 4, 4) T_frame_camera, mm, at commanded angles (F,) rad; change (P,): of the parameters."""
        change = np.zeros(5 + 2 * len(self.harmonics)) if change is None else change
        axis = rotation_matrix(change[:2] @ self.perpendicular) @ self.axis
        point = self.point + change[2:4] @ self.perpendicular
        rotation = rotation_matrix(-self.angles(commanded, change[4:])[:, None] * axis)
        return transform(rotation, point - rotation @ point)

    def motion(self, commanded: np.ndarray) -> Motion:
        """Motion of a scan whose images were taken at commanded angles (F,) rad."""
        poses = self.poses(commanded)
        count = 5 + 2 * len(self.harmonics)
        twists = []
        for k in range(count):
            change = _STEP * np.eye(count)[k]
            twists.append(twists_of(poses, self.poses(commanded, change), _STEP))
        covariance = np.zeros((count, count)) if self.covariance is None else self.covariance
        twist = np.concatenate([-np.cross(self.axis, -self.point), self.axis])
        twist = np.broadcast_to(twist, (len(poses), 1, 6))
        variance = np.array([[max(self.sigma, _TINY) ** 2]])
        common = np.stack(twists, axis=1)
        return Motion(
            FRAME, poses, common, covariance, twist, variance, is_full_revolution(commanded)
        )
