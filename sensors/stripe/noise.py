"""Noise estimated from the images themselves: read noise, photon noise, exposure of the background."""

from dataclasses import dataclass

import numpy as np

from sensors.stripe.profile import Noise
from workbench.core.distributions import MEDIAN_TO_SIGMA

_CLIP, _KEPT = 3.0, 0.97334
"""Sigma beyond which a difference is no noise, and the part of a normal variance that lies within."""
_ROBUST = 2000
"""Pixels of an image that tell which others are the line's: their medians are exact to 3 percent of sigma."""
_DARK = 0.02
"""Sigma of an exposure's scale from which a background is too dark to tell it."""


def pixel_noise(image: np.ndarray, region: np.ndarray | None = None) -> float:
    """1 sigma of the grey values of a pixel in rows (n, width); region (n, width) bool: only there, None: everywhere.

    Second differences along rows, without outliers beyond 3 sigma: they cancel light that changes linearly, and the
    laser line is an outlier. Assumes independent noise of neighbouring pixels; `fitted_noise` does not.
    """
    image = image.astype(np.float32)
    rough = np.abs(image[:, 2:] - 2 * image[:, 1:-1] + image[:, :-2]) / np.float32(np.sqrt(6))
    rough = rough.ravel() if region is None or not region[:, 1:-1].any() else rough[region[:, 1:-1]]
    sigma = max(MEDIAN_TO_SIGMA * float(_median(rough)), 0.3)
    for _ in range(10):
        small = rough[rough < _CLIP * sigma]
        before = sigma
        sigma = max(float(np.sqrt((small**2).mean() / _KEPT)), 1e-6) if len(small) else sigma
        if sigma == before:
            break
    floor = image.min()
    if (
        image == floor
    ).mean() > 0.2:  # clipped at black: only the upper half of the noise is there to be seen
        sigma = max(sigma, float(np.quantile(image[::2], 0.977) - floor) / 2)
    return sigma


def fitted_noise(
    squares: np.ndarray, level: np.ndarray, freedom: np.ndarray, min_read_noise: float
) -> Noise | None:
    """Read noise and photon gain from squared residuals (n,) of fits, by the level (n,) that the model gives them.

    E(squares) = freedom (read^2 + gain level), freedom (n,) = 1 - leverage; weighted by
    freedom^2 / variance^2, because what is left where the fit has no freedom is the fit's own
    curvature; residuals beyond 4.5 sigma are cut off. No gain where it is less than three times its sigma.
    None where there are too few residuals.
    """
    if len(squares) < 500:
        return None
    y, middle, trust = squares / freedom, level.mean(), freedom**2
    x = level - middle
    square = x**2
    variance = np.full(len(squares), float(_median(y)) / 0.455)
    for _ in range(6):
        use = (y < 20 * variance) * trust
        weight = use / variance**2
        total = weight.sum()
        mean = float(weight @ x) / weight.sum()
        power = float(weight @ square) - total * mean**2
        weighted = weight * y
        first = float(weight @ y)
        gain = (float(weighted @ x) - mean * first) / power
        # the variance of a slope's pull is the weight's square times that of y
        use *= weight
        scatter = float(use @ square) - 2 * mean * float(use @ x) + mean**2 * use.sum()
        gain = gain if gain > 3 * np.sqrt(2 * scatter) / power else 0.0
        read = max(first / total - gain * (mean + middle), min_read_noise**2)
        variance = read + gain * np.maximum(level, 0)
    return Noise(float(np.sqrt(read)), float(gain))


def exposure_scales(images: np.ndarray, backgrounds: np.ndarray, noise: float) -> np.ndarray:
    """(F,) how much brighter `images` (F, h, w) are exposed than `backgrounds` (F or 1, h, w), their backgrounds.

    Least squares, the line cut off, of what varies over the image, because a black level is in both,
    whatever the exposure; of the levels themselves where the background is even. 1 where it is too
    dark to tell (sigma of the scale above 0.02).
    """
    scales = np.ones(len(images), np.float32)
    scene = None
    for k, image in enumerate(images):
        if scene is None or len(backgrounds) > 1:
            scene = _Scene.of(_thinned(backgrounds[k % len(backgrounds)]), noise)
        scales[k] = scene.exposure_scale(_thinned(image), noise)
    return scales


def _thinned(image) -> np.ndarray:
    """(n,) float32, every 35th pixel of an image (h, w)."""
    return image[::7, ::5].astype(np.float32).ravel()


@dataclass(frozen=True)
class _Scene:
    """A background's pixels (n,), less their mean where they are `uneven`: where its level varies more than noise."""

    background: np.ndarray
    uneven: bool

    @classmethod
    def of(cls, background: np.ndarray, noise: float) -> "_Scene":
        """From grey values (n,)."""
        uneven = bool(noise <= _DARK * np.sqrt(len(background)) * background.std())
        return cls(background - background.mean() if uneven else background, uneven)

    def exposure_scale(self, light: np.ndarray, noise: float) -> float:
        """Scale of grey values (n,): medians, which are slow, of some pixels find the line, all others count."""
        light = light - light.mean() if self.uneven else light
        sample = slice(None, None, max(1, len(light) // _ROBUST))
        a = light[sample].copy()
        b = self.background[sample].copy()
        use = np.ones(len(a), bool)
        for _ in range(8):
            scale, offset, _ = _line_fit(a, b, use, self.uneven)
            remainder = a - scale * b
            middle = _median(remainder)
            spread = max(
                MEDIAN_TO_SIGMA * float(_median(np.abs(remainder - middle))), 0.5 * noise, 1e-9
            )
            before = use
            use = np.abs(remainder - middle * self.uneven) < 3 * spread
            if np.array_equal(use, before):
                break
        remainder = np.float32(scale) * self.background
        np.subtract(light, remainder, out=remainder)
        remainder -= np.float32(offset)
        use = np.abs(remainder, out=remainder) < np.float32(3 * spread)
        scale, _, power = _line_fit(light, self.background, use, self.uneven)
        return scale if noise < _DARK * np.sqrt(power) else 1.0


def _median(values: np.ndarray) -> np.floating:
    """As `np.median` of finite values (n,), which takes twice as long."""
    half = len(values) // 2
    if len(values) % 2:
        return np.partition(values, half)[half]
    return np.partition(values, (half - 1, half))[half - 1 : half + 1].mean()


def _line_fit(a, b, use, uneven) -> tuple[float, float, float]:
    """Least squares of a = scale b + offset over `use` (n,), offset 0 unless `uneven`; (scale, offset, power of b)."""
    use = use.astype(np.float32)
    count = max(float(use.sum()), 1.0)
    used = b * use
    mean_a, mean_b = (float(a @ use) / count, float(used.sum()) / count) if uneven else (0.0, 0.0)
    power = float(used @ b) - count * mean_b**2
    scale = (float(used @ a) - count * mean_a * mean_b) / power if power > 0 else 1.0
    return scale, mean_a - scale * mean_b, max(power, 0.0)
