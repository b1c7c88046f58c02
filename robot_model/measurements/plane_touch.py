"""`plane-touch`: a tip on the flange that touches planes; nobody measures where these are."""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    Contact,
    flange_matrices,
    moved_target,
    numbered,
    tip_parameters,
)
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.parameters import Parameter
from workbench.core.rigid import left_jacobian, rotation_matrix

_ROUNDS = 50


@dataclass(frozen=True)
class PlaneTouch(Contact):
    """n touches of planes, along their normals."""

    equations = 1

    @classmethod
    def of(cls, recording) -> "PlaneTouch":
        """From a recording with a column `plane`."""
        ids, index = numbered(recording.columns["plane"])
        return cls(index, ids)

    def parameters(self) -> list[Parameter]:
        """The tip on the flange; of each plane two turns of its normal from z, and its distance from the root."""
        words = (("rx", "rad", 0.1), ("ry", "rad", 0.1), ("offset", "mm", 100.0))
        return tip_parameters() + [
            Parameter(f"artefact.plane{k}_{name}", unit, 0.0, size, f"plane {k} {name}")
            for k in self.ids
            for name, unit, size in words
        ]

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(1, n) distance of the tip from its plane, along the plane's normal, mm."""
        planes = values[3:].reshape(-1, 3)
        axes = np.stack(frames.end)
        tip = moved_target(frames.point(values[:3]), axes, deltas)
        tilt = np.column_stack([planes[:, :2], np.zeros(len(planes))])
        normals = rotation_matrix(tilt)[:, :, 2]
        rotated = np.cross(
            np.swapaxes(left_jacobian(tilt), 1, 2)[:, :2], normals[:, None]
        )  # (K, 2, 3)
        normal = normals[self.index].T
        tip_rows = np.einsum("nkc,cn->kn", rotated[self.index], tip)
        columns = np.stack([*tip_rows, np.full(len(self.index), -1.0)])
        is_of_plane = np.arange(len(planes))[:, None] == self.index
        plane_rows = (is_of_plane[:, None] * columns).reshape(-1, 1, len(self.index))
        axis_rows = (axes * normal).sum(1)[:, None]
        residual = (normal * tip).sum(0) - planes[self.index, 2]
        return Closure(
            residual[None],
            tip,
            lambda rows: (rows * normal).sum(1)[:, None],
            np.concatenate([axis_rows, plane_rows]),
            {"target": axis_rows, "sensor": normal[:, None]},
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
            plane_columns = np.eye(len(self.ids))[
                self.index
            ]  # each plane may shift along its normal
            tip = least_squares(np.column_stack([rows, -plane_columns]), right, 1e-9)[:3]
        normals, middles = self._planes(origins + rotations @ tip)
        tilts = np.stack([-normals[:, 1], normals[:, 0]], 1)
        size = np.linalg.norm(tilts, axis=1, keepdims=True)
        tilts = tilts / np.maximum(size, 1e-300) * np.arctan2(size, normals[:, 2:])
        planes = np.column_stack([tilts, (normals * middles).sum(1)])
        tool = np.concatenate([tip, planes.ravel()])
        return np.zeros(0), tool

    def _planes(self, tips):
        """(K, 3) unit normals, none pointing down, and (K, 3) middles of the planes through tips (n, 3)."""
        normals = []
        middles = []
        for k in range(len(self.ids)):
            plane_tips = tips[self.index == k]
            middles.append(plane_tips.mean(0))
            normal = np.linalg.svd(plane_tips - middles[-1])[2][2]
            normals.append(normal if normal[2] >= 0 else -normal)
        return np.array(normals), np.array(middles)
