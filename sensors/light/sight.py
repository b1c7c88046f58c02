"""Base of the chains of stripes on boards and on balls: rays through the lens, and the light planes of their steps.

`StripeChain` is the common base of the chains, `Sight` that of their evaluations. An evaluation of a chain intersects
the rays with its surface and states the derivatives of its residual by a ray and by a light plane.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from sensors.camera import corners
from sensors.camera.corners import camera_parameters
from sensors.camera.model import Camera
from sensors.light.mirror import MovedMirror, mirror_parameters
from sensors.light.planes import moved, moved_rows
from workbench.core.errors import InputError
from workbench.core.parameters import Parameters

_FARTHEST = (
    20.0  # px by which a point may be away from its surface; beyond that a slope says nothing
)


class StripeChain:
    """Base of `BoardStripeChain` and `Balls`, which are frozen dataclasses of n points of stripes.

    A chain has the fields `camera`, `pixels` (2, n), `labels`, `planes` (4, S), `scan`, `mirror` and `angles`, and
    `_start`: the chain at its first linearisation, None where it is that itself. Everything that belongs to the start
    (`at_start`, `gain`) is taken from there, so that a solve cannot change it. `evaluation` is its
    subclass of `Sight`. `surfaces` names the field with the poses or centres of the bodies that the light falls on,
    `family` their family in a bundle.
    """

    family: ClassVar[str]
    surfaces: ClassVar[str]

    @cached_property
    def parameters(self) -> Parameters:
        """Parameters of the camera and, where there is a mirror, of the mirror."""
        camera_table = camera_parameters(self.camera)
        if self.mirror is None:
            return camera_table
        return Parameters.of([*camera_table.table, *mirror_parameters().table]).take_over(
            camera_table
        )

    @property
    def n(self) -> int:
        """Number of points."""
        return self.pixels.shape[1]

    @cached_property
    def at_start(self) -> "Sight":
        """Evaluation at the start, with one mm as the unit of the residual."""
        if self._start is not None:
            return self._start.at_start
        return self.in_millimetres()

    @cached_property
    def gain(self) -> np.ndarray:
        """(n,) mm that one pixel along the scan line moves a point away from its surface, at the start.

        It belongs to the measurement, like a sigma: a solve must not lower its cost by raising it.
        """
        if self._start is not None:
            return self._start.gain
        return np.abs((self.at_start.by_pixel * self.scan).sum(0))

    @property
    def expected_pixels(self) -> np.ndarray:
        """(2, n) px along the scan line from each point to where the surface must be seen at the start."""
        slope = (self.at_start.by_pixel * self.scan).sum(0)
        residual_px = np.divide(
            self.at_start.residual[0], slope, out=np.zeros(self.n), where=slope != 0
        )
        return self.pixels - self.scan * np.clip(residual_px, -_FARTHEST, _FARTHEST)

    @property
    def commanded_angles(self) -> np.ndarray:
        """(n,) rad, angle of the mirror as commanded at each point; nan where it is unknown."""
        angles = np.full(self.planes.shape[1], np.nan) if self.angles is None else self.angles
        return angles[self.labels["step"]]

    def at(self, samples: np.ndarray) -> Self:
        """The same on some of the samples (indices or mask); surfaces and planes stay."""
        return replace(
            self,
            pixels=self.pixels[:, samples],
            labels=_some_columns(self.labels, samples),
            scan=_some_or_common(self.scan, samples),
            sigma=_some_or_common(self.sigma, samples),
            covariates=_some_columns(self.covariates, samples),
            _start=None if self._start is None else self._start.at(samples),
        )

    def with_families(self, values: Mapping[str, np.ndarray]) -> Self:
        """The chain with other surfaces and changes of planes; the state stays that of the start."""
        return replace(
            self,
            **{self.surfaces: values.get(self.family, getattr(self, self.surfaces))},
            change=values.get("step", self.change),
            _start=self if self._start is None else self._start,
        )

    def moved(self, camera: Camera, surfaces: np.ndarray, planes: np.ndarray, mirror=None) -> Self:
        """The same measurements with another start: camera, poses or centres, planes (4, S) and mirror."""
        return replace(
            self,
            **{self.surfaces: surfaces},
            camera=camera,
            planes=planes,
            mirror=mirror,
            change=None,
            _start=None,
        )

    def port_indices(self, port: str, where: str, components: tuple[int, ...]) -> tuple[int, ...]:
        """Rows of a port that `components` name, all for (); InputError where there is no such port."""
        return corners.port_indices(port, where, components)

    def numbers(self, place: str) -> tuple[int, ...]:
        """Numbers of the bodies of a kind that an effect may name; none but on balls."""
        return ()

    def slides(self, joint: int) -> bool:
        """Whether a joint is prismatic: a scanner has no joints."""
        return False

    def in_millimetres(self) -> "Sight":
        """Evaluation at the values of the chain, with distances in mm as residual."""
        return self.evaluation(self, self.parameters.values, {}, 1.0)

    def evaluate(self, values: np.ndarray, deltas: Mapping) -> "Sight":
        """Evaluation with residual (1, n) px at values of the camera and the mirror, and changes of the ports."""
        return self.evaluation(self, values, deltas, self.gain)


class Sight:
    """A chain of n pixels at one set of values; rows are derivatives of the residual, in px per unit.

    The chain has `camera`, `pixels` (2, n), `labels["step"]` (n,), `planes` (4, S) with `change` (S, 3) or None,
    `mirror` with `angles` (S,) or None. `gain` (n,) or 1: mm that one pixel of the residual stands for. What an
    evaluation adds: `by_ray` (3, n) mm per unit of the ray (x/z, y/z, 1), `_by_planes` and `ports`.
    """

    def __init__(self, chain, values: np.ndarray, deltas: Mapping, gain):
        self.chain, self.gain = chain, gain
        self.camera = Camera.of(values[: len(chain.camera.values)], chain.camera.size)
        self.changes = values[len(chain.camera.values) :]
        self.deltas = {
            port: _full_change(port, *delta, chain.n)
            for port, delta in deltas.items()
            if port != "noise"
        }
        self.flat = self.camera.normalised(chain.pixels - self._delta("pixel"))
        self.ray = np.stack([*self.flat, np.ones(chain.n)])
        self.length = np.sqrt((self.ray**2).sum(0))
        if "ray" in self.deltas:
            self.ray = self.ray + self.length * self.deltas["ray"]

    def _delta(self, port):
        return self.deltas.get(port, np.zeros((corners.PORTS[port], 1)))

    @cached_property
    def mirror(self) -> MovedMirror:
        return MovedMirror(self.chain.mirror, self.changes)

    def _angles(self):
        """Commanded angles and what the effects add: (n,) where there are any, else (S,) and 0."""
        angles = self.chain.angles
        if "mirror" not in self.deltas:
            return angles, 0.0
        return angles[self.chain.labels["step"]], self.deltas["mirror"][0]

    def _planes(self):
        """(4, n) of each point."""
        chain = self.chain
        step = self.chain.labels["step"]
        if chain.mirror is not None:
            planes = self.mirror.planes(*self._angles())
            return planes if "mirror" in self.deltas else planes[:, step]
        if "mirror" in self.deltas:
            raise InputError(
                "an effect of the mirror: expected the mirror's angles and its model, found free light "
                "planes, which already hold it; give mirror_deg or take the effect out"
            )
        return (chain.planes if chain.change is None else moved(chain.planes, chain.change))[
            :, step
        ]

    @cached_property
    def by_bent(self) -> np.ndarray:
        """(2, n) mm per unit of the distorted normalised point: implicit, M' h = w for the lens' slope M."""
        by_flat = self.by_ray[:2]
        if "ray" in self.deltas:
            by_flat = by_flat + (self.by_ray * self.deltas["ray"]).sum(0) / self.length * self.flat
        slope = self.lens[1]
        determinant = slope[0, 0] * slope[1, 1] - slope[1, 0] * slope[0, 1]
        return (
            np.stack(
                [
                    slope[1, 1] * by_flat[0] - slope[0, 1] * by_flat[1],
                    slope[0, 0] * by_flat[1] - slope[1, 0] * by_flat[0],
                ]
            )
            / determinant
        )

    @cached_property
    def lens(self):
        """Distorted points, their slope and what each coefficient does to them."""
        return self.camera.distort_rows(self.flat)

    @cached_property
    def by_pixel(self) -> np.ndarray:
        """(2, n) mm per pixel."""
        return self.by_bent / np.array([[self.camera.fx], [self.camera.fy]])

    def own_rows(self, indices: np.ndarray) -> np.ndarray:
        """(k, 1, n) for parameters of the camera and the mirror."""
        seen, _, by_coefficient = self.lens
        rows = np.concatenate(
            [-self.by_pixel * seen, -self.by_pixel, -(self.by_bent * by_coefficient).sum(1)]
        )
        if len(indices) and indices.max() >= len(self.camera.values):
            rows = np.concatenate(
                [rows, self._by_planes(self._of_points(self.mirror.rows(*self._angles())))]
            )
        return (rows[indices] / self.gain)[:, None]

    def step_rows(self) -> np.ndarray:
        """(3, 1, n) for the tilts and the offset of the step's plane."""
        change = (
            np.zeros((self.chain.planes.shape[1], 3))
            if self.chain.change is None
            else self.chain.change
        )
        rows = self._by_planes(
            moved_rows(self.chain.planes, change)[..., self.chain.labels["step"]]
        )
        return (rows / self.gain)[:, None]

    def mirror_rows(self) -> np.ndarray:
        """(1, n) mm per rad of the mirror."""
        planes_by_angle = self.mirror.mirror.by_angle(self.mirror.angles(*self._angles()))
        return self._by_planes(self._of_points(planes_by_angle)[None])

    def _of_points(self, rows):
        """(..., n) of each point, of rows by its step (..., S) or by itself where effects turn the mirror."""
        return rows if "mirror" in self.deltas else rows[..., self.chain.labels["step"]]

    def rows(self, port: str, port_indices: np.ndarray) -> np.ndarray:
        """(k, 1, n) for components of a port."""
        return (self.ports[port](self)[port_indices] / self.gain)[:, None]


def _some_columns(columns: Mapping[str, np.ndarray], samples: np.ndarray) -> dict[str, np.ndarray]:
    """Columns (n,) at some of the samples."""
    return {name: column[samples] for name, column in columns.items()}


def _some_or_common(values: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Values (k, n) at some of the samples; (k, 1), common to all, as they are."""
    return values if values.shape[1] == 1 else values[:, samples]


def _full_change(port, port_indices, change, n):
    """(width, n) change of all components of a port."""
    full = np.zeros((corners.PORTS[port], n))
    full[np.asarray(port_indices)] = change
    return full
