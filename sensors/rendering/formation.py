"""Image formation on torch and kornia: blur, speckle, noise, saturation, numbers. On a GPU where there is one.

Light is in electrons, float32, (H, W) tensors. Geometry never comes through here.
"""

from functools import cache

import numpy as np

from sensors.rendering.instrument import Chip, Optics

_SPREAD = 4  # kernels reach this many sigmas
_LEVELS, _RATIO = 6, 1.15  # blurs that a image is mixed from: so many, or so close to one another


@cache
def device():
    """The GPU where there is one, else the processor."""
    import torch

    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def full_precision():
    """A context in which a GPU filters in single precision.

    cuDNN's default, TensorFloat-32, keeps 10 bits of a product's factors: enough to move an edge by 0.005 px.
    """
    import torch

    return torch.backends.cudnn.flags(enabled=True, allow_tf32=False)


def generator(seed: int, *place: int):
    """Random numbers of one image: the same for the same seed and place, whatever was made before."""
    import torch

    word = int(np.random.SeedSequence((seed, *place)).generate_state(1, np.uint64)[0] >> 1)
    return torch.Generator(device()).manual_seed(word)


def margin(optics: Optics, depth: np.ndarray) -> int:
    """Pixels around a image from where blur at these depths still brings light in."""
    known = depth[np.isfinite(depth)]
    return int(np.ceil(_SPREAD * (optics.sigma(known).max() if known.size else optics.blur_px)))


def blur(light, sigma: float):
    """(H, W) light spread by a Gaussian of `sigma` px; what leaves the frame is lost."""
    from kornia.filters import gaussian_blur2d

    side = 2 * int(np.ceil(_SPREAD * sigma)) + 1
    sigmas = (float(sigma), float(sigma))
    with full_precision():
        spread = gaussian_blur2d(light[None, None], (side, side), sigmas, border_type="constant")
    return spread[0, 0]


def defocus(light, sigma):
    """(H, W) light spread, each pixel's by its own `sigma` (H, W) px.

    A mixture of a few Gaussians, whose weights give every pixel's light its right second moment:
    light is neither made nor lost, nor moved.
    """
    import torch

    sigma_of_lit = sigma[light > 0]
    low, high = (
        (float(sigma_of_lit.min()), float(sigma_of_lit.max()))
        if sigma_of_lit.numel()
        else (1.0, 1.0)
    )
    count = int(min(_LEVELS, 1 + np.ceil(np.log(high / low) / np.log(_RATIO))))
    if count == 1 or high < 1.02 * low:
        return blur(light, (low + high) / 2)
    levels = np.geomspace(low, high, count)
    total = torch.zeros_like(light)
    for k, level in enumerate(levels):
        total += blur(light * _share(sigma**2, levels**2, k), level)
    return total


def _share(value, knots, k):
    """Weight of knot k in the straight line between knots: 1 there, 0 at its neighbours."""
    rise = (value - knots[k - 1]) / (knots[k] - knots[k - 1]) if k else 1 + 0 * value
    fall = (
        (knots[k + 1] - value) / (knots[k + 1] - knots[k]) if k + 1 < len(knots) else 1 + 0 * value
    )
    import torch

    return torch.minimum(rise, fall).clamp(0, 1)


def gathered(light, oversampling: int):
    """(H, W) means over squares of oversampling x oversampling of a finer image."""
    from torch.nn.functional import avg_pool2d

    return avg_pool2d(light[None, None], oversampling)[0, 0]


def speckle(light, contrast: float, grain: float, random):
    """(H, W) light times a field of mean 1 and standard deviation `contrast`, grains of 1 sigma `grain` px.

    Log-normal, so that it is never negative: Goodman, Speckle Phenomena in Optics (2007), sec. 4.5,
    has gamma for partly averaged speckle, which at contrasts below a half hardly differs.
    """
    import torch

    if not contrast:
        return light
    field = torch.randn(light.shape, generator=random, device=light.device)
    if grain > 0.2:  # smaller ones differ from pixel to pixel anyway
        reach = np.arange(-int(np.ceil(_SPREAD * grain)), int(np.ceil(_SPREAD * grain)) + 1)
        kernel = np.exp(-(reach**2) / (2 * grain**2))
        kernel /= kernel.sum()
        field = _wrapped_blur(field, grain) / float((kernel**2).sum())
    spread = np.sqrt(np.log1p(contrast**2))
    return light * torch.exp(spread * field - spread**2 / 2)


def _wrapped_blur(field, sigma):
    """A blur that leaves the variance at the borders as it is in the middle."""
    from kornia.filters import gaussian_blur2d

    side = _kernel_side(sigma, min(field.shape))
    with full_precision():
        smooth = gaussian_blur2d(
            field[None, None], (side, side), (sigma, sigma), border_type="circular"
        )
    return smooth[0, 0]


def _kernel_side(sigma: float, shorter_side: int) -> int:
    """px, odd: of a kernel that holds the blur, as far as it is smaller than the field."""
    wanted = 2 * int(np.ceil(_SPREAD * sigma)) + 1
    largest = 2 * (shorter_side // 2) - 1
    return max(min(wanted, largest), 1)


def vignetted(light, camera, power: float):
    """(H, W) light less what a lens loses off its axis: the cosine of the field angle to a power, 4 by nature.

    Born & Wolf, Principles of Optics, 7th ed., sec. 4.8. The angle is that of the pinhole's ray.
    """
    if not power:
        return light
    length = _pinhole_rays(light, camera).norm(dim=-1)
    return light * length**-power


def _pinhole_rays(light, camera):
    """(H, W, 3) rays of the pixels of an image `light` (H, W), of depth 1."""
    import torch
    from kornia.geometry import create_meshgrid
    from kornia.geometry.camera import unproject_points

    height, width = light.shape
    pixels = create_meshgrid(height, width, normalized_coordinates=False, device=light.device)[0]
    matrix = torch.as_tensor(camera.matrix, dtype=light.dtype, device=light.device)
    depth = torch.ones((height, width, 1), dtype=light.dtype, device=light.device)
    return unproject_points(pixels.to(light.dtype), depth, matrix[None, None])


def bloomed(light, chip: Chip):
    """(H, W) electrons after charge beyond the full well has spilled along the columns, up and down alike."""
    if not chip.blooming:
        return light
    from kornia.filters import filter2d

    excess = (light - chip.full_well_e).clamp_min(0)
    kernel = _spill_kernel(chip.spill_px, light.device)
    with full_precision():
        spilled = filter2d(excess[None, None], kernel, border_type="constant")[0, 0]
    return light + chip.blooming * spilled


def _spill_kernel(spill_px: float, device):
    """(1, k, 1) shares of the spilled charge that the pixels above and below receive, 0 for the pixel itself."""
    import torch

    reach = int(np.ceil(5 * spill_px))
    distance = torch.arange(-reach, reach + 1, device=device).abs()
    kernel = torch.exp(-distance / spill_px) * (distance > 0)
    return (kernel / kernel.sum())[None, :, None]


def develop(light, chip: Chip, random, spread=None) -> np.ndarray:
    """(H, W) image as the file has it of `light` in electrons.

    Photon noise is normal with the variance of the count (Poisson's third moment is lost, which is
    an eighth of a grey level at 8 bits); `spread` multiplies the noise where it is given.
    """
    import torch

    light = bloomed(light, chip)
    noise = torch.randn(light.shape, generator=random, device=light.device)
    noise *= torch.sqrt(light + chip.read_noise_e**2)
    if spread is not None:
        noise *= spread
    return numbers(noise.add_(light), chip)


def numbers(light, chip: Chip) -> np.ndarray:
    """(H, W) uint8 or uint16 of `light` in electrons, without noise: saturated and rounded."""
    import torch

    gain = chip.top * (1 - chip.black) / chip.full_well_e
    value = (light * gain).add_(chip.top * chip.black).round_().clamp_(0, chip.top)
    if chip.bits <= 8:
        return value.to(torch.uint8).cpu().numpy()
    return (value.to(torch.int32) * chip.scale).cpu().numpy().astype(np.uint16)
