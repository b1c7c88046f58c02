"""`touch-point`: a tip on the flange that touches fixed points; nobody measures where these are.

Gubankov & Yukhimets, Sensors 22 (2022) 3376, minimise the distances between all pairs of touches of
one point. Here the touched points are unknowns of their own, which is the likelihood of the touches:
the pairs count every touch many times over, and pull link lengths down where driving errs.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    Contact,
    add_delta,
    flange_matrices,
    moved_target,
    numbered,
    solve_linear_start,
    tip_parameters,
)
from workbench.core.parameters import Parameter


@dataclass(frozen=True)
class TouchPoint(Contact):
    """n touches of points, in three components each."""

    @classmethod
    def of(cls, recording) -> "TouchPoint":
        """From a recording with a column `point`."""
        ids, index = numbered(recording.columns["point"])
        return cls(index, ids)

    def parameters(self) -> list[Parameter]:
        """The tip on the flange and the touched points in the robot's root frame, mm."""
        return tip_parameters() + [
            Parameter(f"artefact.point{k}_{axis}", "mm", 0.0, 100.0, f"touched point {k} {axis}")
            for k in self.ids
            for axis in "xyz"
        ]

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(3, n) tip minus point, mm, root frame."""
        points = values[3:].reshape(-1, 3)[self.index].T
        axes = np.stack(frames.end)
        tip = moved_target(frames.point(values[:3]), axes, deltas)
        is_of_point = np.stack([self.index == k for k in range(len(self.ids))]).astype(float)
        point_rows = -np.einsum("pn,ij->pijn", is_of_point, np.eye(3)).reshape(
            -1, 3, len(self.index)
        )
        gap = np.broadcast_to(np.eye(3)[:, :, None], axes.shape)
        residual = tip - points
        if "sensor" in deltas:
            residual = add_delta(residual, deltas["sensor"])
        return Closure(
            residual,
            tip,
            lambda rows: rows,
            np.concatenate([axes, point_rows]),
            {"target": axes, "sensor": gap},
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """No base, and tip x and points p_k from t_f + R_f x - p_k = 0 (their eq. 13), which is linear in both."""
        rotations = flange_matrices(frames)
        points = np.einsum("ij,nk->nikj", np.eye(3), np.eye(len(self.ids))[self.index])
        right = -frames.end_origin.T.ravel()
        blocks = [rotations.reshape(-1, 3), -points.reshape(len(right), -1)]
        return np.zeros(0), solve_linear_start(blocks, right)
