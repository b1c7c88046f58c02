"""`external-point`: reflectors on the flange, measured by a tracker or CMM in its own frame."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    kronecker_rows,
    moved_target,
    numbered,
    position_sigma,
)
from robot_model.measurements.multistart import (
    MODEL_ERROR_MM,
    ORIGIN_PRIOR_MM,
    TOOL_PRIOR_MM,
    RotationSystem,
    Start,
)
from robot_model.poses import pose_values
from workbench.core.parameters import Parameter


@dataclass(frozen=True)
class ExternalPoint:
    """Measured points (3, n) mm in the external frame; `index` (n,) which of the reflectors `ids`."""

    measured: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    place = "tool"
    grounded = False

    @classmethod
    def of(cls, recording) -> "ExternalPoint":
        """From a recording; only rows that move with the tool may be in it."""
        ids, index = numbered(recording.reflector)
        return cls(np.ascontiguousarray(recording.points.T), index, ids)

    def parameters(self) -> list[Parameter]:
        """Three coordinates a reflector, flange frame, mm."""
        return [
            Parameter(
                f"tool.reflector{r}_{axis}", "mm", 0.0, 100.0, f"reflector {r} {axis} on the flange"
            )
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
        axes = np.stack(frames.end)
        point = moved_target(frames.point(self.tip(values)), axes, deltas)
        tool_rows = np.concatenate([axes * (self.index == r) for r in range(len(self.ids))])
        predicted = add_delta(point, deltas["sensor"]) if "sensor" in deltas else point
        ports = {"target": axes, "sensor": np.broadcast_to(np.eye(3)[:, :, None], axes.shape)}
        return Closure(predicted - self.measured, point, lambda rows: rows, tool_rows, ports)

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Base pose (6,) and reflectors (3 R,): the best of the local minima over the base's rotation."""
        start = self.system(frames).starts()[0]
        base = base_values(start, frames, self.measured)
        return base, start.translations[3:]

    def system(self, frames: Frames) -> RotationSystem:
        """The equations of `start`, one sample a measured point."""
        return point_system(frames, self.measured, self.index, len(self.ids))

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement plus its residual (3, n)."""
        return dict(zip(("x_mm", "y_mm", "z_mm"), self.measured + residual))


def point_system(
    frames: Frames, measured: np.ndarray, index: np.ndarray, reflectors: int
) -> RotationSystem:
    """X (p - mean p) + t - R_f r = t_f - mean t_f, with X = R_b^T and the reflectors r of the samples.

    measured (3, n) mm, external frame; index (n,) which reflector. Unknown translations: t (3,), then the
    reflectors (3 R,), mm. Rows are in units of `MODEL_ERROR_MM`.
    """
    count = len(index)
    origins = frames.end_origin - frames.end_origin.mean(1, keepdims=True)
    centred = measured - measured.mean(1, keepdims=True)
    one_of = np.eye(reflectors)[index]
    by_reflector = np.einsum("nij,nr->nirj", flange_matrices(frames), one_of).reshape(count, 3, -1)
    shift = np.broadcast_to(np.eye(3), (count, 3, 3))
    prior = np.concatenate([np.full(3, ORIGIN_PRIOR_MM), np.full(3 * reflectors, TOOL_PRIOR_MM)])
    return RotationSystem(
        kronecker_rows(centred).reshape(count, 3, 9) / MODEL_ERROR_MM,
        np.concatenate([shift, -by_reflector], 2) / MODEL_ERROR_MM,
        origins.T / MODEL_ERROR_MM,
        prior,
    )


def base_values(start: Start, frames: Frames, measured: np.ndarray) -> np.ndarray:
    """(6,) base pose of a solution of `point_system`."""
    rotation = start.rotations[0].T
    shift = frames.end_origin.mean(1) + start.translations[:3]
    translation = measured.mean(1) - rotation @ shift
    return pose_values(rotation, translation)
