"""The ball chain: how far, in pixels, a stripe seen on a ball lies from where a ball of known size would have it.

A pixel of a stripe goes along its ray into the light plane of its step; there it must lie on the
ball. What it misses by along the ball's normal, in millimetres, is divided by how much one pixel
along the scan line moves it. Ports are those of the stripe chain; `target` moves the ball's surface.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from sensors.camera.corners import mean_by_label
from sensors.camera.model import Camera
from sensors.light.sight import Sight, StripeChain
from sensors.state import SensorState, stripe_direction
from workbench.core.least_squares.bundle import Family

_MM = ("mm",) * 3


def centres_family(centres: np.ndarray) -> Family:
    """The family `ball`: centres (B, 3) mm, camera frame, one a ball of a scan."""
    return Family("ball", np.asarray(centres, float), np.ones(3), None, ("x", "y", "z"), _MM)


@dataclass(frozen=True)
class Balls(StripeChain):
    """n points of stripes on balls.

    `pixels` (2, n) measured; `labels`: `ball` (n,) row of `centres` (B, 3) mm and `step` (n,) column of
    `planes` (4, S); `radii` (B,) mm as certified; `number` (B,) as on the certificate, 0 where unknown;
    `scan` (2, 1) unit vector along the line in which centres were measured; `sigma` (1, n) px. Mirror,
    angles and `change` as in the stripe chain. `scan_of` (B,) number of each ball's scan, None where there is one.
    """

    camera: Camera
    pixels: np.ndarray
    labels: Mapping[str, np.ndarray]
    centres: np.ndarray
    radii: np.ndarray
    number: np.ndarray
    planes: np.ndarray
    scan: np.ndarray
    sigma: np.ndarray
    mirror: object = None
    angles: np.ndarray | None = None
    change: np.ndarray | None = None
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    scan_of: np.ndarray | None = None
    _start: "Balls | None" = field(default=None, repr=False, compare=False)
    family = "ball"
    surfaces = "centres"

    @cached_property
    def state(self) -> SensorState:
        """At the start's camera, balls and planes."""
        if self._start is not None:
            return self._start.state
        evaluation = self.at_start
        nowhere = np.full((3, self.n), np.nan)
        return SensorState(
            self.camera,
            self.expected_pixels,
            evaluation.hits,
            self.planes[:, self.labels["step"]],
            self.commanded_angles,
            nowhere[:2],
            evaluation.normal,
            self._numbers[self.labels["ball"]],
            self.covariates,
            nowhere,
            self._scan_depth[self.labels["ball"]],
        )

    @property
    def _numbers(self) -> np.ndarray:
        """(B,) numbers of the balls; of those without one, the next that no ball has."""
        return np.where(self.number > 0, self.number, self.number.max(initial=0) + 1)

    @property
    def _scan_depth(self) -> np.ndarray:
        """(B,) mm, mean depth of the balls of each one's scan: the focus does not change within a scan."""
        scan = np.zeros(len(self.centres), int) if self.scan_of is None else self.scan_of
        return mean_by_label(self.centres[:, 2], scan)

    def numbers(self, place: str) -> tuple[int, ...]:
        """Numbers of the balls on their certificate."""
        return tuple(sorted({int(k) for k in self.number if k})) if place == "ball" else ()

    @property
    def evaluation(self) -> type["Evaluation"]:
        return Evaluation


class Evaluation(Sight):
    """The chain at one set of values; rows are derivatives of the residual, in px per unit."""

    def __init__(self, chain: Balls, values: np.ndarray, deltas: Mapping, gain):
        super().__init__(chain, values, deltas, gain)
        self._hit()
        ball = chain.labels["ball"]
        displacement = (
            self.hits - self._delta("point") - chain.centres[ball].T - self._delta("target")
        )
        distance = np.sqrt((displacement**2).sum(0))
        self.normal = displacement / distance
        self.residual = ((distance - chain.radii[ball]) / gain)[None]

    def _hit(self):
        """Intersect rays with light planes; two Newton steps lead from a flat plane to a curved one."""
        chain = self.chain
        change = self._delta("plane")
        plane = self._planes() + change[:4]
        depth = -plane[3] / (plane[:3] * self.ray).sum(0)
        stripe_axis = stripe_direction(chain.planes)[:, chain.labels["step"]]
        self.slope = plane[:3]
        for _ in range(2 if change[4].any() else 0):
            stripe_place = (stripe_axis * self.ray).sum(0) * depth
            miss = (plane[:3] * self.ray).sum(0) * depth + plane[3] + change[4] * stripe_place**2
            self.slope = plane[:3] + 2 * change[4] * stripe_place * stripe_axis
            depth = depth - miss / (self.slope * self.ray).sum(0)
        self.depth, self.hits = depth, self.ray * depth
        self.stripe_place = (stripe_axis * self.hits).sum(0)

    @cached_property
    def by_plane(self) -> np.ndarray:
        """(n,) mm along the normal per mm that the light plane's function rises."""
        return -(self.normal * self.ray).sum(0) / (self.slope * self.ray).sum(0)

    @cached_property
    def by_ray(self) -> np.ndarray:
        """(3, n) mm per unit of the ray (x/z, y/z, 1)."""
        return self.depth * (self.normal + self.by_plane * self.slope)

    def _by_planes(self, rows):
        """(P, n) mm from changes of planes (P, 4, n)."""
        return self.by_plane * (np.einsum("pin,in->pn", rows[:, :3], self.hits) + rows[:, 3])

    def family_rows(self, name: str) -> np.ndarray:
        """(3, 1, n) for the ball's centre, or for the step's plane."""
        return (-self.normal / self.gain)[:, None] if name == "ball" else self.step_rows()

    ports = MappingProxyType(
        {
            "pixel": lambda evaluation: -evaluation.by_pixel,
            "ray": lambda evaluation: evaluation.by_ray * evaluation.length,
            "mirror": Sight.mirror_rows,
            "plane": lambda evaluation: (
                evaluation.by_plane
                * np.stack(
                    [*evaluation.hits, np.ones(evaluation.chain.n), evaluation.stripe_place**2]
                )
            ),
            "point": lambda evaluation: -evaluation.normal,
            "target": lambda evaluation: -evaluation.normal,
        }
    )
