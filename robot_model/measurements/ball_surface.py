"""`ball-surface`: points on balls of a measured artefact, seen by a sensor on the flange."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.ball_centre import BallCentre
from robot_model.measurements.closure import Closure, add_delta, numbered, position_sigma
from robot_model.poses import pose_parameters
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter
from workbench.core.rigid import left_jacobian, rotation_matrix

_STEPS = 30


@dataclass(frozen=True)
class BallSurface:
    """Points (3, n) mm in the sensor frame; `balls` (K, 4) centre and radius mm, artefact frame.

    `pose_id` (n,): points with one value were measured from one static pose.
    """

    measured: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    balls: np.ndarray
    pose_id: np.ndarray
    place = "sensor"
    grounded = False

    @classmethod
    def of(cls, recording) -> "BallSurface":
        """From a recording with an artefact."""
        ids, index = numbered(recording.ball)
        balls = np.array([recording.balls[int(i)] for i in ids])
        return cls(
            np.ascontiguousarray(recording.points.T),
            index,
            ids,
            balls,
            recording.poses,
        )

    def parameters(self) -> list[Parameter]:
        """Hand-eye transform T_flange_sensor."""
        return pose_parameters("sensor", "hand-eye")

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the ball of each point, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) nominal centres of the balls on the artefact, mm."""
        return self.balls[self.index, :3].T

    def sigma(self, recording) -> np.ndarray:
        """(1, n) mm; 1 where the recording does not say."""
        return position_sigma(recording)[:1]

    def at(self, samples: np.ndarray) -> "BallSurface":
        return replace(
            self,
            measured=self.measured[:, samples],
            index=self.index[samples],
            pose_id=self.pose_id[samples],
        )

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(1, n) distance from the ball's surface, outwards, mm; the world is the artefact."""
        rotation = rotation_matrix(values[3:])
        seen = self.measured
        centre = self.balls[self.index, :3].T
        if "sensor" in deltas:  # what was measured is the true point and the sensor's error
            port_indices, change = deltas["sensor"]
            seen = add_delta(seen, (port_indices, -change))
        if "target" in deltas:
            centre = add_delta(centre, deltas["target"])
        arm = rotation @ seen
        point = frames.point(arm + values[:3, None])
        out = point - centre
        far = np.sqrt((out**2).sum(0))
        out = out / far
        by_flange = np.stack([(out * axis).sum(0) for axis in frames.end])
        by_rotation = cross(
            left_jacobian(values[3:]).T[:, :, None], np.broadcast_to(arm, (3, *arm.shape))
        )
        tool_rows = np.concatenate([by_flange[:, None], (by_rotation * by_flange).sum(1)[:, None]])
        ports = {"sensor": -(rotation.T @ by_flange)[:, None], "target": -out[:, None]}
        return Closure(
            (far - self.balls[self.index, 3])[None],
            point,
            lambda rows: (rows * out).sum(1)[:, None],
            tool_rows,
            ports,
            to_world=lambda gap: out * gap,
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """A ball fitted to the points of each static pose; then as for ball centres."""
        pairs, first, group = np.unique(
            np.stack([self.pose_id, self.index]), axis=1, return_index=True, return_inverse=True
        )
        centres = np.full((3, pairs.shape[1]), np.nan)
        for k in range(pairs.shape[1]):
            mine = self.measured[:, group.ravel() == k]
            centres[:, k] = _centre(mine, self.balls[pairs[1, k], 3])
        usable = np.isfinite(centres[0])
        if usable.sum() < 4:
            raise InputError(
                f"ball-surface: expected at least 4 poses with 4 points of a ball that are not in one plane, found "
                f"{usable.sum()}; measure more points a pose, or find the hand-eye with `workbench handeye` first"
            )
        rows = first[usable]
        ball = self.index[first[usable]]
        seen = np.unique(ball)
        centre = BallCentre(
            centres[:, usable],
            np.searchsorted(seen, ball),
            tuple(np.asarray(self.ids)[seen].tolist()),
            self.balls[seen, :3],
        )
        return centre.start(_at(frames, rows))

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """A distance from a surface moves no coordinate by itself: the measured point as it was."""
        return dict(zip(("x_mm", "y_mm", "z_mm"), self.measured))


def _centre(points, radius):
    """(3,) centre of the ball of `radius` through points (3, k), nan where they do not say; Gauss-Newton."""
    middle = points.mean(1, keepdims=True)
    if points.shape[1] < 4 or np.linalg.svd(points - middle, compute_uv=False)[-1] < 1e-3 * radius:
        return np.full(3, np.nan)
    system = np.vstack([2 * points, np.ones(points.shape[1])]).T
    centre = np.linalg.lstsq(system, (points**2).sum(0), rcond=None)[0][:3]
    for _ in range(_STEPS):
        out = points - centre[:, None]
        far = np.linalg.norm(out, axis=0)
        centre = centre + np.linalg.lstsq((out / far).T, far - radius, rcond=None)[0]
    return centre


def _at(frames: Frames, rows) -> Frames:
    """The flange's frames of some rows."""
    return replace(
        frames,
        end=tuple(axis[:, rows] for axis in frames.end),
        end_origin=frames.end_origin[:, rows],
    )
