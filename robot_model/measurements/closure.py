"""Result of every kind of measurement, and what several kinds share: ports, noise, features that a tool touches."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.parameters import Parameter
from workbench.core.rigid import nearest_rotation

SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")


@dataclass(frozen=True)
class Closure:
    """A closed chain.

    `residual` (m, n); `point` (3, n) the world point (mm) whose motion with the flange is seen;
    `map_rows` turns (k, 3, n) motions of that point, and `map_rotations` (k, 3, n) rotations of the
    flange (rad, world frame), into (k, m, n) of the residual; `map_rotations` is None where
    orientation is not measured; `to_world` turns positions' residuals (3, n) into world arrows.
    `tool_rows` (t, m, n) belong to the kind's own parameters, and
    `port_rows` holds those of the ports `sensor` and `target`.
    """

    residual: np.ndarray
    point: np.ndarray
    map_rows: Callable[[np.ndarray], np.ndarray]
    tool_rows: np.ndarray
    port_rows: dict[str, np.ndarray]
    map_rotations: Callable[[np.ndarray], np.ndarray] | None = None
    to_world: Callable[[np.ndarray], np.ndarray] = lambda residual: residual


def solve_linear_start(blocks: list[np.ndarray], right: np.ndarray) -> np.ndarray:
    """Solution of blocks @ unknowns = right, of least norm at unit columns; blocks (3 n, k_i) side by side."""
    return least_squares(np.concatenate(blocks, 1), right, 1e-10)


def rigid_fit(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) with target = R source + t; points (k, 3)."""
    a = source.mean(0)
    b = target.mean(0)
    matrix = (target - b).T @ (source - a)
    rotation = nearest_rotation(matrix)
    return rotation, b - rotation @ a


def add_delta(points: np.ndarray, delta: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(3, n) points moved by the (components, change (k, n)) of a port, in the frame of the points."""
    port_indices, change = delta
    moved = np.array(
        np.broadcast_to(points, np.broadcast_shapes(points.shape, (3, change.shape[1])))
    )
    moved[port_indices] += change
    return moved


def moved_target(
    point: np.ndarray, axes: np.ndarray, deltas: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """World points (3, n) mm moved by the port `target`, in components along the axes (3, 3, n) of the flange."""
    if "target" not in deltas:
        return point
    port_indices, change = deltas["target"]
    return point + sum(axes[s] * c for s, c in zip(port_indices, change))


def numbered(column: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """The different numbers of a column, ascending, and which of them (n,) each sample has."""
    ids, index = np.unique(column, return_inverse=True)
    return tuple(int(i) for i in ids), index


def tip_parameters() -> list[Parameter]:
    """Three coordinates of a tip on the flange, mm."""
    return [
        Parameter(f"tool.tip_{axis}", "mm", 0.0, 100.0, f"tip {axis} on the flange")
        for axis in "xyz"
    ]


@dataclass(frozen=True)
class Contact:
    """n contacts of a tool with features that nobody measures; `index` (n,) which of the features `ids` each is of.

    `equations`: components of the gap that a contact leaves. The kind's first three values are the tool's place (mm).
    """

    index: np.ndarray
    ids: tuple[int, ...]
    place = "tool"
    grounded = True
    equations = 3

    @property
    def measured(self) -> np.ndarray:
        """(equations, n) mm: a contact leaves no gap."""
        return np.zeros((self.equations, len(self.index)))

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the feature of each contact, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) place of the tool on the flange, mm."""
        return np.repeat(values[:3, None], len(self.index), 1)

    def sigma(self, recording) -> np.ndarray:
        """(equations, n) mm: how well the tool is driven to the feature; 1 where the recording does not say."""
        return position_sigma(recording)[: self.equations]

    def at(self, samples: np.ndarray) -> "Contact":
        return replace(self, index=self.index[samples])

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """A contact has no measured coordinate to write; its joint readings are the measurement."""
        return {}


def kronecker_rows(vectors: np.ndarray) -> np.ndarray:
    """(3 n, 9) matrix that maps a row-major 3x3 matrix M to the stacked M @ vectors; vectors (3, n)."""
    return np.einsum("ij,kn->nijk", np.eye(3), vectors).reshape(-1, 9)


def flange_matrices(frames) -> np.ndarray:
    """(n, 3, 3) rotation of the flange in the world."""
    return np.stack(frames.end, -1).transpose(1, 0, 2)


def position_sigma(recording) -> np.ndarray:
    """(3, n) 1 sigma of a measured coordinate in mm, 1 where the recording does not say.

    Columns sigma_x_mm, sigma_y_mm and sigma_z_mm, where all are there, say it of each coordinate.
    """
    if all(name in recording.columns for name in SIGMAS):
        return np.stack([recording.columns[name] for name in SIGMAS])
    if recording.sigma is None:
        sigma = np.ones(recording.n)
    else:
        sigma = recording.sigma
    return np.tile(sigma, (3, 1))
