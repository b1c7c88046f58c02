"""The fit of a Gaussian to every row of a block: a first step for all, then tabulated steps until they stand."""

from dataclasses import dataclass, fields

import numpy as np

from sensors.stripe.masked import fit_masked
from sensors.stripe.profile import (
    NARROWEST,
    PHASES,
    WIDEST,
    Bank,
    Noise,
    bank,
    ratio_bin,
    width_bin,
)
from sensors.stripe.rows import Rows, row_max, without_spikes

_STEPS = 4
_LAST_STEP = 0.15
"""Widths that a step may still move the centre, and parts that it may change the width, to be the last one."""
_SPREAD = 0.06
"""ln: how far a template's width may be off: 0.2 percent of the centre's sigma."""
_WIDTH_SCATTER = 0.05
"""ln: how much widths of neighbouring rows may differ."""
CANDIDATE = 4.0
"""`strength` from which a brightest pixel is looked at."""


@dataclass
class Fits:
    """One fitted peak a row, arrays (n,): of row `row` of the block.

    `centre`, `width` px; `peak` (amplitude), `background` grey values; `sigma` of the centre, px;
    `wide` sigma of ln(width); `strength` the line's matched filter over its sigma were there no line;
    `misfit` chi-square a degree of freedom; `saturated`; `cut` by the image's edge.
    """

    row: np.ndarray
    centre: np.ndarray
    width: np.ndarray
    peak: np.ndarray
    background: np.ndarray
    sigma: np.ndarray
    wide: np.ndarray
    strength: np.ndarray
    misfit: np.ndarray
    saturated: np.ndarray
    cut: np.ndarray

    def take(self, keep: np.ndarray) -> "Fits":
        """Those where `keep` (mask or numbers) says so."""
        return Fits(*(getattr(self, field.name)[keep] for field in fields(self)))

    def put(self, place: np.ndarray, other: "Fits") -> None:
        """Write `other` over the fits at `place`."""
        for field in fields(self):
            getattr(self, field.name)[place] = getattr(other, field.name)

    @classmethod
    def empty(cls, row: np.ndarray) -> "Fits":
        """Nothing fitted yet in rows (n,): numbers as they come, but for `strength` and `wide`, which are 0."""
        number = [np.empty(len(row), np.float32) for _ in range(5)]
        nothing = [np.zeros(len(row), np.float32) for _ in range(2)]
        no = np.zeros((2, len(row)), bool)
        return cls(row, np.empty(len(row)), *number[:4], *nothing, number[4], *no)


@dataclass(frozen=True)
class Setting:
    """Settings of a whole stack: `noise`, the line's typical `width` px, the level of saturation."""

    noise: Noise
    width: float
    saturation: float


def fit_rows(rows: Rows, row: np.ndarray, column: np.ndarray, setting: Setting, image=None) -> Fits:
    """Fits of the peaks near `column` (n,) in rows `row` (n,), ascending; what is no more than noise is left out.

    `image` (rows, width) is where the line is searched: hot pixels are passed over. None to stay.
    """
    fits, hard, steep = first_step(rows, row, column, setting)
    if image is not None and len(steep):
        calm = without_spikes(image, row[steep], column[steep], setting.noise.read)
        hot = calm != column[steep]
        other = steep[hot]
        calm = np.minimum(calm[hot], rows.width - 1)
        refitted, hard[other], _ = first_step(rows, row[other], calm, setting)
        fits.put(other, refitted)
    keep = fits.strength > CANDIDATE
    if not keep.all():
        fits, hard = fits.take(keep), hard[keep]
    hard |= _tabulated(rows, fits, setting, ~hard)
    if hard.any():
        fits.put(hard, fit_masked(rows, fits.take(hard), setting))
    return fits


def first_step(rows: Rows, row: np.ndarray, column: np.ndarray, setting: Setting):
    """`Fits` one linear step from whole pixels and the typical width.

    Also which rows need the masked fit (n,) bool, and which may stand on a hot pixel (m,).
    """
    table = bank(int(width_bin(np.log(setting.width))), 0)
    size = min(2 * table.half + 1, rows.width)
    start = np.clip(column - table.half, 0, rows.width - size)
    raw, net = rows.windows(row, start, size)
    fits = Fits.empty(row)
    fits.cut = (start != column - table.half) | (size < 2 * table.half + 1)
    if raw.max(initial=0) >= setting.saturation:
        fits.saturated = row_max(raw) >= setting.saturation
    middle = slice(2 * PHASES, 2 * PHASES + 4)
    if size == 2 * table.half + 1:
        q = table.q[:, middle]
        inverse_r = table.inverse_r[:, PHASES // 2].reshape(4, 4)
        number = np.concatenate([inverse_r @ q.T, q.T[1:2]]) @ net.T
        fits.strength = number[4]
        fits.background, fits.peak = number[0], number[1]
        _move(fits, slice(None), column.astype(float), table.width, number)
    hard = fits.cut | fits.saturated
    if hard.any():
        fits.put(
            hard,
            _rough(
                fits.take(hard), net[hard], raw[hard] >= setting.saturation, start[hard], setting
            ),
        )
    expected_light = fits.background
    if setting.noise.gain > 0:
        expected_light = expected_light + 2 * rows.ambient(row, column)
    quiet = setting.noise.variance(expected_light)
    height = np.where(hard, fits.peak, fits.strength) if hard.any() else fits.strength
    fits.strength = height / np.sqrt(quiet)
    return fits, hard, _steep(raw, table.half, 8 * setting.noise.read)


def _steep(raw, half, limit):
    """(m,) those of windows (n, w) whose pixel `half` is far above both its neighbours."""
    if raw.shape[1] < half + 2:
        return np.empty(0, np.intp)
    neighbour = np.maximum(raw[:, half - 1], raw[:, half + 1])
    return np.flatnonzero(
        (raw[:, half] > neighbour) & (raw[:, half] - neighbour.astype(np.float32) > limit)
    )


def _rough(fits, net, full, start, setting):
    """A start from the pixels themselves: middle of what is saturated, else the largest pixel."""
    place = np.arange(net.shape[1])
    count = full.sum(1)
    middle = np.where(count > 0, (full * place).sum(1) / np.maximum(count, 1), net.argmax(1))
    fits.centre = start + middle
    fits.background = np.partition(net, net.shape[1] // 5, axis=1)[:, net.shape[1] // 5]
    fits.peak = np.maximum(net.max(1) - fits.background, 0)
    fits.width = np.maximum(setting.width, 0.45 * count).astype(np.float32)
    return fits


def _move(fits, place, start, width, number):
    """Read the four numbers (4, n) of a step from `start` (n,) px into `fits` at `place`.

    Gives how far the centre moved, px, and ln of how much the width changed. A template of a wrong
    width answers to a shift by (1 - e/2), e the relative error of the width; ln(width) is the
    second-order solution of the same projection.
    """
    inverse = 1 / np.where(number[1] > 0, number[1], np.inf)
    change = np.clip(number[3] * inverse, -0.5, 0.5)
    shift = width * np.clip(number[2] * inverse * (1 + change / 2), -1.2, 1.2)
    change -= 0.25 * change * change
    fits.centre[place] = start + shift
    fits.width[place] = width * np.exp(change)
    return shift, change


def _tabulated(rows: Rows, fits: Fits, setting: Setting, todo: np.ndarray) -> np.ndarray:
    """Steps for the fits `todo` (n,) until they stand; True (n,) where the masked fit has to take over."""
    todo = np.flatnonzero(todo)
    hard = np.zeros(len(fits.row), bool)
    for _ in range(_STEPS):
        if not len(todo):
            break
        level, bins = _bins(rows, fits, setting, todo)
        unfinished = [np.empty(0, np.intp)]
        for key in np.flatnonzero(np.bincount(bins)):
            is_in_bin = bins == key
            place, part = (todo, level) if is_in_bin.all() else (todo[is_in_bin], level[is_in_bin])
            unfinished.append(
                _step(rows, fits, place, part, bank(int(key) // 8, int(key) % 8), setting, hard)
            )
        todo = np.concatenate(unfinished)
    return hard


def _bins(rows, fits, setting, todo):
    """Variance (m,) of a pixel next to the line, and numbers (m,) that name a table: 8 width bin + ratio bin."""
    smooth = smooth_log_width(fits, len(rows.pixels), setting.width).take(todo)
    low, high = smooth.min(), smooth.max()
    if high - low < 2 * _SPREAD and low > 0.05:  # one table for all costs half of two
        wide = width_bin((low + high) / 2)
    else:
        wide = width_bin(_template(fits, todo, smooth))
    level = fits.background.take(todo)
    if rows.background is not None and setting.noise.gain > 0:
        level = level + 2 * rows.ambient(fits.row[todo], _column(fits, todo, rows))
    level = setting.noise.variance(level)
    bins = np.full(len(todo), wide * 8)
    if setting.noise.gain > 0:
        bins += ratio_bin(setting.noise.gain * np.maximum(fits.peak[todo], 0) / level)
    return level, bins


def _template(fits, place, smooth):
    """(m,) ln(width) of the template: the neighbours'; of an undersampled line its own, as far as that is certain."""
    narrow = smooth < 0.05
    if not narrow.any():
        return smooth
    log_width = np.log(np.clip(fits.width[place], NARROWEST, WIDEST)) - smooth
    return smooth + narrow * log_width * _WIDTH_SCATTER**2 / (
        _WIDTH_SCATTER**2 + fits.wide[place] ** 2
    )


def _column(fits, place, rows):
    return np.clip(np.rint(fits.centre[place]), 0, rows.width - 1).astype(np.intp)


def smooth_log_width(fits: Fits, rows: int, typical: float, row_count: int = 25) -> np.ndarray:
    """(n,) ln(width), the mean over some rows, weighted by amplitude."""
    import cv2

    if not len(fits.row):
        return np.empty(0, np.float32)
    sorted_peaks = np.sort(fits.peak[::32])
    strong = np.clip(fits.peak, 1e-3, max(4 * sorted_peaks[len(sorted_peaks) // 2], 1e-3))
    strong = strong * ((fits.strength > 5.5) & ~fits.cut) + np.float32(1e-6)
    basis = np.stack([strong, strong * np.log(np.clip(fits.width, 0.3 * typical, 4 * typical))])
    if len(fits.row) == rows:
        sums = cv2.blur(basis, (row_count, 1))
    else:
        weight = np.zeros((2, rows), np.float32)
        weight[:, fits.row] = basis
        sums = cv2.blur(weight, (row_count, 1)).take(fits.row, 1)
    return sums[1] / sums[0]


def _step(rows: Rows, fits: Fits, place, quiet, table: Bank, setting: Setting, hard) -> np.ndarray:
    """One tabulated step of the fits at `place`; those of them (m,) that have to go on."""
    centre = fits.centre.take(place)
    size = 2 * table.half + 1
    nearest_row = np.rint(centre).astype(np.intp)
    is_outside = (nearest_row < table.half) | (nearest_row + table.half >= rows.width)
    if is_outside.any():
        hard[place[is_outside]] = True
        is_inside = ~is_outside
        place, quiet, nearest_row, centre = (
            place[is_inside],
            quiet[is_inside],
            nearest_row[is_inside],
            centre[is_inside],
        )
    _, net = rows.windows(fits.row.take(place), nearest_row - table.half, size)
    # single precision keeps what the fit leaves over; q takes a level out of all numbers but the background
    level = np.float32(fits.background.take(place).mean())
    net -= level
    phase = np.rint((centre - nearest_row + 0.5) * PHASES).astype(np.intp)
    number, match, misfit = _solve(net, phase, table)
    selection = slice(None) if len(place) == len(fits.row) else place
    shift, change = _move(
        fits, selection, nearest_row + (phase / PHASES - 0.5), table.width, number
    )
    fits.background[selection] = level + number[0]
    fits.peak[selection] = number[1]
    fits.strength[selection] = match / np.sqrt(quiet)
    fits.misfit[selection] = misfit / (quiet * (size - 4))
    wide = _uncertain(fits, selection, quiet, phase, table, setting.noise)
    is_unfinished = np.abs(shift) > _LAST_STEP * table.width
    is_unfinished |= np.abs(change) > (_LAST_STEP + 4 * wide if table.even else 0.03 + wide)
    return place[is_unfinished]


def _solve(net, phase, table: Bank):
    """The four numbers (4, n), the line's matched filter (n,), the weighted sum of squares that is left (n,).

    `net` is squared in place.
    """
    table_index = np.arange(len(net)) * (PHASES + 1) + phase
    q = np.ascontiguousarray((net @ table.q).reshape(-1, 4).take(table_index, 0).T)
    if table.even:
        number = table.inverse_r[:, PHASES // 2].reshape(4, 4) @ q
    else:
        number = np.einsum("nij,jn->in", table.inverse_r.T.reshape(-1, 4, 4).take(phase, 0), q)
    square = np.square(net, out=net)
    if table.ratio == 0:
        remainder = square @ np.ones(net.shape[1], np.float32)
    else:
        remainder = (square @ table.weight).reshape(-1).take(table_index)
    return number, q[1] / table.at("detect", phase), np.maximum(remainder - (q * q).sum(0), 0)


def _uncertain(fits, place, quiet, phase, table: Bank, noise):
    """Variances of the fit for the noise as it is, whatever the weights were (sandwich); sigma (n,) of ln(width)."""
    peak = np.maximum(fits.peak[place], 1e-6)
    variance = quiet * table.at("across", phase)
    wide = quiet * table.at("wide", phase)
    if noise.gain > 0:
        variance += noise.gain * peak * table.at("across_lit", phase)
        wide += noise.gain * peak * table.at("wide_lit", phase)
    fits.sigma[place] = np.sqrt(table.width * fits.width[place] * variance) / peak
    wide = np.sqrt(wide) / peak
    fits.wide[place] = wide
    return wide
