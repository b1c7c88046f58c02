"""The laser's stripe on whatever stands there: geometry once, then the light of every mirror step."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.rendering import sight
from sensors.rendering.instrument import Instrument
from sensors.rendering.ports import Moment
from sensors.rendering.surfaces import Surface
from sensors.state import SensorState, stripe_direction

_REACH = 4.5  # sigmas of the light plane beyond which there is no light
_NARROW = 0.7  # px: pixels gather a Gaussian of this sigma to within 2e-5 px of where it is
_PROBES = 400  # places at which is seen how far effects move the stripe


@dataclass(frozen=True)
class Canvas:
    """The image with a margin around it: pixel (0, 0) of the image is (margin, margin) here."""

    width: int
    height: int
    margin: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.height + 2 * self.margin, self.width + 2 * self.margin

    def pixels(self, flat: np.ndarray, oversampling: int = 1) -> np.ndarray:
        """(2, n oversampling^2) places in the image of the canvas's pixels `flat` (n,), or of their subpixels."""
        return sight.parts_of_pixels(flat, self.shape[1], oversampling) - self.margin

    def crop(self, light):
        """The image itself."""
        return light[
            self.margin : self.margin + self.height, self.margin : self.margin + self.width
        ]


@dataclass(frozen=True)
class Stage:
    """Surface points seen by N pixels in k parts each, for one static pose of everything but the mirror.

    `flat` (N,) their numbers on the canvas; `points` (3, N, k) mm; `normals` (3, N, k); `albedo`
    (N, k); `ball` (N, k); `chosen` one (M,) a step, the rows of these arrays that its stripe may reach.
    """

    canvas: Canvas
    flat: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    ball: np.ndarray
    chosen: tuple[np.ndarray, ...]
    oversampling: int


def set_stage(
    instrument: Instrument,
    surfaces: Sequence[Surface],
    moments: Sequence[Moment],
    canvas: Canvas,
    oversampling: int = 2,
) -> Stage:
    """Look through every pixel that a stripe may reach; `moments` one a step."""
    middle = _middles(instrument, surfaces, moments[0], canvas)
    rough = middle.astype(np.float32)
    probes = middle[:, :: max(1, middle.shape[1] // _PROBES)]
    probes = probes[:, ~np.isnan(probes[0])]
    reached = [_reached(instrument, rough, probes, k, moments[k]) for k in range(len(moments))]
    used = np.zeros(middle.shape[1], bool)
    for rows in reached:
        used[rows] = True
    flat = np.flatnonzero(used)
    order = np.cumsum(used) - 1
    seen = sight.look(instrument, surfaces, canvas.pixels(flat, oversampling), moments[0])
    shape = (len(flat), oversampling**2)
    return Stage(
        canvas,
        flat,
        seen.points.reshape(3, *shape),
        sight.normals(surfaces, seen).reshape(3, *shape),
        sight.albedo(surfaces, seen, 1 / (instrument.camera.fx * oversampling)).reshape(shape),
        sight.ball(surfaces, seen).reshape(shape),
        tuple(order[rows] for rows in reached),
        oversampling,
    )


def _middles(instrument, surfaces, moment, canvas) -> np.ndarray:
    """(3, H W) what the middle of every pixel sees; of a pixel that just misses, what its neighbour sees."""
    pixels = canvas.pixels(np.arange(np.prod(canvas.shape)))
    points = sight.look(instrument, surfaces, pixels, moment).points
    filled = _filled_from_neighbours(points.reshape(3, *canvas.shape))
    return filled.reshape(3, -1)


def _filled_from_neighbours(points: np.ndarray) -> np.ndarray:
    """(3, H, W) points in which a nan holds the point of its pixel's neighbour."""
    filled = points.copy()
    for axis, shift in ((1, 1), (1, -1), (2, 1), (2, -1)):
        neighbour = np.roll(points, shift, axis)
        filled = np.where(np.isnan(filled), neighbour, filled)
    return filled


def _reached(instrument, rough, probes, index, moment) -> np.ndarray:
    """Pixels of the canvas within reach of one step's light plane, wherever the effects move it.

    Single precision is enough to choose, not to render.
    """
    nominal = instrument.nominal_planes()[:, index]
    if not probes.size:
        return np.empty(0, int)
    moved = _plane_distance(instrument, index, probes, moment, {}) - (
        nominal[:3] @ probes + nominal[3]
    )
    stripe_place = _along_stripe(instrument, index, probes)
    copies = [moved - ghost.distance(stripe_place) for ghost, _ in moment.causes.ghost_lines]
    moved = np.concatenate([moved, *copies])
    pixel = np.nanmax(probes[2]) / instrument.camera.fx
    low = min(moved.min(), 0)
    high = max(moved.max(), 0)
    limit = _REACH * _widest(instrument, index, probes) + pixel + 0.2 * (high - low)
    distance = nominal[:3].astype(np.float32) @ rough + np.float32(nominal[3])
    with np.errstate(invalid="ignore"):
        return np.flatnonzero((distance > -limit - high) & (distance < limit - low))


def _plane_distance(instrument, index, points, moment, known) -> np.ndarray:
    """(n,) mm from the light plane of a step, with everything that acts, of surface points (3, n)."""
    n = points.shape[1]
    causes = moment.causes
    nominal = instrument.nominal_planes()[:, index]
    if not any(causes.acts_on(port) for port in ("mirror", "plane", "point")):
        return nominal[:3] @ points + nominal[3]
    state = _state(instrument, index, points, moment, np.tile(nominal[:, None], n), known)
    light_plane = instrument.light_planes(state, moment)
    if causes.acts_on("point"):
        points = points + causes.delta("point", state)
    stripe_place = (stripe_direction(light_plane[:4]) * points).sum(0)
    return (light_plane[:3] * points).sum(0) + light_plane[3] + light_plane[4] * stripe_place**2


def _state(instrument, index, points, moment, planes, known) -> SensorState:
    mirror = np.full(points.shape[1], instrument.commanded[index])
    return moment.state(
        instrument.camera, points.shape[1], points=points, planes=planes, mirror=mirror, **known
    )


@dataclass(frozen=True)
class Stripe:
    """Light of one step on M pixels: `flat` (M,) on the canvas, `light` (M, k) in each pixel's parts, share of
    what a white surface square to the light gives, `depth` (M,) mm, `spread` (M,) factor on the noise or None;
    `thin` where it is so narrow that the lens must spread it before pixels gather it."""

    flat: np.ndarray
    light: np.ndarray
    depth: np.ndarray
    spread: np.ndarray | None
    thin: bool


def stripe(
    instrument: Instrument, surfaces: Sequence[Surface], stage: Stage, index: int, moment: Moment
) -> Stripe:
    """The stripe of step `index` in the parts of each pixel that it reaches.

    Gaussian across the light plane; Lambert's cosine of the light's incidence; falls with the distance
    from where the light plane fans out; dark where the light is on the other side or something is before it.
    """
    rows = stage.chosen[index]
    points = stage.points[:, rows].reshape(3, -1)
    normals = stage.normals[:, rows].reshape(3, -1)
    known = {
        "pixels": stage.canvas.pixels(stage.flat[rows], stage.oversampling)
        if moment.causes.pairs
        else None,
        "normals": normals,
        "ball": stage.ball[rows].ravel(),
    }
    if known["pixels"] is None:
        del known["pixels"]
    distance = _plane_distance(instrument, index, points, moment, known)
    bright = _light_across(instrument, index, distance, points)
    for ghost, share in moment.causes.ghost_lines:
        ghost_offset = ghost.distance(_along_stripe(instrument, index, points))
        bright = bright + share * _light_across(instrument, index, distance - ghost_offset, points)
    bright = bright * _fan_factor(instrument, index, points)
    lit_places = np.flatnonzero(bright > 1e-6)
    lit_points = points[:, lit_places], normals[:, lit_places]
    diffuse = stage.albedo[rows].ravel()[lit_places] * _arriving(
        instrument, surfaces, index, *lit_points
    )
    bright[lit_places] *= diffuse + _specular(
        instrument, surfaces, index, known["ball"][lit_places], *lit_points
    )
    light = np.zeros(len(rows) * stage.oversampling**2)
    light[lit_places] = bright[lit_places]
    depth = np.nan_to_num(stage.points[2, rows, 0], nan=instrument.optics.focus_mm)
    shape = (len(rows), stage.oversampling**2)
    thin = _thin(
        distance.reshape(shape), light.reshape(shape), stage.oversampling, instrument.laser.width_mm
    )
    spread = _noise(instrument, stage, index, rows, moment)
    return Stripe(stage.flat[rows], light.reshape(shape), depth, spread, thin)


def _thin(distance, light, oversampling, width) -> bool:
    """Whether the light plane's 1 sigma is under `_NARROW` px somewhere where it is bright."""
    if oversampling == 1 or not light.any():
        return False
    bright = distance[light.max(1) > 0.1 * light.max()]
    column_step = oversampling * np.abs(bright[:, 1] - bright[:, 0])
    row_step = oversampling * np.abs(bright[:, oversampling] - bright[:, 0])
    mm_a_pixel = np.hypot(column_step, row_step)
    return bool(np.nanmax(mm_a_pixel, initial=0) * _NARROW > width)


def _profile(distance, width):
    """(n,) of Gaussian light across the light plane; 0 where nothing is seen."""
    return np.nan_to_num(np.exp(-0.5 * (distance / width) ** 2))


def _widest(instrument, index, points):
    """mm, the largest 1 sigma of the line at points (3, n)."""
    source = instrument.light(index)
    laser = instrument.laser
    if source is None or not np.isfinite(laser.rayleigh_mm):
        return laser.width_mm
    return float(np.max(laser.width(np.linalg.norm(points - source[:, None], axis=0))))


def _light_across(instrument, index, distance, points):
    """(n,) light across the light plane: its width grows away from the waist, and its peak falls with it."""
    source = instrument.light(index)
    laser = instrument.laser
    if source is None or not np.isfinite(laser.rayleigh_mm):
        return _profile(distance, laser.width_mm)
    width = laser.width(np.linalg.norm(points - source[:, None], axis=0))
    return _profile(distance, width) * np.nan_to_num(laser.width_mm / width)


def _along_stripe(instrument, index, points):
    """(n,) mm, place of points (3, n) along the stripe."""
    plane = instrument.nominal_planes()[:, index, None]
    return (stripe_direction(plane) * points).sum(0)


def _fan_factor(instrument, index, points):
    """(n,) factor of brightness along the fan, of its angle about the source."""
    source = instrument.light(index)
    laser = instrument.laser
    if source is None or not laser.uneven:
        return np.ones(points.shape[1])
    plane = instrument.nominal_planes()[:, index, None]
    displacement = points - source[:, None]
    axial = (stripe_direction(plane) * displacement).sum(0)
    angle = np.arcsin(np.clip(axial / np.linalg.norm(displacement, axis=0), -1, 1))
    wave = np.cos(2 * np.pi * angle / np.deg2rad(laser.uneven_deg))
    return np.nan_to_num(1 + laser.uneven * wave)


def _specular(instrument, surfaces, index, balls, points, normals):
    """(n,) light of the highlights on balls, of the same unit as the diffuse light."""
    source = instrument.light(index)
    glossy = {s.number: s.gloss for s in surfaces if getattr(s, "gloss", None) and s.gloss.share}
    highlight = np.zeros(points.shape[1])
    if source is None or not glossy:
        return highlight
    to_source = source[:, None] - points
    length = np.linalg.norm(to_source, axis=0)
    to_source = to_source / length
    to_camera = -points / np.linalg.norm(points, axis=0)
    is_lit = (to_source * normals).sum(0) > 0
    for number, gloss in glossy.items():
        is_of_ball = is_lit & (balls == number)
        light = gloss.reflected(
            to_source[:, is_of_ball], to_camera[:, is_of_ball], normals[:, is_of_ball]
        )
        highlight[is_of_ball] = light * instrument.laser.reach_mm / length[is_of_ball]
    return highlight


def _arriving(instrument, surfaces, index, points, normals):
    """(n,) what of the light arrives at points (3, n): incidence, distance and shadow."""
    source = instrument.light(index)
    if source is None:
        return np.ones(points.shape[1])
    to_source = source[:, None] - points
    length = np.sqrt((to_source**2).sum(0))
    to_source /= length
    cosine = np.maximum((to_source * normals).sum(0), 0)
    arriving = cosine * instrument.laser.reach_mm / length
    arriving[_is_shadowed(surfaces, points, to_source)] = 0
    return arriving


def _is_shadowed(surfaces, points, to_source) -> np.ndarray:
    """(n,) whether some surface lies between points (3, n) and the source of the light."""
    is_shadowed = np.zeros(points.shape[1], bool)
    for surface in surfaces:
        is_shadowed |= surface.blocks(points, to_source)
    return is_shadowed


def _noise(instrument, stage, index, rows, moment):
    if not moment.causes.acts_on("noise"):
        return None
    points = stage.points[:, rows, 0]
    known = _first_parts(stage, rows)
    planes = np.broadcast_to(instrument.nominal_planes()[:, index, None], (4, len(rows)))
    state = _state(instrument, index, points, moment, planes, known)
    return np.exp(moment.causes.delta("noise", state)[0])


def _first_parts(stage, rows) -> dict[str, np.ndarray]:
    """Fields of SensorState that the first part of each of these pixels determines."""
    return {
        "pixels": stage.canvas.pixels(stage.flat[rows]),
        "normals": stage.normals[:, rows, 0],
        "ball": stage.ball[rows, 0],
    }
