"""The two hand-eye chains: from a board or a ball, by way of the flange, to what the sensor saw.

Both have shared parameters (where the sensor sits, where the target stands, and what of the
instrument is to be adjusted) and, for every pose, the error of the robot's own pose (`family`
"pose"): the robot was not quite where it said. Derivatives are analytic, all samples at a time.

In hand:  p_sensor = X^-1 T^-1 B p_board,   X = T_flange_sensor, T = T_base_flange, B = T_base_board.
To hand:  p_sensor = X^-1 T   B p_board,    X = T_base_sensor,                      B = T_flange_board.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sensors.camera.model import Camera
from workbench.core.parameters import Parameter, Parameters
from workbench.core.rigid import inverse, left_jacobian, rotation_matrix, skew

POSE = "pose"
_TURNS = {"x": "mm", "y": "mm", "z": "mm", "rx": "rad", "ry": "rad", "rz": "rad"}
_WORDS = (
    "position along x",
    "position along y",
    "position along z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
)
_LEAST_CUT = 0.02  # of the radius: a plane that misses the ball still has a circle, for the solve to come back
PLACE, TURN = 10.0, 0.05
"""Typical sizes, mm and rad: how well one knows by a ruler where a sensor sits."""
SCALE = 1e-3
"""1 sigma of a board's scale: what a print or its measuring with a ruler is off by."""


@dataclass(frozen=True)
class Group:
    """One variance component of the pose error: `components` of the family, unit, and the least sigma."""

    name: str
    unit: str
    components: slice
    typical: float
    min_sigma: float


@dataclass(frozen=True)
class Evaluation:
    """Residual (m, n); `shared` (F, m, n) and `pose` (L, m, n) its derivatives."""

    residual: np.ndarray
    shared: np.ndarray
    pose: np.ndarray

    def own_rows(self, indices):
        return self.shared[indices]

    def family_rows(self, name):
        return self.pose


def pose_table(where: str, body: str) -> list[Parameter]:
    """Six parameters of the pose of `body`: mm, and a rotation vector in rad."""
    return [
        Parameter(f"{where}.{name}", unit, 0.0, PLACE if unit == "mm" else TURN, f"{body}: {words}")
        for (name, unit), words in zip(_TURNS.items(), _WORDS)
    ]


def _camera_mode(number: int) -> Parameter:
    """A component of the camera's covariance, numbered from 1; its size is in standard deviations."""
    words = f"the camera, component {number} of its covariance"
    return Parameter(f"camera.mode-{number}", "1", 0.0, 1.0, words, 1.0)


@dataclass(frozen=True)
class BoardChain:
    """Corners or circles of a board: pixels (2, n) of board points (3, n) mm, at poses (n,).

    The error of a pose (L = 6) moves the board: a shift, and a rotation about `pivot` (P, 3), mm, in the
    base ("in-hand") or the flange ("to-hand").
    Shared: sensor, board, by how much the board is larger than it is said to be, and the camera.
    `modes` (9 or 12, M): changes of the camera's values per unit of each free camera parameter,
    which has a prior of 1: a square root of the covariance with which the camera is known.
    `printed` (3, n) mm: the points as they are on the board, to which `board` adds what moves the centre of an
    ellipse in its image; None where that is nothing.
    """

    kind: str
    camera: Camera
    board: np.ndarray
    pixels: np.ndarray
    flange: np.ndarray
    pose: np.ndarray
    errors: np.ndarray
    modes: np.ndarray
    pivot: np.ndarray
    noise: float = 1.0
    printed: np.ndarray | None = None

    state = None
    relative = 1.0
    groups = (
        Group("position", "mm", slice(0, 3), 1.0, 1e-4),
        Group("rotation", "rad", slice(3, 6), 1e-3, 1e-7),
    )

    @property
    def sigma(self) -> np.ndarray:
        """(2, 1) px."""
        return np.full((2, 1), self.noise)

    @cached_property
    def parameters(self) -> Parameters:
        table = pose_table("sensor", "the camera") + pose_table("target", "the board")
        table.append(
            Parameter("target.scale", "1", 0.0, SCALE, "the board: scale of its squares", SCALE)
        )
        table += [_camera_mode(number) for number in range(1, self.modes.shape[1] + 1)]
        return Parameters.of(table)

    @property
    def labels(self) -> Mapping[str, np.ndarray]:
        return {POSE: self.pose}

    def with_families(self, families: Mapping[str, np.ndarray]) -> "BoardChain":
        return replace(self, errors=families.get(POSE, self.errors))

    def at(self, samples: np.ndarray) -> "BoardChain":
        return replace(
            self,
            board=self.board[:, samples],
            pixels=self.pixels[:, samples],
            pose=self.pose[samples],
            printed=None if self.printed is None else self.printed[:, samples],
        )

    def camera_at(self, values: np.ndarray) -> Camera:
        """The camera under the shared parameters `values`."""
        return Camera.of(self.camera.values + self.modes @ values[13:], self.camera.size)

    def board_at(self, values: np.ndarray) -> np.ndarray:
        """(3, n) mm, the points on the board under the shared parameters `values`."""
        return self.board * (1 + values[12])

    def evaluate(self, values: np.ndarray, deltas=None) -> Evaluation:
        """Residual (2, n) px, predicted minus measured, and its derivatives at shared `values`."""
        rotations = rotation_matrix(np.stack([values[3:6], values[9:12]]))
        carried = rotations[1] @ self.board_at(values)
        moved, by_placed, by_error = self._through_flange(carried + values[6:9, None])
        local = rotations[0].T @ (moved - values[:3, None])
        pixels, by_point, by_camera = self.camera_at(values).project_rows(local)
        by_moved = np.einsum(
            "jcn,jk->kcn", by_point, rotations[0].T
        )  # pixel by point in the mount's frame
        by_place = np.einsum("kcn,kjn->jcn", by_moved, by_placed)
        shared = np.concatenate(
            [
                -by_moved,
                np.einsum(
                    "jcn,jkn->kcn", by_point, _by_inverse_rotation_vector(local, values[3:6])
                ),
                by_place,
                np.einsum("jcn,jkn->kcn", by_place, _by_rotation_vector(carried, values[9:12])),
                np.einsum("jcn,jn->cn", by_place, rotations[1] @ self.board)[None],
                np.einsum("vcn,vm->mcn", by_camera, self.modes),
            ]
        )
        return Evaluation(
            pixels - self.pixels, shared, np.einsum("jcn,jkn->kcn", by_moved, by_error)
        )

    def _through_flange(self, placed):
        """Points (3, n) moved by the error and carried through the flange; derivatives by the point
        and by the error (3, 3 | 6, n)."""
        flange = (inverse(self.flange) if self.kind == "in-hand" else self.flange)[self.pose]
        error = self.errors[self.pose]
        pivot = self.pivot[self.pose].T
        rotation = flange[:, :3, :3] @ rotation_matrix(error[:, 3:])
        spun = np.einsum("nij,jn->in", rotation_matrix(error[:, 3:]), placed - pivot)
        moved = (
            np.einsum("nij,jn->in", flange[:, :3, :3], spun + pivot + error[:, :3].T)
            + flange[:, :3, 3].T
        )
        out = np.moveaxis(flange[:, :3, :3], 0, -1)
        by_rotation = np.einsum("ijn,jkn->ikn", out, _by_rotation_vector(spun, error[:, 3:]))
        return moved, np.moveaxis(rotation, 0, -1), np.concatenate([out, by_rotation], 1)


@dataclass(frozen=True)
class BallChain:
    """Profiles of one ball: points (2, n) mm, x and z in the light plane y = 0, at poses (n,).

    Residual: radius of the circle in which the plane cuts the ball, less the distance of the point
    from its centre, mm, within the light plane. `relative` (n,): how much more than the least noisy
    a point's residual may be off. The error of a pose (L = 4) is one offset of the flange at the
    ball: from one ball at one place an error in position and one in rotation are confounded;
    and by how much the profiler shows the circle too large (its linearity, the ball's gloss):
    thousands of points know a circle to a fraction of a micrometre, the profiler does not.
    """

    points: np.ndarray
    radius: float
    flange: np.ndarray
    pose: np.ndarray
    errors: np.ndarray
    relative: np.ndarray
    noise: float = 1.0

    state = None
    groups = (
        Group("position at the ball", "mm", slice(0, 3), 1.0, 1e-4),
        Group("radius of the circle", "mm", slice(3, 4), 0.1, 1e-5),
    )

    @property
    def sigma(self) -> np.ndarray:
        """(1, n) mm."""
        return self.noise * self.relative[None]

    @cached_property
    def parameters(self) -> Parameters:
        table = pose_table("sensor", "the profiler") + [
            Parameter(f"target.{name}", "mm", 0.0, PLACE, f"the ball: position along {name}")
            for name in "xyz"
        ]
        table.append(Parameter("target.radius", "mm", self.radius, 1.0, "the ball: radius"))
        table.append(
            Parameter("sensor.range_scale", "1", 0.0, 0.02, "the profiler: scale error of its z")
        )
        return Parameters.of(table)

    @property
    def labels(self) -> Mapping[str, np.ndarray]:
        return {POSE: self.pose}

    def with_families(self, families: Mapping[str, np.ndarray]) -> "BallChain":
        return replace(self, errors=families.get(POSE, self.errors))

    def at(self, samples: np.ndarray) -> "BallChain":
        return replace(
            self,
            points=self.points[:, samples],
            pose=self.pose[samples],
            relative=self.relative[samples],
        )

    def centres(self, values: np.ndarray) -> np.ndarray:
        """(P, 3) mm, the ball in the profiler's frame at every pose."""
        rotation = self.flange[:, :3, :3]
        displacement = values[6:9] - self.flange[:, :3, 3] - self.errors[:, :3]
        in_flange = np.einsum("pji,pj->pi", rotation, displacement)
        from_sensor = in_flange - values[:3]
        return from_sensor @ rotation_matrix(values[3:6])

    def evaluate(self, values: np.ndarray, deltas=None) -> Evaluation:
        """Residual (1, n) mm, predicted minus measured, and its derivatives at shared `values`."""
        rotation = rotation_matrix(values[3:6])
        centre = self.centres(values)
        seen = self._seen(values)
        cut = np.sqrt(np.maximum(values[9] ** 2 - centre[:, 1] ** 2, (_LEAST_CUT * values[9]) ** 2))
        from_centre = seen - centre[self.pose][:, [0, 2]].T
        length = np.hypot(*from_centre)
        by_centre = np.stack(
            [from_centre[0] / length, -(centre[:, 1] / cut)[self.pose], from_centre[1] / length]
        )
        by_flange = rotation @ by_centre  # along the flange's axes, still by the ball's centre
        by_base = np.einsum("nij,jn->in", self.flange[self.pose, :3, :3], by_flange)
        by_rotation = np.einsum(
            "jn,jkn->kn",
            by_centre,
            _by_inverse_rotation_vector(centre.T, values[3:6])[..., self.pose],
        )
        by_scale = by_centre[2] * self.points[1] / (1 + values[10]) ** 2
        shared = np.concatenate(
            [-by_flange, by_rotation, by_base, (values[9] / cut)[None, self.pose], by_scale[None]]
        )
        residual = cut[self.pose] + self.errors[self.pose, 3] - length
        by_error = np.concatenate([-by_base, np.ones((1, len(length)))])
        return Evaluation(residual[None], shared[:, None], by_error[:, None])

    def distances(self, values: np.ndarray) -> np.ndarray:
        """(n,) mm, of the points from the surface of the ball, outside positive, robot held exact."""
        exact_robot = replace(self, errors=np.zeros_like(self.errors))
        centre = exact_robot.centres(values)[self.pose]
        lateral, axial = self._seen(values) - centre[:, [0, 2]].T
        from_centre = np.sqrt(lateral**2 + axial**2 + centre[:, 1] ** 2)
        return from_centre - values[9]

    def _seen(self, values):
        """(2, n) points with the scale of z put right: the profiler reads (1 + scale) times the true z."""
        return self.points / np.array([[1.0], [1 + values[10]]])


def _by_rotation_vector(carried, vector):
    """(3, 3, n) derivative of Exp(v) p by v, at Exp(v) p = `carried` (3, n); v (3,) or (n, 3)."""
    return -np.moveaxis(skew(carried.T) @ left_jacobian(vector), 0, -1)


def _by_inverse_rotation_vector(local, vector):
    """(3, 3, n) derivative of Exp(v)^T p by v, at Exp(v)^T p = `local` (3, n); v (3,) or (n, 3)."""
    return np.moveaxis(skew(local.T) @ left_jacobian(-np.asarray(vector)), 0, -1)
