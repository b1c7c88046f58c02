"""Rays of each part of each pixel: through the true lens, to the nearest surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.rendering.instrument import Instrument
from sensors.rendering.ports import Moment
from sensors.rendering.surfaces import Surface

_GRID = 32  # rays along each side of the image, on which the lens is focused
_BLOCK = 1 << 18  # samples at a time: what stays in the processor's cache


@dataclass(frozen=True)
class Seen:
    """Points that n places of the image see: `points` (3, n) mm, `surface` (n,) its number in the list, -1 nothing."""

    points: np.ndarray
    surface: np.ndarray


def look(
    instrument: Instrument, surfaces: Sequence[Surface], pixels: np.ndarray, moment: Moment
) -> Seen:
    """Find the points that pixels (2, n), as observed, see at this moment.

    Observed pixel -> ideal pixel (port `pixel`) -> ray (port `ray`) -> nearest surface. What bends the ray
    may ask how far away the surface is, which the unbent ray says first.
    """
    if moment.causes.acts_on("pixel"):
        moment = replace(moment, focus=_focus_depth(instrument.camera, surfaces))
    starts = range(0, max(pixels.shape[1], 1), _BLOCK)
    blocks = [_look(instrument, surfaces, pixels[:, k : k + _BLOCK], moment) for k in starts]
    points = np.concatenate([block.points for block in blocks], 1)
    surface = np.concatenate([block.surface for block in blocks])
    return Seen(points, surface)


def _focus_depth(camera, surfaces: Sequence[Surface]) -> float:
    """mm, mean depth of what a grid over the whole image sees, nan where nothing is."""
    width, height = camera.size
    pixels = grid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    depth = _nearest(surfaces, camera.rays(pixels)).points[2]
    depth = depth[np.isfinite(depth)]
    return float(depth.mean()) if depth.size else np.nan


def grid(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(2, n) px, column and row of the points of a grid, row after row."""
    return np.stack(np.meshgrid(columns, rows)).reshape(2, -1)


def _look(instrument, surfaces, pixels, moment):
    camera = instrument.camera
    rays = camera.rays(_ideal_pixels(camera, pixels, moment))
    seen = _nearest(surfaces, rays)
    if not moment.causes.acts_on("ray"):
        return seen
    state = moment.state(camera, pixels.shape[1], pixels=pixels, points=seen.points)
    bent = rays + moment.causes.delta("ray", state)
    return _nearest(surfaces, bent / np.sqrt((bent**2).sum(0)))


def _ideal_pixels(camera, pixels, moment):
    """(2, n) observed pixels without the effects on the port `pixel`."""
    if not moment.causes.acts_on("pixel"):
        return pixels
    state = moment.state(camera, pixels.shape[1], pixels=pixels)
    return pixels - moment.causes.delta("pixel", state)


def _nearest(surfaces, rays):
    best = np.full(rays.shape[1], np.inf)
    nearest_surface = np.full(rays.shape[1], -1, np.int16)
    for number, surface in enumerate(surfaces):
        distance = surface.meet(rays)
        nearer = distance < best  # nan, where there is nothing, is not
        best = np.where(nearer, distance, best)
        nearest_surface = np.where(nearer, number, nearest_surface)
    return Seen(rays * np.where(nearest_surface >= 0, best, np.nan), nearest_surface)


def parts_of_pixels(flat: np.ndarray, width: int, oversampling: int) -> np.ndarray:
    """(2, n oversampling^2) places of the middles of oversampling x oversampling squares in pixels `flat` (n,), pixel
    by pixel.
    """
    row, column = np.divmod(flat, width)
    middle = (np.arange(oversampling) + 0.5) / oversampling - 0.5
    column_offset, row_offset = grid(middle, middle)
    places = np.stack([column[:, None] + column_offset, row[:, None] + row_offset])
    return places.reshape(2, -1)


def normals(surfaces: Sequence[Surface], seen: Seen) -> np.ndarray:
    """(3, n) unit normals of what is seen, nan where nothing is."""
    return _ask_surfaces(
        surfaces, seen, np.full(seen.points.shape, np.nan), lambda s, points: s.normals(points)
    )


def albedo(surfaces: Sequence[Surface], seen: Seen, spread: float) -> np.ndarray:
    """(n,) reflectance of what is seen, 0 where nothing is; `spread` rad, the angle between samples."""
    return _ask_surfaces(
        surfaces,
        seen,
        np.zeros(len(seen.surface)),
        lambda s, points: s.albedo(points, spread * points[2]),
    )


def ball(surfaces: Sequence[Surface], seen: Seen) -> np.ndarray:
    """(n,) number of the ball that is seen, 0 for none."""
    return np.array([surface.number for surface in surfaces] + [0])[seen.surface]


def _ask_surfaces(surfaces, seen, out, ask):
    for number, surface in enumerate(surfaces):
        points_of_surface = np.flatnonzero(seen.surface == number)
        if points_of_surface.size:
            out[..., points_of_surface] = ask(surface, seen.points[:, points_of_surface])
    return out
