"""Inter-reflection: light of the stripe that one surface throws onto another, after one diffuse reflection.

Radiosity with one bounce (Cohen & Wallace, Radiosity and Realistic Image Synthesis (1993), ch. 2): a patch of area dA
and brightness B gives the irradiance B cos(a) cos(b) dA / (pi d^2), a and b the angles of the line between patch and
receiver with both normals. Nothing stands between the two. A convex body throws no light onto itself.
"""

import numpy as np

from sensors.rendering import formation
from sensors.rendering.instrument import Instrument
from sensors.rendering.stripes import Stage, Stripe

_PATCHES = 256
_BLOCK = 1 << 14  # receivers at a time
_DIM = 1e-3  # of the brightest pixel, below which a pixel throws no light


def indirect_light(instrument: Instrument, stage: Stage, found: Stripe):
    """(H, W) tensor, electrons, of the light that comes from one stripe over other surfaces; None without any."""
    share = instrument.laser.indirect
    if not share or not len(found.flat):
        return None
    rows = np.searchsorted(stage.flat, found.flat)
    points = stage.points[:, :, 0]
    normals = stage.normals[:, :, 0]
    bright = found.light.mean(1)
    lit_places = np.flatnonzero(bright > _DIM * bright.max(initial=0.0))
    if not len(lit_places):
        return None
    power = bright * _areas(instrument, points[:, rows], normals[:, rows])
    chosen = lit_places[:: -(-len(lit_places) // _PATCHES)]
    scale = power[lit_places].sum() / power[chosen].sum()
    patches = points[:, rows[chosen]], normals[:, rows[chosen]], scale * power[chosen]
    received = irradiance(points, normals, *patches) * stage.albedo[:, 0]
    return _on_image(instrument, stage, share * received)


def irradiance(
    points: np.ndarray,
    normals: np.ndarray,
    patches: np.ndarray,
    patch_normals: np.ndarray,
    power: np.ndarray,
) -> np.ndarray:
    """(n,) at points (3, n) with unit normals (3, n) by patches (3, m) with unit normals; `power` (m,) mm^2: brightness
    times area. nan, where nothing is seen, receives nothing."""
    irradiance_at_points = np.zeros(points.shape[1])
    for first in range(0, points.shape[1], _BLOCK):
        block = slice(first, first + _BLOCK)
        displacement = patches[:, None] - points[:, block, None]
        square = np.maximum((displacement**2).sum(0), 1e-12)
        arriving = np.maximum((normals[:, block, None] * displacement).sum(0), 0)
        leaving = np.maximum(-(patch_normals[:, None] * displacement).sum(0), 0)
        irradiance_at_points[block] = (arriving * leaving / square**2) @ power / np.pi
    return np.nan_to_num(irradiance_at_points)


def _areas(instrument: Instrument, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) mm^2 of surface at points (3, n) that one pixel sees."""
    distance = np.linalg.norm(points, axis=0)
    facing = np.abs((points * normals).sum(0)) / distance
    field = (points[2] / distance) ** 3  # solid angle of a pixel falls with the cube of the cosine
    camera = instrument.camera
    return distance**2 * field / (camera.fx * camera.fy * np.maximum(facing, 0.05))


def _on_image(instrument: Instrument, stage: Stage, received: np.ndarray):
    """(H, W) tensor with the light (n,) of the stage's pixels in electrons."""
    import torch

    device = formation.device()
    canvas = stage.canvas
    image = torch.zeros(canvas.shape, device=device)
    electrons = received * (instrument.laser.peak * instrument.chip.full_well_e)
    place = torch.as_tensor(stage.flat, device=device)
    image.view(-1)[place] = torch.as_tensor(electrons, dtype=torch.float32, device=device)
    return canvas.crop(image)
