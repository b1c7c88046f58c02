"""A first look at a sample of a stack's rows: how wide the line is, how noisy the images, how to search it."""

from dataclasses import dataclass, replace

import numpy as np

from sensors.stripe.fit import Fits, Setting, fit_rows
from sensors.stripe.noise import fitted_noise, pixel_noise
from sensors.stripe.profile import Noise, bank, width_bin
from sensors.stripe.rows import (
    Brightest,
    Rows,
    brightest,
    lines_enhanced,
    without_hot,
    without_spikes,
)

SAMPLE = 1024
"""Rows of a stack that are looked at first."""
_SCALES = (0.8, 2.0, 5.0)
_SURE = 7.0
"""Sigma of a filtered row above which its largest value is no noise: 1e-12 a place."""

_WIDTH_TOLERANCE = 0.8
"""ln: widths that differ from the line's by more belong to something else, and say nothing of the noise next to it."""


@dataclass(frozen=True)
class Search:
    """Settings of the line search: `width` px of the filter, None for the brightest pixel itself; its noise."""

    width: float | None
    noise: float

    def brightest(self, image: np.ndarray) -> Brightest:
        """The most likely place of the line in every row of (n, width)."""
        return brightest(
            image if self.width is None else lines_enhanced(without_hot(image), self.width)
        )

    def fits(self, found: Brightest, rows: Rows, setting: Setting) -> Fits:
        """Fits of the brightest place of every row."""
        column = np.minimum(found.column, rows.width - 1)
        return fit_rows(
            rows,
            np.arange(len(column)),
            column,
            setting,
            found.image if self.width is None else None,
        )

    def at_width(self, width: float, image: np.ndarray, found: Brightest) -> "Search":
        """The same for a line of `width` px, where another filter suits it better; `image` and `found` of a sample."""
        suited = min(_SCALES, key=lambda scale: abs(np.log(scale / width)))
        if self.width is None or suited == self.width:
            return self
        calm = without_hot(image[_bright_rows(found)]).astype(np.float32)
        return Search(suited, pixel_noise_of(lines_enhanced(calm, suited)))


def first_look(rows: Rows, image: np.ndarray, saturation: float) -> tuple[Setting, Search]:
    """Settings of the stack that `rows` are a sample of; `image` is where the line is searched."""
    noise = Noise(max(pixel_noise(*_sampled_rows(rows)), _finest(rows.pixels)))
    found = brightest(image)
    width, search = _search(image, found, noise.read)
    setting = Setting(noise, width, saturation)
    for _ in range(3):
        places = found if search.width is None else search.brightest(image)
        fits = search.fits(places, rows, setting)
        fits = fits.take((fits.strength > 7) & ~fits.cut)
        if len(fits.row) < 20:
            return setting, search
        before = setting
        setting = _learned(rows, fits, setting, _finest(rows.pixels))
        # noise that an earlier round read from fits of another width is no noise
        setting = setting if setting.noise is not before.noise else replace(setting, noise=noise)
        last = search
        search = search.at_width(setting.width, image, found)
        if (
            abs(np.log(setting.width / before.width)) < 0.5
            and setting.noise.gain == before.noise.gain
            and search is last
        ):
            break
    return setting, search


def _sampled_rows(rows: Rows):
    """(n, width) some of the rows, less what is under, not clipped at black by that; and their region or None."""
    row = np.arange(len(rows.pixels))
    if rows.region is not None:
        row = row[rows.region.any(1)[row % rows.height]]
    row = row[:: max(1, len(row) * rows.width // 24_000)]
    region = None if rows.region is None else rows.region[row % rows.height]
    return rows.windows(row, 0 * row, rows.width)[1], region


def _finest(image) -> float:
    """1 sigma of rounding to whole grey values; of images in other numbers, of their resolution."""
    return (
        float(np.sqrt(1 / 12)) if image.dtype.kind == "u" else 1e-6 * float(np.ptp(image)) + 1e-12
    )


def _search(image, found: Brightest, noise: float) -> tuple[float, Search]:
    """Width and way of searching: filtered only where the brightest pixels often miss what the filter finds."""
    rows = _bright_rows(found)
    part, best = image[rows], None
    calm = without_hot(part).astype(np.float32)
    seen = without_spikes(
        part, np.arange(len(part)), np.minimum(found.column[rows], image.shape[1] - 1), noise
    )
    for width in _SCALES:
        enhanced = lines_enhanced(calm, width)
        rough = pixel_noise_of(enhanced)
        column = enhanced.argmax(1)
        strength = enhanced[np.arange(len(enhanced)), column] / rough
        if best is None or np.median(strength) > np.median(best[1]):
            best = width, strength, column, rough
    width, strength, column, rough = best
    is_sure_line = strength > _SURE
    missed = np.abs(column - seen)[is_sure_line] > 3 * width + 1
    is_plain_image = is_sure_line.sum() > 20 and missed.mean() < 0.02
    return width, Search(None, 0.0) if is_plain_image else Search(width, rough)


def _bright_rows(found: Brightest) -> np.ndarray:
    """(m,) rows of the largest pixels."""
    return np.sort(np.argsort(found.value.astype(float))[-128:])


def pixel_noise_of(enhanced: np.ndarray) -> float:
    """1 sigma of filtered rows (n, width), from their middle half: most of a row is not line."""
    low, high = np.percentile(enhanced[::7, ::11].ravel(), [25, 75])
    return max((high - low) / 1.349, 1e-6)


def _learned(rows: Rows, fits: Fits, setting: Setting, min_read_noise: float) -> Setting:
    """Typical width and noise from what was fitted; the noise of pixels alone where too little was."""
    width = typical_width(fits)
    clean = fits.take(~fits.saturated & (np.abs(np.log(fits.width / width)) < _WIDTH_TOLERANCE))
    odd = 1 + 4.5 * np.sqrt(2 / (2 * bank(int(width_bin(np.log(setting.width))), 0).half - 3))
    clean = clean.take(clean.misfit < odd * np.median(clean.misfit)) if len(clean.row) else clean
    clean = clean.take(slice(None, None, max(1, len(clean.row) // 1000)))
    pairs = [
        residuals(rows, clean.take(width_bin(np.log(clean.width)) == k), bank(k, 0))
        for k in np.unique(width_bin(np.log(clean.width)))
    ]
    noise = fitted_noise(*np.concatenate(pairs, 1), min_read_noise) if pairs else None
    return Setting(noise or setting.noise, width, setting.saturation)


def typical_width(fits: Fits) -> float:
    """px, median of the fits' widths, each counted with 1 / sigma of its centre.

    Where few images of a stack show the line, most rows hold at best a surface in other light, far wider and placed far
    worse, which must not stand for the line.
    """
    weight = 1 / fits.sigma.astype(float)
    weight[~np.isfinite(weight)] = 0
    if not weight.any():
        return float(np.median(fits.width))
    order = np.argsort(fits.width)
    share = np.cumsum(weight[order])
    return float(fits.width[order][np.searchsorted(share, share[-1] / 2)])


def residuals(rows: Rows, fits: Fits, table) -> np.ndarray:
    """(3, m): squared residuals of all pixels of the fits' windows, the model's level there, and 1 - leverage."""
    nearest_row = np.rint(fits.centre).astype(np.intp)
    is_inside = (nearest_row >= table.half) & (nearest_row + table.half < rows.width)
    fits, nearest_row = fits.take(is_inside), nearest_row[is_inside]
    size = 2 * table.half + 1
    _, net = rows.windows(fits.row, nearest_row - table.half, size)
    u = (np.arange(size) - table.half - (fits.centre - nearest_row)[:, None]) / fits.width[:, None]
    model = fits.background[:, None] + fits.peak[:, None] * np.exp(-u * u / 2)
    phase = np.rint((fits.centre - nearest_row + 0.5) * (len(table.leverage) - 1)).astype(np.intp)
    level = model + np.reshape(2 * rows.ambient(fits.row, nearest_row), (-1, 1))
    return np.stack(
        [((net - model) ** 2).ravel(), level.ravel(), 1 - table.leverage[phase].ravel()]
    )
