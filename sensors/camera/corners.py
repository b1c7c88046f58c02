"""The corner chain: where the camera must see the points of a board, and how far off it saw them.

A point of the board goes through the board's pose into the camera frame, along its ray through the
lens onto the image. Ports: `target` (the point on the board, mm), `ray`, `pixel`; the light
plane, the mirror and what happens to a laser's point do not reach a corner, their rows are zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sensors.boards.circles import centre_shift, lens_shift
from sensors.camera.model import Camera
from sensors.state import SensorState
from workbench.core.errors import InputError
from workbench.core.least_squares.bundle import Family
from workbench.core.parameters import Parameter, Parameters
from workbench.core.rigid import left_jacobian, rotation_matrix

PORTS = {"pixel": 2, "ray": 3, "target": 3, "point": 3, "plane": 5, "mirror": 1, "noise": 1}
POSE = ("x", "y", "z", "rx", "ry", "rz")
POSE_UNITS = ("mm",) * 3 + ("rad",) * 3
_MOVED_POSE = np.array([1.0] * 3 + [0.01] * 3)
_LABELS = {
    "fx": "the focal length fx",
    "fy": "the focal length fy",
    "cx": "the principal point cx",
    "cy": "the principal point cy",
    **{f"k{i}": f"the radial distortion k{i}" for i in range(1, 7)},
    "p1": "the tangential distortion p1",
    "p2": "the tangential distortion p2",
}
# Order in r of each coefficient's displacement over the distance from the middle.
_ORDERS = {"k1": 2, "k2": 4, "p1": 1, "p2": 1, "k3": 6, "k4": 2, "k5": 4, "k6": 6}
_FISHEYE_ORDERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 8}
_AT_THE_EDGE = 0.1  # displacement by one coefficient at the edge of the image, over the distance from its middle


def camera_parameters(camera: Camera) -> Parameters:
    """Keys `camera.fx`, ...: focal lengths, principal point and distortion at this camera's values, none free.

    Typical sizes: 2 % of the focal length, 2 % of the image for the principal point, and for each
    coefficient what moves the image's edge by a tenth of its distance from the middle.
    """
    width, height = camera.size
    edge = np.hypot(width, height) / 2 / min(camera.fx, camera.fy)
    orders = _FISHEYE_ORDERS if camera.is_fisheye else _ORDERS
    table = []
    for name, value in zip(camera.names, camera.values.tolist()):
        if name in orders:
            unit = "1"
            typical = _AT_THE_EDGE / edge ** orders[name]
        else:
            unit = "px"
            typical = 0.02 * (camera.fx if name[0] == "f" else max(width, height))
        table.append(Parameter(f"camera.{name}", unit, value, typical, _LABELS[name]))
    return Parameters.of(table)


def placements(poses: np.ndarray) -> Family:
    """The family `placement` of board poses (G, 6): x y z (mm), then the rotation vector (rad), T_camera_board."""
    return Family("placement", np.asarray(poses, float), _MOVED_POSE, None, POSE, POSE_UNITS)


def port_indices(port: str, where: str, components: tuple[int, ...]) -> tuple[int, ...]:
    """The rows of a port of the scanner's chains that `components` name, () for all; InputError for no such port."""
    if port not in PORTS:
        raise InputError(
            f"effect at {where}: expected a port of the scanner ({', '.join(PORTS)}), found {port}; "
            "take an effect of the sensor"
        )
    return tuple(components) or tuple(range(PORTS[port]))


@dataclass(frozen=True)
class Corners:
    """n points of boards, as seen.

    `points` (3, n) mm nominal, board frame; `place` (2, n) from the board's middle over half its
    diagonal; `pixels` (2, n) measured; `labels["placement"]` (n,) row of `poses` (G, 6) of each;
    `sigma` (2, 1) or (2, n) px; `radius` mm of a board's circles, 0 for corners: the middle of a
    circle's image is not the image of its middle, and it is the former that is measured.
    """

    camera: Camera
    points: np.ndarray
    place: np.ndarray
    pixels: np.ndarray
    labels: Mapping[str, np.ndarray]
    poses: np.ndarray
    sigma: np.ndarray = field(default_factory=lambda: np.full((2, 1), 0.1))
    radius: float = 0.0
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    _kept_state: SensorState | None = field(default=None, repr=False)
    _kept_lens: np.ndarray | None = field(default=None, repr=False)

    @cached_property
    def parameters(self) -> Parameters:
        return camera_parameters(self.camera)

    @cached_property
    def state(self) -> SensorState:
        """At the poses and the camera of the start, which effects go on reading while a solve moves them."""
        if self._kept_state is not None:
            return self._kept_state
        board = _OnBoard(self, self.points)
        n = self.pixels.shape[1]
        unknown = np.full((5, n), np.nan)
        expected = self.camera.project(board.points)
        return SensorState(
            self.camera,
            np.where(np.isfinite(expected), expected, self.pixels),
            board.points,
            unknown[:4],
            unknown[4],
            self.place,
            board.normals,
            np.zeros(n, int),
            self.covariates,
            self.points,
            mean_by_label(board.points[2], self.labels["placement"]),
        )

    @cached_property
    def by_lens(self) -> np.ndarray:
        """(2, n) px, `lens_shift` of a board's circles at the start; a solve leaves it as it is."""
        if self._kept_lens is not None:
            return self._kept_lens
        board = _OnBoard(self, self.points)
        aimed = board.points + centre_shift(board.points, board.normals, self.radius)
        return lens_shift(self.camera, aimed, board.normals, self.radius)

    def at(self, samples: np.ndarray) -> "Corners":
        """The same on some of the samples (indices or mask); the poses stay."""
        return replace(
            self,
            points=self.points[:, samples],
            place=self.place[:, samples],
            pixels=self.pixels[:, samples],
            labels={name: label[samples] for name, label in self.labels.items()},
            sigma=self.sigma if self.sigma.shape[1] == 1 else self.sigma[:, samples],
            covariates={name: column[samples] for name, column in self.covariates.items()},
            _kept_state=None,
            _kept_lens=None,
        )

    def moved(self, camera: Camera, poses: np.ndarray) -> "Corners":
        """The same at another start."""
        return replace(self, camera=camera, poses=poses, _kept_state=None, _kept_lens=None)

    def with_families(self, values: Mapping[str, np.ndarray]) -> "Corners":
        """The same with other poses; the state stays that of the start."""
        lens = self.by_lens if self.radius else None
        poses = values.get("placement", self.poses)
        return replace(self, poses=poses, _kept_state=self.state, _kept_lens=lens)

    def port_indices(self, port: str, where: str, components: tuple[int, ...]) -> tuple[int, ...]:
        return port_indices(port, where, components)

    def numbers(self, place: str) -> tuple[int, ...]:
        return ()

    def slides(self, joint: int) -> bool:
        return False

    def evaluate(self, values: np.ndarray, deltas: Mapping) -> "Evaluation":
        """Predicted minus measured (2, n) px at camera values (9,) or (12,) and changes of the ports."""
        return Evaluation(self, Camera.of(values, self.camera.size), deltas)


def mean_by_label(values: np.ndarray, label: np.ndarray) -> np.ndarray:
    """(n,) mean of the values (n,) of each sample's own label (n,)."""
    count = np.bincount(label)
    return (np.bincount(label, values) / np.maximum(count, 1))[label]


class _OnBoard:
    """Points of the boards in the camera frame: `rotated` (3, n) without, `points` (3, n) with the shift."""

    def __init__(self, chain, nominal):
        self.group = chain.labels["placement"]
        self.vectors = chain.poses[:, 3:]
        self.rotation = _matrix_of_point(rotation_matrix(self.vectors), self.group)
        self.rotated = np.stack(
            [
                row[0] * nominal[0] + row[1] * nominal[1] + row[2] * nominal[2]
                for row in self.rotation
            ]
        )
        self.points = self.rotated + chain.poses[:, :3].T[:, self.group]

    @property
    def normals(self):
        """(3, n) the boards' z."""
        return self.rotation[:, 2]

    @property
    def swing(self):
        """(3, 3, n) rotation, camera frame, per unit of each number of the rotation vector (second index)."""
        return _matrix_of_point(left_jacobian(self.vectors), self.group)


def _matrix_of_point(matrices, group):
    """(3, 3, n) from matrices (G, 3, 3) of the groups (n,)."""
    return matrices.reshape(-1, 9).T.take(group, 1).reshape(3, 3, -1)


class Evaluation:
    """The chain at one set of values; rows are derivatives of the residual."""

    def __init__(self, chain: Corners, camera: Camera, deltas: Mapping):
        self._radius = chain.radius
        self._board = _OnBoard(chain, _moved(chain.points, deltas.get("target")))
        self._bend = _moved(np.zeros((3, 1)), deltas["ray"]) if "ray" in deltas else None
        self._aimed = (
            self._board.points if not chain.radius else self._board.points + self._centre_shift
        )
        aim = self._aimed if self._bend is None else self._aimed - self._range * self._bend
        pixels, self._by_aim, self._by_value = camera.project_rows(aim)
        if chain.radius:
            pixels = pixels + chain.by_lens
        self.residual = _moved(pixels, deltas.get("pixel")) - chain.pixels

    @cached_property
    def _tilt(self):
        """(3, n) e_z - n_z n: the camera's axis without its part along the board's normal n."""
        normal = self._board.normals
        tilt = -normal[2] * normal
        tilt[2] += 1
        return tilt

    @property
    def _centre_shift(self):
        """(3, n) mm, from a circle's middle to the point whose image is the middle of the circle's image."""
        return centre_shift(self._board.points, self._board.normals, self._radius)

    @cached_property
    def _range(self):
        return np.sqrt((self._aimed**2).sum(0))

    @cached_property
    def _by_aimed(self):
        """(3, 2, n) by the point that is aimed at, before the ray is bent."""
        if self._bend is None:
            return self._by_aim
        by_range = _dot(self._by_aim, self._bend)
        return self._by_aim - (self._aimed / self._range)[:, None] * by_range

    @cached_property
    def _by_point(self):
        """(3, 2, n) by the point of the board, camera frame."""
        if not self._radius:
            return self._by_aimed
        rows = self._by_aimed.copy()
        rows[2] += self._radius**2 / self._board.points[2] ** 2 * _dot(self._by_aimed, self._tilt)
        return rows

    @property
    def _by_normal(self):
        """(3, 2, n) by the board's normal, on which the aim at a circle depends."""
        normal = self._board.normals
        rows = normal[2] * self._by_aimed
        rows[2] += _dot(self._by_aimed, normal)
        return self._radius**2 / self._board.points[2] * rows

    def own_rows(self, indices: np.ndarray) -> np.ndarray:
        """(k, 2, n) by the camera's values."""
        return self._by_value[indices]

    def rows(self, port: str, port_indices: np.ndarray) -> np.ndarray:
        """(k, 2, n) by components of a port."""
        n = self.residual.shape[1]
        if port == "pixel":
            return np.broadcast_to(np.eye(2)[port_indices][:, :, None], (len(port_indices), 2, n))
        if port == "ray":
            return -self._range * self._by_aim[port_indices]
        if port == "target":
            rotations = self._board.rotation
            return np.stack([_dot(self._by_point, rotations[:, index]) for index in port_indices])
        return np.zeros((len(port_indices), 2, n))

    def family_rows(self, name: str) -> np.ndarray:
        """(6, 2, n) by the numbers of each sample's own board pose."""
        rows = np.empty((6, *self.residual.shape))
        rows[:3] = self._by_point
        moment = _cross(self._board.rotated, self._by_point)
        if self._radius:
            moment += _cross(self._board.normals, self._by_normal)
        swing = self._board.swing
        for k in range(3):
            rows[3 + k] = _dot(moment, swing[:, k])
        return rows


def _moved(values, change):
    """values (k, n) with the components of a port's (components, delta) moved."""
    if change is None:
        return values
    port_indices, delta = change
    moved = np.array(np.broadcast_to(values, (len(values), delta.shape[1])))
    moved[port_indices] += delta
    return moved


def _dot(rows, vector):
    """(2, n) sum over the first axis of rows (3, 2, n) times vector (3, n)."""
    return rows[0] * vector[0] + rows[1] * vector[1] + rows[2] * vector[2]


def _cross(vector, rows):
    """(3, 2, n) vector (3, n) x rows (3, 2, n)."""
    x, y, z = vector
    return np.stack(
        [y * rows[2] - z * rows[1], z * rows[0] - x * rows[2], x * rows[1] - y * rows[0]]
    )
