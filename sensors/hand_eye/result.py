"""Result of a hand-eye calibration, and its construction from an adjustment."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sensors.camera.model import Camera
from sensors.hand_eye.checks.camera_dependence import CameraDependence
from sensors.hand_eye.uncertainty.misfit import Misfit
from sensors.hand_eye.uncertainty.parameter_covariance import ParameterCovariance
from workbench.core.parameters import Parameters
from workbench.core.rigid import left_jacobian, rotation_matrix, transform


@dataclass(frozen=True)
class PoseRow:
    """One pose: `residual` RMS with the robot held exact, `held_out` RMS predicted from the other poses
    (px of a point, or mm from the ball), `moved_mm` and `rotation_deg` what the adjustment thinks the
    robot was off by, `chance` of a pose that is further off, `outlier` True: left out, and `why`. `pose` is
    the row of the flange poses, from 0, and no name of the user: `why` goes with the name of the image or pose."""

    pose: int
    residual: float
    held_out: float
    moved_mm: float
    rotation_deg: float
    chance: float
    outlier: bool
    why: str = ""


@dataclass(frozen=True)
class HandEye:
    """Result of a hand-eye calibration: pose of the sensor with its uncertainty.

    `kind`: "in-hand", "to-hand" or "profiles"; `sensor` (4, 4): T_flange_sensor, for "to-hand"
    T_base_sensor; `covariance` (6, 6) of x y z (mm) and of a small rotation about x y z (rad), along the
    axes of the flange (base for "to-hand"), inf on the diagonal and nan off it where it is not determined;
    `target` (4, 4): T_base_board, for "to-hand" T_flange_board, for a ball its centre;
    `target_covariance` of the same kind, of a ball (3, 3); `noise` 1 sigma of the sensor (`unit` px, or
    mm in the light plane); `robot_sigma` of the flange poses at the board, of a board also at the
    flange's origin (`FlangeVariance.as_keys`); `fit` and `held_out` (each pose from the
    others): RMS, and the scatter of the board; `range_scale` s of a profiler: it measures (1 + s) times the true z;
    `dependence` of the camera on gravity or on a recorded column, next to which the errors of the flange poses are
    smaller; `undetermined` and `suspicions` sentences; `std` by key
    of `parameters`, the camera's by camera.fx, camera.fy, ...; inf where it is not determined.
    """

    kind: str
    sensor: np.ndarray
    covariance: np.ndarray
    target: np.ndarray
    target_covariance: np.ndarray
    parameters: Parameters
    std: dict[str, float]
    noise: float
    unit: str
    robot_sigma: dict[str, float]
    fit: dict[str, float]
    held_out: dict[str, float]
    poses: tuple[PoseRow, ...]
    undetermined: tuple[str, ...]
    suspicions: tuple[str, ...]
    outcome: str
    converged: bool
    history: tuple[float, ...] = ()
    camera: Camera | None = None
    radius: float | None = None
    range_scale: float = 0.0
    notes: tuple[str, ...] = field(default=())
    misfit: Misfit | None = None
    dependence: CameraDependence | None = None

    @cached_property
    def centre(self) -> np.ndarray:
        """(3,) mm, origin of the board, or centre of the ball."""
        return self.target[:3, 3]

    @property
    def outliers(self) -> tuple[int, ...]:
        """Poses left out."""
        return tuple(row.pose for row in self.poses if row.outlier)


def placement(values: np.ndarray) -> np.ndarray:
    """(4, 4) of x y z (mm) and a rotation vector (rad); of three values a translation."""
    rotation = rotation_matrix(values[3:6]) if len(values) > 3 else np.eye(3)
    return transform(rotation, np.asarray(values[:3]))


def of_block(adjusted, known: ParameterCovariance, where: str) -> np.ndarray:
    """(6, 6) or (3, 3) covariance of the pose at `where`: mm, and a small rotation about the outer axes."""
    names = [
        key
        for key in known.keys
        if key in {f"{where}.{name}" for name in ("x", "y", "z", "rx", "ry", "rz")}
    ]
    rows = np.eye(len(known.keys))[[known.keys.index(key) for key in names]]
    if len(names) == 6:
        rows[3:] = (
            left_jacobian(np.array([adjusted.parameters[key] for key in names[3:]])) @ rows[3:]
        )
    return known.of(rows)


def rms(residual: np.ndarray, chosen: np.ndarray) -> float:
    """Root of the mean squared length of the chosen columns of (m, n)."""
    return (
        float(np.sqrt((residual[:, chosen] ** 2).sum(0).mean())) if chosen.any() else float("nan")
    )


def held_row(pose, chain, adjusted, exact, held_out, left_out, blunder) -> PoseRow:
    """The row of one pose."""
    is_of_pose = chain.pose == pose
    error = adjusted.errors[pose]
    residual = rms(exact, is_of_pose)
    other = rms(held_out, is_of_pose)
    rotation_deg = (
        float(np.degrees(np.linalg.norm(error[3:6]))) if len(error) == 6 else float("nan")
    )
    unit = "px" if len(exact) == 2 else "mm"
    usual = rms(held_out, ~is_of_pose)
    why = (
        (
            f"{other:.3g} {unit} from the prediction of the other poses, "
            f"which are {usual:.3g} {unit} off; left out: check its flange pose and its image"
        )
        if blunder
        else ""
    )
    return PoseRow(
        pose,
        residual,
        other,
        float(np.linalg.norm(error[:3])),
        rotation_deg,
        left_out.chance,
        blunder,
        why,
    )
