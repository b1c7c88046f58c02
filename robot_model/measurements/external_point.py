"""`external-point`: reflectors on the flange, measured by a tracker or CMM in its own frame."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    kronecker_rows,
    position_sigma,
    solve_linear_start,
)
from robot_model.poses import pose_values
from workbench.core.parameters import Parameter
from workbench.core.rigid import nearest_rotation


@dataclass(frozen=True)
class ExternalPoint:
    """Measured points (3, n) mm in the external frame; `index` (n,) which of the reflectors `ids`."""

    measured: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    place, grounded = "tool", False

    @classmethod
    def of(cls, recording) -> "ExternalPoint":
        """From a recording; only rows that move with the tool may be in it."""
        ids, index = np.unique(recording.reflector, return_inverse=True)
        return cls(np.ascontiguousarray(recording.points.T), index, tuple(int(i) for i in ids))

    def parameters(self) -> list[Parameter]:
        """Three coordinates a reflector, flange frame, mm."""
        return [
            Parameter(f"tool.reflector{r}_{axis}", "mm", 0.0, 100.0, f"reflector {r} {axis} on the flange")
            for r in self.ids
            for axis in "xyz"
        ]

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the reflector of each sample, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) places of the reflectors on the flange, mm, for the kind's own values."""
        return self.tip(values)

    def sigma(self, recording) -> np.ndarray:
        """(3, n) mm; 1 where the recording does not say, and the solve then estimates it."""
        return position_sigma(recording)

    def at(self, samples: np.ndarray) -> "ExternalPoint":
        return replace(self, measured=self.measured[:, samples], index=self.index[samples])

    def tip(self, values: np.ndarray) -> np.ndarray:
        """(3, n) flange coordinates of the reflector of each sample."""
        return values.reshape(-1, 3)[self.index].T

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """Predicted minus measured (3, n) in the external frame."""
        point = frames.point(self.tip(values))
        if "target" in deltas:
            slots, change = deltas["target"]
            point = point + sum(frames.end[s] * c for s, c in zip(slots, change))
        axes = np.stack(frames.end)
        tool_rows = np.concatenate([axes * (self.index == r) for r in range(len(self.ids))])
        predicted = add_delta(point, deltas["sensor"]) if "sensor" in deltas else point
        ports = {"target": axes, "sensor": np.broadcast_to(np.eye(3)[:, :, None], axes.shape)}
        return Closure(predicted - self.measured, point, lambda rows: rows, tool_rows, ports)

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """R_b^T X - R_b^T t_b = R_f p + t_f is linear in R_b^T, R_b^T t_b and the reflectors p."""
        turns = flange_matrices(frames)
        reflectors = np.einsum("nij,nr->nirj", turns, np.eye(len(self.ids))[self.index])
        identity = np.tile(np.eye(3), (len(self.index), 1))
        right = frames.end_origin.T.ravel()
        blocks = [kronecker_rows(self.measured), identity, -reflectors.reshape(len(right), -1)]
        solution = solve_linear_start(blocks, right)
        rotation = nearest_rotation(solution[:9].reshape(3, 3))
        again = solve_linear_start(blocks[1:], right - blocks[0] @ rotation.ravel())
        return pose_values(rotation.T, -rotation.T @ again[:3]), again[3:]

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement plus its residual (3, n)."""
        return dict(zip(("x_mm", "y_mm", "z_mm"), self.measured + residual))
