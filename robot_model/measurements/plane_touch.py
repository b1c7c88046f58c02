"""`plane-touch`: a tip on the flange that touches planes; nobody measures where these are."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import Closure, flange_matrices, position_sigma
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.parameters import Parameter
from workbench.core.rigid import left_jacobian, rotation_matrix

_ROUNDS = 50


@dataclass(frozen=True)
class PlaneTouch:
    """n touches; `index` (n,) which of the planes `ids` each is of."""

    index: np.ndarray
    ids: tuple[int, ...]
    place = "tool"
    grounded = True

    @classmethod
    def of(cls, recording) -> "PlaneTouch":
        """From a recording with a column `plane`."""
        ids, index = np.unique(recording.columns["plane"], return_inverse=True)
        return cls(index, tuple(int(i) for i in ids))

    def parameters(self) -> list[Parameter]:
        """The tip on the flange; of each plane two turns of its normal from z, and its distance from the root."""
        tip = [
            Parameter(f"tool.tip_{axis}", "mm", 0.0, 100.0, f"tip {axis} on the flange")
            for axis in "xyz"
        ]
        words = (("rx", "rad", 0.1), ("ry", "rad", 0.1), ("offset", "mm", 100.0))
        return tip + [
            Parameter(f"artefact.plane{k}_{name}", unit, 0.0, size, f"plane {k} {name}")
            for k in self.ids
            for name, unit, size in words
        ]

    @property
    def measured(self) -> np.ndarray:
        """(1, n) mm: a touch leaves no gap."""
        return np.zeros((1, len(self.index)))

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the plane of each touch, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) place of the tip on the flange, mm."""
        return np.repeat(values[:3, None], len(self.index), 1)

    def sigma(self, recording) -> np.ndarray:
        """(1, n) mm; 1 where the recording does not say."""
        return position_sigma(recording)[:1]

    def at(self, samples: np.ndarray) -> "PlaneTouch":
        return replace(self, index=self.index[samples])

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(1, n) distance of the tip from its plane, along the plane's normal, mm."""
        tip = frames.point(values[:3])
        planes = values[3:].reshape(-1, 3)
        axes = np.stack(frames.end)
        if "target" in deltas:
            port_indices, change = deltas["target"]
            tip = tip + sum(axes[s] * c for s, c in zip(port_indices, change))
        tilt = np.column_stack([planes[:, :2], np.zeros(len(planes))])
        normals = rotation_matrix(tilt)[:, :, 2]
        rotated = np.cross(
            np.swapaxes(left_jacobian(tilt), 1, 2)[:, :2], normals[:, None]
        )  # (K, 2, 3)
        normal = normals[self.index].T
        across = np.einsum("nkc,cn->kn", rotated[self.index], tip)
        columns = np.stack([*across, np.full(len(self.index), -1.0)])
        mine = np.arange(len(planes))[:, None] == self.index
        plane_rows = (mine[:, None] * columns).reshape(-1, 1, len(self.index))
        along = (axes * normal).sum(1)[:, None]
        residual = (normal * tip).sum(0) - planes[self.index, 2]
        return Closure(
            residual[None],
            tip,
            lambda rows: (rows * normal).sum(1)[:, None],
            np.concatenate([along, plane_rows]),
            {"target": along, "sensor": normal[:, None]},
            to_world=lambda gap: normal * gap,
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Planes through the tips and the tip that lies on them, by turns, from the flange's middle."""
        rotations = flange_matrices(frames)
        origins = frames.end_origin.T
        tip = np.zeros(3)
        for _ in range(_ROUNDS):
            normals, middles = self._planes(origins + rotations @ tip)
            normal = normals[self.index]
            rows = np.einsum("ni,nij->nj", normal, rotations)
            right = -(normal * (origins - middles[self.index])).sum(1)
            ones = np.eye(len(self.ids))[self.index]  # each plane may shift along its normal
            tip = least_squares(np.column_stack([rows, -ones]), right, 1e-9)[:3]
        normals, middles = self._planes(origins + rotations @ tip)
        tilts = np.stack([-normals[:, 1], normals[:, 0]], 1)
        size = np.linalg.norm(tilts, axis=1, keepdims=True)
        tilts = tilts / np.maximum(size, 1e-300) * np.arctan2(size, normals[:, 2:])
        planes = np.column_stack([tilts, (normals * middles).sum(1)])
        return np.zeros(0), np.concatenate([tip, planes.ravel()])

    def _planes(self, tips):
        """(K, 3) unit normals, none pointing down, and (K, 3) middles of the planes through tips (n, 3)."""
        normals = []
        middles = []
        for k in range(len(self.ids)):
            mine = tips[self.index == k]
            middles.append(mine.mean(0))
            normal = np.linalg.svd(mine - middles[-1])[2][2]
            normals.append(normal if normal[2] >= 0 else -normal)
        return np.array(normals), np.array(middles)

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """A touch has no measured coordinate to write; its joint readings are the measurement."""
        return {}
