"""`external-pose`: a target on the flange whose point and orientation an external instrument gives."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    moved_target,
    position_sigma,
)
from robot_model.measurements.external_point import base_values, point_system
from robot_model.measurements.multistart import MODEL_ERROR_MM, RotationSystem, lever_arm
from robot_model.poses import pose_parameters, pose_values
from workbench.core.rigid import left_jacobian, rotation_matrix


class MeasuredPose:
    """A target on the flange, of which an instrument gives the point `measured` (3, n) mm and an orientation.

    `angles`: components of the orientation that are measured.
    """

    place = "tool"
    grounded = False
    angles = 3

    def parameters(self) -> list:
        """Transform T_flange_target."""
        return pose_parameters("tool", "tool")

    @property
    def numbers(self) -> np.ndarray:
        """(n,) one target only."""
        return np.ones(self.measured.shape[1], int)

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) place of the target on the flange, mm, for the kind's own values."""
        return np.repeat(values[:3, None], self.measured.shape[1], 1)

    def sigma(self, recording) -> np.ndarray:
        """(3 + angles, n): mm, then rad from column sigma_deg or, without it, that of two points 100 mm apart."""
        position = position_sigma(recording)
        if "sigma_deg" in recording.columns:
            orientation_noise = np.deg2rad(recording.columns["sigma_deg"])
        else:
            orientation_noise = position[0] / 100
        return np.concatenate([position, np.tile(orientation_noise, (self.angles, 1))])

    def port_rows(self, axes: np.ndarray) -> dict[str, np.ndarray]:
        """Rows (3, 3 + angles, n) of the ports `target`, along the axes (3, 3, n) of the flange, and `sensor`."""
        rotation_rows = np.zeros((3, self.angles, axes.shape[2]))
        sensor = np.broadcast_to(np.eye(3)[:, :, None], axes.shape)
        return {
            port: np.concatenate([rows, rotation_rows], 1)
            for port, rows in (("target", axes), ("sensor", sensor))
        }


@dataclass(frozen=True)
class ExternalPose(MeasuredPose):
    """Measured points (3, n) mm and rotations (n, 3, 3), target frame to external frame."""

    measured: np.ndarray
    rotations: np.ndarray

    @classmethod
    def of(cls, recording) -> "ExternalPose":
        """From a recording with columns qw qx qy qz."""
        from scipy.spatial.transform import Rotation

        quaternions = np.stack([recording.columns[f"q{c}"] for c in "xyzw"], -1)
        return cls(
            np.ascontiguousarray(recording.points.T), Rotation.from_quat(quaternions).as_matrix()
        )

    def at(self, samples: np.ndarray) -> "ExternalPose":
        return replace(self, measured=self.measured[:, samples], rotations=self.rotations[samples])

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(6, n): point difference in mm, then the rotation vector from measured to predicted (rad)."""
        from scipy.spatial.transform import Rotation

        tool = rotation_matrix(values[3:])
        axes = np.stack(frames.end)
        point = moved_target(frames.point(values[:3]), axes, deltas)
        predicted = add_delta(point, deltas["sensor"]) if "sensor" in deltas else point
        deviation = (
            Rotation.from_matrix(flange_matrices(frames) @ tool @ self.rotations.transpose(0, 2, 1))
            .as_rotvec()
            .T
        )
        tool_rows = np.zeros((6, 6, point.shape[1]))
        tool_rows[:3, :3] = axes
        tool_rows[3:, 3:] = _of_vector(
            deviation, np.einsum("fcn,fk->kcn", axes, left_jacobian(values[3:]))
        )
        residual = np.concatenate([predicted - self.measured, deviation])
        return Closure(
            residual,
            point,
            _position_rows,
            tool_rows,
            self.port_rows(axes),
            lambda rotations: _rotation_rows(_of_vector(deviation, rotations)),
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Base pose (6,) and tool (6,) that fit positions and orientations together best."""
        return self.starts(frames)[0]

    def starts(self, frames: Frames) -> list[tuple[np.ndarray, np.ndarray]]:
        """Base and tool at every local minimum that was found, best first."""
        return [
            (
                base_values(start, frames, self.measured),
                pose_values(start.rotations[1], start.translations[3:]),
            )
            for start in self.system(frames).starts()
        ]

    def system(self, frames: Frames) -> RotationSystem:
        """The rows of one reflector, and R_b^T R_m - R_f R_t = 0 with X_1 = R_b^T and X_2 = R_t."""
        rotations = flange_matrices(frames)
        points = point_system(frames, self.measured, np.zeros(len(rotations), int), 1)
        by_base = np.einsum("ia,nbl->nilab", np.eye(3), self.rotations).reshape(-1, 9, 9)
        by_tool = np.einsum("nia,lb->nilab", rotations, np.eye(3)).reshape(-1, 9, 9)
        # the Frobenius norm of the difference of two rotations is sqrt(2) times a small angle between them
        unit = lever_arm(frames.end_origin) / (np.sqrt(2) * MODEL_ERROR_MM)
        rows = unit * np.concatenate([by_base, -by_tool], 2)
        return points.with_orientations(rows)

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement moved by its residual (6, n)."""
        from scipy.spatial.transform import Rotation

        rotations = Rotation.from_rotvec(residual[3:].T) * Rotation.from_matrix(self.rotations)
        position = dict(zip(("x_mm", "y_mm", "z_mm"), self.measured + residual[:3]))
        orientation = dict(zip(("qx", "qy", "qz", "qw"), rotations.as_quat().T))
        return position | orientation


def _of_vector(vector, rotations):
    """(k, 3, n) change of a rotation vector (3, n) by small `rotations` (k, 3, n) that follow its own.

    The inverse of the left Jacobian: Barfoot, State Estimation for Robotics (2017), eq. 7.76.
    """
    angle = np.maximum(np.sqrt((vector**2).sum(0)), 1e-3)  # below, the factor is 1/12 to 1e-9
    vector = np.broadcast_to(vector, rotations.shape)
    product = cross(vector, rotations)
    return (
        rotations
        - product / 2
        + (1 - angle / 2 / np.tan(angle / 2)) / angle**2 * cross(vector, product)
    )


def _position_rows(rows):
    return np.concatenate([rows, np.zeros_like(rows)], 1)


def _rotation_rows(rotations):
    return np.concatenate([np.zeros_like(rotations), rotations], 1)
