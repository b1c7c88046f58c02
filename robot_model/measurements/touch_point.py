"""`touch-point`: a tip on the flange that touches fixed points; nobody measures where these are.

Gubankov & Yukhimets, Sensors 22 (2022) 3376, minimise the distances between all pairs of touches of
one point. Here the touched points are unknowns of their own, which is the likelihood of the touches:
the pairs count every touch many times over, and pull link lengths down where driving errs.
"""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    flange_matrices,
    position_sigma,
    solve_linear_start,
)
from workbench.core.parameters import Parameter


@dataclass(frozen=True)
class TouchPoint:
    """n touches; `index` (n,) which of the points `ids` each is of."""

    index: np.ndarray
    ids: tuple[int, ...]
    place = "tool"
    grounded = True

    @classmethod
    def of(cls, recording) -> "TouchPoint":
        """From a recording with a column `point`."""
        ids, index = np.unique(recording.columns["point"], return_inverse=True)
        return cls(index, tuple(int(i) for i in ids))

    def parameters(self) -> list[Parameter]:
        """The tip on the flange and the touched points in the robot's root frame, mm."""
        tip = [
            Parameter(f"tool.tip_{axis}", "mm", 0.0, 100.0, f"tip {axis} on the flange")
            for axis in "xyz"
        ]
        return tip + [
            Parameter(f"artefact.point{k}_{axis}", "mm", 0.0, 100.0, f"touched point {k} {axis}")
            for k in self.ids
            for axis in "xyz"
        ]

    @property
    def measured(self) -> np.ndarray:
        """(3, n) mm: a touch leaves no gap."""
        return np.zeros((3, len(self.index)))

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the point of each touch, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) place of the tip on the flange, mm."""
        return np.repeat(values[:3, None], len(self.index), 1)

    def sigma(self, recording) -> np.ndarray:
        """(3, n) mm: how well the tip is driven to the point; 1 where the recording does not say."""
        return position_sigma(recording)

    def at(self, samples: np.ndarray) -> "TouchPoint":
        return replace(self, index=self.index[samples])

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(3, n) tip minus point, mm, root frame."""
        tip = frames.point(values[:3])
        points = values[3:].reshape(-1, 3)[self.index].T
        axes = np.stack(frames.end)
        if "target" in deltas:
            port_indices, change = deltas["target"]
            tip = tip + sum(axes[s] * c for s, c in zip(port_indices, change))
        mine = np.stack([self.index == k for k in range(len(self.ids))]).astype(float)
        point_rows = -np.einsum("pn,ij->pijn", mine, np.eye(3)).reshape(-1, 3, len(self.index))
        gap = np.broadcast_to(np.eye(3)[:, :, None], axes.shape)
        residual = tip - points
        if "sensor" in deltas:
            residual = residual + _spread(deltas["sensor"], residual.shape)
        return Closure(
            residual,
            tip,
            lambda rows: rows,
            np.concatenate([axes, point_rows]),
            {"target": axes, "sensor": gap},
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """t_f + R_f x - p_k = 0 is linear in the tip x and the points p_k (their eq. 13, all series at once)."""
        rotations = flange_matrices(frames)
        points = np.einsum("ij,nk->nikj", np.eye(3), np.eye(len(self.ids))[self.index])
        right = -frames.end_origin.T.ravel()
        return np.zeros(0), solve_linear_start(
            [rotations.reshape(-1, 3), -points.reshape(len(right), -1)], right
        )

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """A touch has no measured coordinate to write; its joint readings are the measurement."""
        return {}


def _spread(delta, shape):
    """(3, n) of the (components, change) of a port."""
    port_indices, change = delta
    spread = np.zeros(shape)
    spread[port_indices] = change
    return spread
