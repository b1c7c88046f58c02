"""The stripe chain: how far, in pixels, a stripe seen on a board lies from where its light plane cuts it.

A pixel of a stripe goes along its ray onto the board; there it must lie in the light plane of its
step. What it misses by, in millimetres, is divided by how much one pixel along the scan line moves
it: the residual is in pixels along that line, where the stripe's centre was measured. Ports:
`pixel`, `ray`, `mirror`, `plane` (normal, offset and curvature), `point` and `target`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from sensors.camera.model import Camera
from sensors.light.shared_errors import SharedStripeErrors, decorrelated
from sensors.light.sight import Sight, StripeChain
from sensors.state import SensorState, stripe_direction
from workbench.core.rigid import left_jacobian, rotation_matrix


@dataclass(frozen=True)
class BoardStripeChain(StripeChain):
    """n points of stripes on boards.

    `pixels` (2, n) measured; `labels`: `placement` (n,) row of `poses` (G, 6) and `step` (n,)
    column of `planes` (4, S), unit normals and offsets (mm), of each; `scan` (2, 1) unit vector along
    the line in which a centre was measured; `sigma` (1, n) or (1, 1) px. `middle` (2,) and
    `half_diagonal` mm of the board. Without `mirror` the planes are free, `change` (S, 3) from where
    they start; with it they are `mirror.planes(angles)`, `angles` (S,) rad as commanded.
    """

    camera: Camera
    pixels: np.ndarray
    labels: Mapping[str, np.ndarray]
    poses: np.ndarray
    planes: np.ndarray
    middle: np.ndarray
    half_diagonal: float
    scan: np.ndarray = field(default_factory=lambda: np.array([[1.0], [0.0]]))
    sigma: np.ndarray = field(default_factory=lambda: np.full((1, 1), 0.1))
    mirror: object = None
    angles: np.ndarray | None = None
    change: np.ndarray | None = None
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    shared_errors: SharedStripeErrors | None = None
    _start: "BoardStripeChain | None" = field(default=None, repr=False, compare=False)
    family = "placement"
    surfaces = "poses"

    @property
    def stripe_place(self) -> np.ndarray:
        """(n,) px, places of points along their stripes."""
        return (self.pixels[::-1] * self.scan).sum(0)

    @cached_property
    def _decorrelation_steps(self):
        if self._start is not None:
            return self._start._decorrelation_steps
        return self.shared_errors.steps_apart(np.broadcast_to(self.sigma, (1, self.n))[0])

    def decorrelated(self, rows: np.ndarray, between_groups: bool = True) -> np.ndarray:
        """(..., n) residuals or their derivatives without what points share: left is noise of `sigma` in each.

        between_groups: also what stripes of a board pose share; only for what is not one step's own.
        """
        if self.shared_errors is None:
            return rows
        within_groups, between_steps = self._decorrelation_steps
        return decorrelated(
            [*within_groups, *between_steps] if between_groups else within_groups, rows
        )

    @property
    def between_groups(self) -> tuple[np.ndarray, float] | None:
        """Shape (n,), where what the points of a stripe share is taken off, and variance of a board pose's error."""
        if self.shared_errors is None or not self.shared_errors.sigma[2]:
            return None
        return decorrelated(self._decorrelation_steps[0], self.shared_errors.shapes[2]), float(
            self.shared_errors.sigma[2] ** 2
        )

    @cached_property
    def state(self) -> SensorState:
        """At the start's camera, poses and planes, which effects go on reading while a solve moves them."""
        if self._start is not None:
            return self._start.state
        evaluation = self.at_start
        on_board = evaluation.on_board
        return SensorState(
            self.camera,
            self.expected_pixels,
            evaluation.hits,
            self.planes[:, self.labels["step"]],
            self.commanded_angles,
            (on_board[:2] - self.middle[:, None]) / self.half_diagonal,
            evaluation.normal,
            np.zeros(self.n, int),
            self.covariates,
            on_board,
            self._middle_depth[self.labels["placement"]],
        )

    @property
    def _middle_depth(self) -> np.ndarray:
        """(G,) mm, depth of the board's middle, on which the lens was focused."""
        rotation = rotation_matrix(self.poses[:, 3:])
        return self.poses[:, 2] + rotation[:, 2, :2] @ self.middle[:2]

    def at(self, samples: np.ndarray) -> "BoardStripeChain":
        """The same on some of the samples (indices or mask); poses and planes stay."""
        shared_errors = None if self.shared_errors is None else self.shared_errors.at(samples)
        return replace(super().at(samples), shared_errors=shared_errors)

    @property
    def evaluation(self) -> type["Evaluation"]:
        return Evaluation


class Evaluation(Sight):
    """The chain at one set of values; rows are derivatives of the residual, in px per unit."""

    def __init__(self, chain: BoardStripeChain, values: np.ndarray, deltas: Mapping, gain):
        super().__init__(chain, values, deltas, gain)
        self._hit()
        self._miss()
        self.residual = (self.miss / gain)[None]

    def _hit(self):
        """Intersections of the rays of the pixels with the boards."""
        chain = self.chain
        group = self.chain.labels["placement"]
        normals = rotation_matrix(chain.poses[:, 3:])[:, :, 2]
        self.normal = normals[group].T
        self.facing = (self.normal * self.ray).sum(0)
        height = (normals * chain.poses[:, :3]).sum(1)[group] + self._delta("target")[2]
        self.depth = height / self.facing
        self.hits = self.ray * self.depth

    def _miss(self):
        """Distances of the intersections from their light planes, mm, and their derivatives."""
        self.place = self.hits + self._delta("point")
        change = self._delta("plane")
        self.plane = self._planes() + change[:4]
        curvature = change[4]
        self.slope = self.plane[:3]
        self.miss = (self.slope * self.place).sum(0) + self.plane[3]
        if curvature.any():
            stripe_axis = stripe_direction(self.chain.planes)[:, self.chain.labels["step"]]
            self.stripe_place = (stripe_axis * self.place).sum(0)
            self.slope = self.slope + 2 * curvature * self.stripe_place * stripe_axis
            self.miss = self.miss + curvature * self.stripe_place**2

    @cached_property
    def grazing(self) -> np.ndarray:
        """(n,) mm by which the hit leaves the plane per mm that the board comes towards the hit along its normal."""
        return (self.slope * self.ray).sum(0) / self.facing

    @cached_property
    def by_ray(self) -> np.ndarray:
        """(3, n) mm per unit of the ray (x/z, y/z, 1)."""
        return self.depth * (self.slope - self.grazing * self.normal)

    @property
    def on_board(self) -> np.ndarray:
        """(3, n) mm, the hits in the frame of their board."""
        poses = self.chain.poses
        group = self.chain.labels["placement"]
        rotation = rotation_matrix(poses[:, 3:])[group]
        return np.einsum("nij,in->jn", rotation, self.hits - poses[group, :3].T)

    def _by_planes(self, rows):
        """(P, n) mm from changes of planes (P, 4, n)."""
        distance = rows[:, 3]
        for axis in range(3):
            distance = distance + rows[:, axis] * self.place[axis]
        return distance

    def family_rows(self, name: str) -> np.ndarray:
        """(6, 1, n) for the board pose, or (3, 1, n) for the step's plane."""
        return (self._pose_rows() / self.gain)[:, None] if name == "placement" else self.step_rows()

    def _pose_rows(self):
        poses = self.chain.poses
        group = self.chain.labels["placement"]
        shift = self.grazing * self.normal
        lever = np.cross(self.hits - poses[group, :3].T, shift, axis=0)
        rotation = left_jacobian(poses[:, 3:])[group]
        return np.concatenate([shift, np.einsum("nij,in->jn", rotation, lever)])

    def _target_rows(self):
        return np.stack([np.zeros_like(self.grazing)] * 2 + [self.grazing])

    def _plane_rows(self):
        stripe_axis = stripe_direction(self.chain.planes)[:, self.chain.labels["step"]]
        stripe_place = (stripe_axis * self.place).sum(0)
        return np.stack([*self.place, np.ones(self.chain.n), stripe_place**2])

    ports = MappingProxyType(
        {
            "pixel": lambda evaluation: -evaluation.by_pixel,
            "ray": lambda evaluation: evaluation.by_ray * evaluation.length,
            "mirror": Sight.mirror_rows,
            "plane": _plane_rows,
            "point": lambda evaluation: evaluation.slope,
            "target": _target_rows,
        }
    )
