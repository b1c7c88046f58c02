"""Images of boards under the lamp, and of stripes on boards, balls and meshes."""

from collections.abc import Iterator, Sequence

import numpy as np

from sensors.rendering import formation, sight
from sensors.rendering.indirect import indirect_light
from sensors.rendering.instrument import Instrument
from sensors.rendering.ports import Moment
from sensors.rendering.stripes import Canvas, Stripe, set_stage, stripe
from sensors.rendering.surfaces import Surface

NO_MOTION = Moment()


def render_board(
    instrument: Instrument,
    surfaces: Sequence[Surface],
    moment: Moment = NO_MOTION,
    seed: int = 0,
    oversampling: int = 4,
) -> np.ndarray:
    """(H, W) image, uint8 or uint16, of surfaces under the lamp, laser off."""
    light = lamp_light(instrument, surfaces, instrument.lamp.board, moment, oversampling)
    return _developed(instrument, light, formation.generator(seed))


def _developed(instrument, light, random, spread=None) -> np.ndarray:
    """The image of light (H, W) that the lens and the chip make."""
    light = formation.vignetted(light, instrument.camera, instrument.optics.vignetting)
    return formation.develop(light, instrument.chip, random, spread)


def render_scan(
    instrument: Instrument,
    surfaces: Sequence[Surface],
    moments: Sequence[Moment] | None = None,
    seed: int = 0,
    oversampling: int = 2,
) -> Iterator[np.ndarray]:
    """Images (H, W), uint8 or uint16, one a step of the instrument, of the stripe on the surfaces.

    `moments` one a step; what acts on the lens, and the surfaces, are those of the first: during
    one scan nothing but the mirror moves.
    """
    moments = [NO_MOTION] * len(instrument.steps) if moments is None else moments
    lamp = lamp_light(instrument, surfaces, instrument.lamp.laser, moments[0], oversampling)
    canvas = _canvas(instrument, surfaces, moments[0])
    stage = set_stage(instrument, surfaces, moments, canvas, oversampling)
    for index, moment in enumerate(moments):
        random = formation.generator(seed, index)
        found = stripe(instrument, surfaces, stage, index, moment)
        light, spread = _with_stripe(instrument, lamp, found, canvas, random)
        indirect = indirect_light(instrument, stage, found)
        light = light if indirect is None else light + indirect
        yield _developed(instrument, light, random, spread)


def laser_light(
    instrument: Instrument,
    surfaces: Sequence[Surface],
    moments: Sequence[Moment] | None = None,
    oversampling: int = 2,
) -> Iterator[np.ndarray]:
    """(H, W) float32 electrons of the stripe of each step alone: blurred, without speckle, lamp or noise."""
    moments = [NO_MOTION] * len(instrument.steps) if moments is None else moments
    canvas = _canvas(instrument, surfaces, moments[0])
    stage = set_stage(instrument, surfaces, moments, canvas, oversampling)
    for index, moment in enumerate(moments):
        found = stripe(instrument, surfaces, stage, index, moment)
        yield _full(_spread_stripe(instrument, found, canvas), canvas).cpu().numpy()


def lamp_light(
    instrument: Instrument,
    surfaces: Sequence[Surface],
    level: float,
    moment: Moment = NO_MOTION,
    oversampling: int = 4,
):
    """(H, W) tensor, electrons that the lamp's light gives, blurred; `level` the share of the full well from white.

    Lambert's cosine of the incidence; of a lamp at the camera that is the angle of view. Pixels whose four corners
    agree are even; the others are averaged over oversampling x oversampling rays of their own.
    """
    import torch

    canvas = _canvas(instrument, surfaces, moment)
    corners, seen = _corners(instrument, surfaces, canvas, moment)
    even, value = _even(
        corners, seen.surface.reshape(corners.shape), np.max(np.nan_to_num(corners), initial=0)
    )
    flat = np.flatnonzero(~even)
    inner = sight.look(instrument, surfaces, canvas.pixels(flat, oversampling), moment)
    value.ravel()[flat] = (
        _lamp(instrument, surfaces, inner, oversampling).reshape(len(flat), oversampling**2).mean(1)
    )
    depth = _nearest_depth(seen.points[2].reshape(corners.shape))
    known = np.nan_to_num(depth, nan=instrument.optics.focus_mm)
    sigma = torch.as_tensor(
        instrument.optics.sigma(known), dtype=torch.float32, device=formation.device()
    )
    light = torch.as_tensor(value, dtype=torch.float32, device=formation.device())
    light = light * (level * instrument.chip.full_well_e)
    return canvas.crop(formation.defocus(light, sigma)).contiguous()


def _nearest_depth(depth):
    """(H, W) mm of pixels from those at their corners (H + 1, W + 1): the nearest of four; nan where none sees any.

    A pixel at the edge of a surface has its light, and so its blur; without it, an edge is a sharp line.
    """
    rows = np.fmin(depth[:-1], depth[1:])
    return np.fmin(rows[:, :-1], rows[:, 1:])


def _corners(instrument, surfaces, canvas, moment):
    """Lamp light (H + 1, W + 1) at the corners of the canvas's pixels, and what is seen there."""
    height, width = canvas.shape
    corners = sight.grid(np.arange(width + 1.0), np.arange(height + 1.0))
    seen = sight.look(instrument, surfaces, corners - 0.5 - canvas.margin, moment)
    return _lamp(instrument, surfaces, seen, 16).reshape(height + 1, width + 1), seen


def _lamp(instrument, surfaces, seen, oversampling):
    """(n,) reflectance times the cosine of the lamp's incidence; the background's where nothing is seen."""
    lamp = instrument.lamp
    rays = seen.points / np.sqrt((seen.points**2).sum(0))
    to_lamp = -rays if lamp.towards is None else _unit(lamp.towards)
    cosine = (to_lamp * sight.normals(surfaces, seen)).sum(0)
    pixel_angle = 1 / (instrument.camera.fx * oversampling)
    light = sight.albedo(surfaces, seen, pixel_angle) * np.maximum(cosine, 0)
    return np.where(seen.surface >= 0, light, lamp.background)


def _unit(direction) -> np.ndarray:
    """(3, 1) unit vector."""
    direction = np.asarray(direction, float)[:, None]
    return direction / np.linalg.norm(direction)


def _even(corners, surface, top):
    """(H, W) bool where a pixel's corners see one surface in nearly one light, and their mean."""
    four = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1], corners[1:, 1:]])
    surfaces_of_corners = np.stack(
        [surface[:-1, :-1], surface[:-1, 1:], surface[1:, :-1], surface[1:, 1:]]
    )
    even = (np.ptp(four, axis=0) < 0.01 * top) & (
        surfaces_of_corners == surfaces_of_corners[0]
    ).all(0)
    return even, four.mean(0)


def _canvas(instrument, surfaces, moment) -> Canvas:
    """With the margin that blur needs at the depths of this scene."""
    width, height = instrument.camera.size
    pixels = sight.grid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33))
    depth = sight.look(instrument, surfaces, pixels, moment).points[2]
    return Canvas(width, height, formation.margin(instrument.optics, depth) + 1)


def _spread_stripe(instrument, found: Stripe, canvas):
    """The blurred stripe in electrons and the factor on the noise, in a box at (top, left) of the canvas.

    None where there is no stripe. A thin stripe is spread by the lens on the grid of the pixels'
    parts before the pixels gather it; else the order makes no difference.
    """
    if not len(found.flat):
        return None
    rows, columns = np.divmod(found.flat, canvas.shape[1])
    reach = canvas.margin
    top = max(rows.min() - reach, 0)
    left_column = max(columns.min() - reach, 0)
    bottom = min(rows.max() + reach + 1, canvas.shape[0])
    right = min(columns.max() + reach + 1, canvas.shape[1])
    shape = (bottom - top, right - left_column)
    place = (rows - top) * shape[1] + columns - left_column
    sigma = instrument.optics.sigma(found.depth)
    scale = instrument.laser.peak * instrument.chip.full_well_e
    spread = None if found.spread is None else _placed(found.spread, place, shape, 1.0)
    if not found.thin:
        light = _placed(found.light.mean(1) * scale, place, shape)
        return formation.defocus(light, _placed(sigma, place, shape)), spread, top, left_column
    oversampling = round(found.light.shape[1] ** 0.5)
    fine = (shape[0] * oversampling, shape[1] * oversampling)
    inner = np.arange(oversampling)
    corner = oversampling * ((rows - top) * fine[1] + columns - left_column)
    place = corner[:, None] + np.add.outer(inner * fine[1], inner).ravel()
    light = formation.defocus(
        _placed(found.light * scale, place, fine),
        _placed(np.repeat(oversampling * sigma, oversampling**2), place, fine),
    )
    return formation.gathered(light, oversampling), spread, top, left_column


def _placed(values, place, shape, fill=0.0):
    """Tensor (H, W) with values at flat places, `fill` elsewhere."""
    import torch

    canvas = torch.full((shape[0] * shape[1],), fill, device=formation.device())
    canvas[torch.as_tensor(place.ravel(), device=canvas.device)] = torch.as_tensor(
        values.ravel(), dtype=torch.float32, device=canvas.device
    )
    return canvas.reshape(shape)


def _full(box, canvas):
    """The box's light on the image image."""
    import torch

    image = torch.zeros(canvas.shape, device=formation.device())
    if box is not None:
        light, _, top, left_column = box
        image[top : top + light.shape[0], left_column : left_column + light.shape[1]] = light
    return canvas.crop(image)


def _with_stripe(instrument, lamp, found, canvas, random):
    """Lamp and speckled stripe (H, W) together, and the factor on the noise, None where it is 1."""
    import torch

    box = _spread_stripe(instrument, found, canvas)
    if box is None:
        return lamp, None
    light, spread, top, left_column = box
    light = formation.speckle(light, instrument.laser.contrast, instrument.laser.grain_px, random)
    total = lamp + _full((light, None, top, left_column), canvas)
    if spread is None:
        return total, None
    noise = torch.ones(canvas.shape, device=formation.device())
    noise[top : top + light.shape[0], left_column : left_column + light.shape[1]] = spread
    return total, canvas.crop(noise)
