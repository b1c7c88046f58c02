"""`ball-centre`: centres of balls of a measured artefact, seen in the frame of a sensor on the flange."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    kronecker_rows,
    numbered,
    position_sigma,
)
from robot_model.measurements.multistart import (
    MODEL_ERROR_MM,
    ORIGIN_PRIOR_MM,
    TOOL_PRIOR_MM,
    RotationSystem,
)
from robot_model.poses import pose_parameters, pose_values
from workbench.core.parameters import Parameter
from workbench.core.rigid import left_jacobian, rotation_matrix


@dataclass(frozen=True)
class BallCentre:
    """Measured centres (3, n) mm in the sensor frame; `centres` (K, 3) mm in the artefact frame."""

    measured: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    centres: np.ndarray
    place = "sensor"
    grounded = False

    @classmethod
    def of(cls, recording) -> "BallCentre":
        """From a recording with an artefact."""
        ids, index = numbered(recording.ball)
        centres = np.array([recording.balls[int(i)][:3] for i in ids])
        return cls(np.ascontiguousarray(recording.points.T), index, ids, centres)

    def parameters(self) -> list[Parameter]:
        """Hand-eye transform T_flange_sensor."""
        return pose_parameters("sensor", "hand-eye")

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the ball of each sample, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) nominal places of the balls on the artefact, mm."""
        return self.centres[self.index].T

    def sigma(self, recording) -> np.ndarray:
        """(3, n) mm; 1 where the recording does not say, and the solve then estimates it."""
        return position_sigma(recording)

    def at(self, samples: np.ndarray) -> "BallCentre":
        return replace(self, measured=self.measured[:, samples], index=self.index[samples])

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """Predicted minus measured (3, n) in the sensor frame; the world is the artefact."""
        rotation = rotation_matrix(values[3:])
        axes = [sum(e * r for e, r in zip(frames.end, column)) for column in rotation.T]
        ball = self.centres[self.index].T
        if "target" in deltas:
            ball = add_delta(ball, deltas["target"])
        from_sensor = ball - frames.point(values[:3])
        seen = np.stack([(axis * from_sensor).sum(0) for axis in axes])
        predicted = add_delta(seen, deltas["sensor"]) if "sensor" in deltas else seen
        # turning the hand-eye by dw (flange frame) moves the seen point by seen x (R^T dw)
        rotation_rows = rotation.T @ left_jacobian(values[3:])
        tool_rows = np.empty((6, 3, len(self.index)))
        tool_rows[:3] = -rotation[:, :, None]
        tool_rows[3:] = cross(seen, rotation_rows.T[:, :, None])
        ports = {
            "sensor": np.broadcast_to(np.eye(3)[:, :, None], (3, 3, seen.shape[1])),
            "target": _columns(axes),
        }
        return Closure(
            predicted - self.measured,
            ball,
            lambda rows: -_in_axes(axes, rows),
            tool_rows,
            ports,
            to_world=lambda seen: sum(axis * row for axis, row in zip(axes, seen)),
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Base pose (6,) and hand-eye (6,) of the best of the local minima over both rotations.

        R_b^T (c - mean c) + t - R_f R_h s - R_f t_h = t_f - mean t_f, with X_1 = R_b^T, X_2 = R_h, balls c in the
        frame of the artefact and s as seen.
        """
        start = self.system(frames).starts()[0]
        rotation = start.rotations[0].T
        shift = frames.end_origin.mean(1) + start.translations[:3]
        base = pose_values(rotation, self._ball_centroid() - rotation @ shift)
        tool = pose_values(start.rotations[1], start.translations[3:])
        return base, tool

    def _ball_centroid(self) -> np.ndarray:
        """(3,) mean of the balls over the samples, artefact frame, mm."""
        return self.centres[self.index].mean(0)

    def system(self, frames: Frames) -> RotationSystem:
        """The equations of `start`, one sample a ball seen."""
        rotations = flange_matrices(frames)
        count = len(rotations)
        balls = (self.centres[self.index] - self._ball_centroid()).T
        by_base = kronecker_rows(balls).reshape(count, 3, 9)
        by_hand = np.einsum("nij,jkn->nik", rotations, _by_matrix(self.measured))
        shift = np.broadcast_to(np.eye(3), (count, 3, 3))
        origins = frames.end_origin - frames.end_origin.mean(1, keepdims=True)
        return RotationSystem(
            np.concatenate([by_base, -by_hand], 2) / MODEL_ERROR_MM,
            np.concatenate([shift, -rotations], 2) / MODEL_ERROR_MM,
            origins.T / MODEL_ERROR_MM,
            np.repeat([ORIGIN_PRIOR_MM, TOOL_PRIOR_MM], 3),
        )

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement plus its residual (3, n)."""
        return dict(zip(("x_mm", "y_mm", "z_mm"), self.measured + residual))


def _in_axes(axes, rows):
    """(k, 3, n) world vectors in the frame with these axes."""
    return np.stack([(axis * rows).sum(1) for axis in axes], 1)


def _columns(axes):
    """(3, 3, n): derivative of the seen point by the world point."""
    return np.stack(axes, 1)


def _by_matrix(vectors):
    """(3, 9, n): row j, column 3 j + k holds vectors[k], so that it times vec(M) is M @ vectors."""
    return np.einsum("ij,kn->ijkn", np.eye(3), vectors).reshape(3, 9, -1)
