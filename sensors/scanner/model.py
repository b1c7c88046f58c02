"""A calibrated scanner: camera and light planes, and from stripe pixels to points."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sensors.camera import corners
from sensors.camera.model import Camera
from sensors.camera.undistort import BLOCK
from sensors.light.mirror import Mirror
from sensors.light.planes import light_origin
from sensors.scanner.errors import by_pixel, cut, frame_moves
from sensors.scanner.turntable import Turntable
from sensors.state import SensorState, stripe_direction
from sensors.stripe.surface_bias.surface_line import LineShape
from sensors.trust import Trust
from workbench.core.effect import Effect
from workbench.core.errors import InputError

_WIDEST = 1_000_000  # numbers of steps that a table may span


@dataclass(frozen=True, eq=False)
class Scanner:
    """Camera, one light plane a step, and what else was found about the instrument.

    `steps` (S,) int, the mirror steps as files number them (0 alone for a profiler); `planes`
    (4, S) unit normals and offsets in mm, n.X + b = 0 in the camera frame; `mirror` with `angles`
    (S,) rad where the planes share one; `effects` with their parameters (P,), joined, act on
    every scan; `sigma_px` of a stripe's centre where a image does not say better.
    `covariance` (3 S, 3 S): of each plane's two tilts (rad), along the stripe and across it, and
    offset (mm), in the frame that fits best, None where unknown; `frame` (6, 6): of that frame itself
    in the camera's, shift (mm) and rotation (rad) about its origin, None where unknown; `volume` (nearest,
    farthest) depth in mm that was calibrated; `scan` (2,) unit vector of the line in which centres are measured, px;
    `shared_px` 1 sigma (px) by which whole stripes on boards erred, by kind (`sensors.light.shared_errors`): it is in
    the covariance. `turntable`: that turns the object, None without one. `camera_covariance` (V, V) of the camera's
    values, None where unknown; `rays` (V + 6, V + 6 + 3 S) covariance of these values and of the frame with these and
    with the planes, None where unknown. `trust`: verdict of its calibration, and `camera_trust` of that of its camera
    alone; None where the file of an older version holds none. `line`: widths of the laser's line on the boards, None
    where they are unknown.
    """

    camera: Camera
    steps: np.ndarray
    planes: np.ndarray
    mirror: Mirror | None = None
    angles: np.ndarray | None = None
    effects: tuple[tuple[Effect, np.ndarray], ...] = ()
    sigma_px: float = 0.1
    covariance: np.ndarray | None = None
    volume: tuple[float, float] | None = None
    scan: np.ndarray = field(default_factory=lambda: np.array([1.0, 0.0]))
    provenance: Mapping = field(default_factory=dict)
    frame: np.ndarray | None = None
    shared_px: Mapping[str, float] = field(default_factory=dict)
    turntable: Turntable | None = None
    camera_covariance: np.ndarray | None = None
    rays: np.ndarray | None = None
    trust: Trust | None = None
    camera_trust: Trust | None = None
    line: LineShape | None = None

    @cached_property
    def light(self) -> np.ndarray | None:
        """(3,) mm where the light comes from: the mirror, else where the light planes meet; None where they do not."""
        return light_origin(self.planes) if self.mirror is None else self.mirror.point

    @cached_property
    def _table(self) -> tuple[int, np.ndarray | None] | None:
        """Lowest step, and the column of each step from there on, -1 for none; None where they span too much.

        No table where the steps are in order and none is missing.
        """
        low = int(self.steps.min())
        span = int(np.ptp(self.steps))
        if span >= _WIDEST:
            return None
        if np.array_equal(self.steps, np.arange(low, low + span + 1)):
            return low, None
        table = np.full(span + 1, -1)
        table[self.steps - low] = np.arange(len(self.steps))
        return low, table

    def places(self, steps: np.ndarray) -> np.ndarray:
        """(n,) column of `planes` for steps (n,), whole numbers; InputError where a step has no plane."""
        steps = _whole_numbers(steps)
        if self._table is None:
            order = np.argsort(self.steps)
            found = order[
                np.minimum(np.searchsorted(self.steps, steps, sorter=order), len(order) - 1)
            ]
            missing = self.steps[found] != steps
        else:
            low, table = self._table
            span = len(self.steps) if table is None else len(table)
            if steps.size and (steps.min() < low or steps.max() >= low + span):
                raise self._no_plane(steps[(steps < low) | (steps >= low + span)][0])
            found = steps - low if low else steps
            if table is None:
                return found
            found = table.take(found)
            missing = found < 0
        if missing.any():
            raise self._no_plane(steps[missing][0])
        return found

    def _no_plane(self, step):
        return InputError(
            f"step {step}: expected one of the {len(self.steps)} steps of "
            "the scanner, found none like it; calibrate the scanner at this step too"
        )

    def reconstruct(
        self,
        pixels: np.ndarray,
        steps: np.ndarray,
        covariates: Mapping[str, np.ndarray] | None = None,
        normals: np.ndarray | None = None,
        ball: np.ndarray | None = None,
    ) -> np.ndarray:
        """(3, n) mm, points in the camera frame of stripe pixels (2, n) at steps (n,).

        Ray through the undistorted pixel, cut with the light plane (Ye et al., Sensors 24 (2024)
        2559, eq. 5); nan where they do not meet in front of the camera. `covariates` (n,) by column
        of images.csv, `normals` (3, n) of the surface and `ball` (n,) number of the ball or 0, for the effects
        that ask for them; a normal that is not known is nan. InputError where one of them is asked for and not given.
        """
        place = self.places(steps)
        points = _blockwise(self.camera, self.planes, place, pixels)
        if not self.effects:
            return points
        self._check_surface(normals=normals, ball=ball)
        return self._corrected(
            pixels, place, self._state(pixels, place, points, covariates or {}, normals, ball)
        )

    def _check_surface(self, **given):
        for effect, _ in self.effects:
            missing = [name for name in effect.surface if given[name] is None]
            if missing:
                raise InputError(
                    f"scanner, {effect.title}: expected {' and '.join(missing)} of the surface at each "
                    "point, found none; give them to reconstruct, or take the effect out"
                )

    def _corrected(self, pixels, place, state):
        """With the effects, in the order pixel, ray, mirror, plane, point."""
        change = {
            port: sum(self._changes(port, state), np.zeros((width, 1)))
            for port, width in corners.PORTS.items()
        }
        ray = self.camera.rays(pixels - change["pixel"]) + change["ray"]
        plane = self._moved_planes(place, change["mirror"]) + change["plane"][:4]
        stripe_place = (stripe_direction(self.planes)[:, place] * ray).sum(0)
        facing = (plane[:3] * ray).sum(0)
        # root of k s^2 d^2 + n.r d + b = 0 that becomes -b / n.r for a flat light plane
        discriminant = facing**2 - 4 * change["plane"][4] * stripe_place**2 * plane[3]
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = -2 * plane[3] / (facing + np.sign(facing) * np.sqrt(discriminant))
        return ray * np.where(depth > 0, depth, np.nan) - change["point"]

    def _state(self, pixels, place, points, covariates, normals, ball=None):
        n = pixels.shape[1]
        angles = np.full(len(self.steps), np.nan) if self.angles is None else self.angles
        nowhere = np.full((3, n), np.nan)
        return SensorState(
            self.camera,
            pixels,
            points,
            self.planes[:, place],
            angles[place],
            nowhere[:2],
            nowhere if normals is None else normals,
            np.zeros(n, int) if ball is None else ball,
            covariates,
            nowhere,
        )

    def _changes(self, port, state):
        for effect, values in self.effects:
            if effect.port == port:
                full = np.zeros((corners.PORTS[port], state.n))
                full[list(effect.port_indices(self))] = effect.delta(values, state)
                yield full

    def _moved_planes(self, place, extra):
        if not extra.any():
            return self.planes[:, place]
        if self.mirror is None:
            raise InputError(
                "scanner: expected a mirror for the effects on its angle, found none; calibrate it again"
            )
        return self.mirror.planes(self.angles[place] + extra[0])

    @cached_property
    def state(self) -> SensorState:
        """Of no observation at all: what an effect's table may ask."""
        return self._state(np.empty((2, 0)), np.empty(0, int), np.empty((3, 0)), {}, None)

    def numbers(self, place: str) -> tuple[int, ...]:
        """K of `ball-K`: a scanner knows no balls."""
        return ()

    def slides(self, joint: int) -> bool:
        """Whether joint K is prismatic: a scanner has none."""
        return False

    def port_indices(self, port: str, where: str, components: tuple[int, ...]) -> tuple[int, ...]:
        """Rows of a port, as the scanner's chains number them."""
        return corners.port_indices(port, where, components)

    @property
    def plane_covariance(self) -> np.ndarray:
        """(S, 3, 3) of each plane's tilts and offset; zero where unknown."""
        count = len(self.steps)
        if self.covariance is None:
            return np.zeros((count, 3, 3))
        return self.covariance.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]

    @property
    def stripe_variance(self) -> np.ndarray:
        """(2,) px^2 of shift and tilt of a whole stripe, as the calibration found them beyond noise and planes."""
        return np.zeros(2) if self.trust is None else np.square(self.trust.stripe_px)

    def frame_covariance(self, points: np.ndarray) -> np.ndarray:
        """(3, 3, n) mm^2 that places (3, n) in the camera frame have from the frame alone: all points of a scan move
        together by it, so that no distance and no hand-eye calibration notices. Zero where it is unknown."""
        moves = frame_moves(np.asarray(points, float))
        return np.einsum(
            "pin,pq,qjn->ijn", moves, np.zeros((6, 6)) if self.frame is None else self.frame, moves
        )

    def by_stripe(self, points: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(3, n) mm that points (3, n) move by when the centre of their stripe errs by one px."""
        rows = by_pixel(self.camera, points, self.planes[:, self.places(steps)])
        return np.einsum("c,cin->in", self.scan, rows)


def _whole_numbers(steps) -> np.ndarray:
    """The same as integers; InputError where one is no whole number."""
    steps = np.asarray(steps)
    if steps.dtype.kind in "iu":
        return steps
    odd = (
        steps[~(np.isfinite(steps) & (steps == np.round(steps)))]
        if steps.dtype.kind == "f"
        else steps.ravel()
    )
    if odd.size:
        raise InputError(
            f"steps: expected whole numbers, found {odd[0]}; number the steps as in the scanner's file"
        )
    return steps.astype(int)


def _blockwise(
    camera: Camera, planes: np.ndarray, place: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """(3, n) mm; blocks of points stay in the cache from pixel to point."""
    n = pixels.shape[1]
    if n < 2 * BLOCK or not (planes[3] != 0).all():
        return cut(camera.normalised(pixels), planes[:, place])
    points = np.empty((3, n))
    workspace = camera.workspace()
    plane = np.empty((3, BLOCK))
    part = np.empty(BLOCK)
    inverse = -planes[:3] / planes[3]  # depth = 1 / (inverse . ray)
    for first in range(0, n, BLOCK):
        block = points[:, first : first + BLOCK]
        block_plane = plane[:, : block.shape[1]]
        scratch = part[: block.shape[1]]
        workspace.normalised(pixels[:, first : first + BLOCK], block[:2])
        if inverse.shape[1] == 1:
            np.multiply(block[:2], inverse[:2], out=block_plane[:2])
            block_plane[2] = inverse[2]
        else:
            np.take(inverse, place[first : first + BLOCK], axis=1, out=block_plane, mode="clip")
            block_plane[:2] *= block[:2]
        np.add(block_plane[0], block_plane[1], out=scratch)
        scratch += block_plane[2]
        if not scratch.min() > 0:
            scratch[~(scratch > 0)] = np.nan
        np.reciprocal(scratch, out=block[2])
        block[:2] *= block[2]
    return points
