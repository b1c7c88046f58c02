"""Flags of unreliable peaks: other peaks in the row, no neighbours, too weak, cut, of a wrong shape."""

import numpy as np

from sensors.stripe.fit import Fits, Setting, fit_rows, smooth_log_width
from sensors.stripe.pilot import Search
from sensors.stripe.profile import bank, width_bin
from sensors.stripe.rows import Brightest, Rows, _cut, floor, row_max, without_spikes
from sensors.stripe.surface import NEGLIGIBLE

DOUBLE, EDGE, WEAK, SHAPE, ALONE, UNEVEN = 1, 2, 4, 8, 16, 32
NAMES = {
    DOUBLE: "double",
    EDGE: "edge",
    WEAK: "weak",
    SHAPE: "shape",
    ALONE: "alone",
    UNEVEN: "uneven",
}
STRONG = 7.0
"""Matched filter over its sigma below which a peak is weak: below it noise next to the peak pulls it off too often."""
SECOND = 0.25
"""Part of the main peak's height from which a second one in its row is counted."""
STEEPEST = 1.5
"""px a row that a line may run; a steeper one is to be searched along the other axis."""
SHORTEST = 12
"""Rows of the shortest piece of a line that is distinguishable from a glint."""
_HIGHEST = 20.0
"""Height of a clipped line over what is left of it below saturation: beyond it only tails farther than 2.4 widths are
left, where no line is a Gaussian, and which light that overflows from full pixels (blooming) displaces by widths."""
_WIDTH_CHANGE = 0.2
"""ln: how much wider or narrower than in the rows around a line may be."""


def others(found: Brightest, rows: Rows, fits: Fits, setting: Setting, search: Search):
    """Peaks next to the main one: how many (n,), and the strongest as `Fits` with its place (m,) among `fits`.

    Where the brightest peak is no line, by its width, and another one is, `fits` gets that one.
    """
    count = np.zeros(len(fits.row), np.int16)
    limit = _limit(found, fits, setting, search)
    place = np.flatnonzero(_suspicious(found, fits, limit, setting))
    if not len(place):
        return count, place, fits.take(place)
    image = found.image[fits.row[place]].copy()
    reach = (3 * fits.width[place] + 2)[:, None]
    image[np.abs(np.arange(image.shape[1]) - fits.centre[place, None]) <= reach] = floor(image)
    column = image.argmax(1)
    if search.width is None:
        column = without_spikes(image, np.arange(len(image)), column, setting.noise.read)
    column = np.minimum(column, rows.width - 1)
    second = _fit_in_order(rows, fits.row[place], column, setting)
    keep = (second.strength > STRONG) & _plausible(second, setting)
    spike = keep & ~_plausible(fits.take(place), setting)
    fits.put(place[spike], second.take(spike))
    keep &= ~spike & (second.peak > 0.8 * SECOND * fits.peak[place])
    count[place[keep]] = runs(image[keep] > limit[place[keep], None], setting.width)
    return count, place[keep], second.take(keep)


def _plausible(fits: Fits, setting: Setting) -> np.ndarray:
    """(n,) whether a peak is about as wide as the line: a hot pixel is not."""
    return np.abs(np.log(fits.width / setting.width)) < 0.8 + 3 * fits.wide


def _limit(found, fits, setting, search):
    """(n,) value in the searched image above which a pixel belongs to some other peak."""
    if search.width is not None:
        return np.maximum(SECOND * found.value[fits.row], 6 * search.noise)
    noise = np.sqrt(setting.noise.variance(fits.background))
    return fits.background + np.maximum(SECOND * fits.peak, 6 * noise)


def _suspicious(found: Brightest, fits: Fits, limit, setting):
    """(n,) whether a pixel next to the main peak is above `limit`: pieces of the row, then what is next to the peak."""
    length = found.piece
    width = found.image.shape[1]
    half = int(3 * np.minimum(fits.width, 2 * setting.width).max(initial=0)) + 3
    middle = np.rint(fits.centre).astype(np.intp)
    is_suspicious = _largest_elsewhere(found, fits.row, middle, half) > limit
    start = middle - half - length
    size = 2 * (half + length) + 1
    inner = (start >= 0) & (start + size <= width)
    place = slice(None)
    if not inner.all():
        is_suspicious |= ~inner
        place = np.flatnonzero(inner)
    surroundings = _cut(found.image, fits.row[place] * width + start[place], size)
    for side in (slice(0, length), slice(size - length, size)):
        is_suspicious[place] |= row_max(surroundings[:, side]) > limit[place]
    return is_suspicious


def _largest_elsewhere(found: Brightest, row, middle, half) -> np.ndarray:
    """(n,) largest pixel of those pieces of the rows (n,) that have none within `half` px of `middle` (n,) px."""
    is_every_row = len(row) == found.pieces.shape[1]
    pieces = found.pieces.copy() if is_every_row else found.pieces.take(row, 1)
    flat, count = pieces.reshape(-1), len(row)
    columns = np.arange(count)
    first, last = ((middle + side) // found.piece for side in (-half, half))
    first = np.maximum(first, 0)
    last = np.clip(last, 0, len(pieces) - 1)
    lowest = floor(pieces)
    for offset in range(int((last - first).max(initial=0)) + 1):
        flat[np.minimum(first + offset, last) * count + columns] = lowest
    return pieces.max(0)


def _fit_in_order(rows, row, column, setting):
    """As `fit_rows`, but with an entry for every row asked, of strength 0 where there was only noise."""
    every_row = Fits.empty(row)
    every_row.width[:] = 1
    every_row.peak[:] = 0
    fits = fit_rows(rows, row, column, setting)
    every_row.put(np.searchsorted(row, fits.row), fits)
    return every_row


def runs(high, width):
    """(m,) stretches of True in rows (m, w), those nearer than three widths taken as one."""
    import cv2

    if not high.size:
        return np.zeros(len(high), np.int16)
    reach = np.ones((1, 2 * int(np.ceil(1.5 * width)) + 1), np.uint8)
    high = cv2.morphologyEx(high.astype(np.uint8), cv2.MORPH_CLOSE, reach)
    return (high[:, 0] + (np.diff(high.astype(np.int8), axis=1) == 1).sum(1)).astype(np.int16)


def follow(fits: Fits, place: np.ndarray, second: Fits, rows: int, height: int) -> None:
    """Choose between two peaks of a row: the one that agrees with more of the neighbours within 24 rows."""
    if not len(place):
        return
    offset = np.r_[-24:0, 1:25]
    neighbour_rows = np.clip(fits.row[place, None] + offset, 0, rows - 1)
    same = neighbour_rows // height == fits.row[place, None] // height
    for _ in range(8):
        line = np.full(rows, np.nan)
        line[fits.row] = fits.centre
        agree = [
            (
                same
                & (np.abs(line[neighbour_rows] - peak[:, None]) < 1 + STEEPEST * np.abs(offset))
            ).sum(1)
            for peak in (fits.centre[place], second.centre)
        ]
        swap = agree[1] > agree[0]
        if not swap.any():
            break
        before = fits.take(place[swap])
        fits.put(place[swap], second.take(swap))
        second.put(swap, before)


def supported(fits: Fits, height: int, sound: np.ndarray) -> np.ndarray:
    """(n,) whether a peak stands in a chain with `SHORTEST` or more of the peaks that are `sound` (n,) bool.

    Single strangers do not break a chain.
    """
    if len(fits.row) < 2:
        return np.zeros(len(fits.row), bool)
    tolerance = 0.5 + 4 * np.minimum(fits.sigma, fits.width)
    linked = _linked(fits.row, fits.centre, tolerance, height)
    is_supported = np.zeros(len(fits.row), bool)
    is_supported[1:] = linked
    is_supported[:-1] |= linked
    supported_places = np.flatnonzero(is_supported)
    if len(supported_places) < 2:
        return is_supported & False
    if len(supported_places) < len(is_supported):
        linked = _linked(
            fits.row[supported_places],
            fits.centre[supported_places],
            tolerance[supported_places],
            height,
        )
    starts = np.append(0, np.flatnonzero(~linked) + 1)
    count = np.add.reduceat(sound[supported_places], starts, dtype=np.intp)
    length = np.diff(starts, append=len(supported_places))
    is_supported[supported_places] = np.repeat(count >= min(SHORTEST, height // 8), length)
    return is_supported


def _linked(row, centre, tolerance, height) -> np.ndarray:
    """(n - 1,) whether a peak continues the line of the one before it, over a gap of at most three rows."""
    step = np.diff(row)
    linked = np.abs(np.diff(centre)) < tolerance[1:] + tolerance[:-1] + STEEPEST * step
    image = row // height
    return linked & (step <= 4) & (image[1:] == image[:-1])


def flags(
    fits: Fits,
    double: np.ndarray,
    rows: int,
    height: int,
    setting: Setting,
    misfit: float,
    pull: np.ndarray | float = 0.0,
    strong: float = STRONG,
) -> np.ndarray:
    """(n,) uint8, sums of `NAMES`. `double` (n,); `misfit` as of `usual_misfit`, `pull` as of `background_bias`."""
    smooth_width = smooth_log_width(fits, rows, setting.width, 65)
    change = (np.log(fits.width) - smooth_width) ** 2 / (_WIDTH_CHANGE**2 + (4.5 * fits.wide) ** 2)
    allowed = 1 + 6 * np.sqrt(2 / _freedom(setting)) + 8 * misfit * fits.strength**2
    odd = (
        (change > 1)
        | ~_plausible(fits, setting)
        | (fits.misfit > allowed)
        | ~(fits.sigma < fits.width)
        | (fits.saturated & (fits.peak > _HIGHEST * (setting.saturation - fits.background)))
    )
    bits = EDGE * fits.cut + WEAK * (fits.strength < strong) + SHAPE * odd
    bits = bits + DOUBLE * double + ALONE * ~supported(fits, height, bits == 0)
    if np.any(pull):
        bits = bits + UNEVEN * (pull > np.maximum(fits.sigma, NEGLIGIBLE * fits.width))
    return bits.astype(np.uint8)


def usual_misfit(fits: Fits, setting: Setting) -> float:
    """Deviation of real profiles from a Gaussian: median of the excess of chi-square over strength^2."""
    strong = (fits.strength > STRONG) & _plausible(fits, setting)
    excess = np.maximum(fits.misfit[strong] - 1, 0) / fits.strength[strong] ** 2
    return float(np.median(excess)) if strong.any() else 0.0


def noise_scale(fits: Fits, setting: Setting) -> float:
    """Factor on the noise of the pilot fit, from the chi-square of all fits.

    Read noise alone: with photon noise the tabulated weights are too coarse to tell.
    """
    clean = (fits.strength > STRONG) & ~fits.cut & ~fits.saturated & _plausible(fits, setting)
    if setting.noise.gain > 0 or clean.sum() < 100:
        return 1.0
    misfit = fits.misfit[clean]
    return float(
        np.sqrt(
            misfit[misfit < (1 + 4.5 * np.sqrt(2 / _freedom(setting))) * np.median(misfit)].mean()
        )
    )


def _freedom(setting: Setting) -> int:
    """Degrees of freedom of a row's fit."""
    return 2 * bank(int(width_bin(np.log(setting.width))), 0).half - 3
