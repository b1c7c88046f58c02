"""Displacement of the line's centre by an uneven surface: an edge of black and white pulls it to the white side."""

import cv2
import numpy as np

from sensors.stripe.fit import Fits
from sensors.stripe.profile import PHASES, Bank, bank, width_bin
from sensors.stripe.rows import Rows, row_max

_AVERAGED_ROWS = 5
"""Rows whose pulls are averaged, because a background image is noisy too; the largest of as many counts."""
NEGLIGIBLE = 0.04
"""Widths of the line; a smaller pull only widens sigma."""


def background_bias(rows: Rows, fits: Fits, noise: float) -> np.ndarray:
    """(n,) px, 0 or more, by which the fit of a line is pulled where the surface reflects as `rows.background` shows.

    The background image stands for the reflectivity: the fit's answer to the profile times the
    background. 0 without a background, and where it is too dark compared with `noise` (grey values, 1
    sigma) to tell. First order; right in size only where the scene's light is even and the camera
    linear, so that it serves to flag such rows and not to correct them.
    """
    pull = np.zeros((2, len(fits.row)))  # px, and its variance
    if rows.background is None or not len(fits.row):
        return pull[0]
    bins = width_bin(np.log(np.maximum(fits.width, 0.1)))
    for key in np.flatnonzero(np.bincount(bins)):
        table = bank(int(key), 0)
        place = np.flatnonzero(bins == key)
        if 2 * table.half + 1 <= rows.width:
            row = fits.row.take(place)
            centre = fits.centre.take(place)
            pull[:, place] = _pull(rows, row, centre, table, noise / np.sqrt(2))
    pull, variance = cv2.blur(pull, (_AVERAGED_ROWS, 1))
    is_significant = np.where(pull**2 > 9 * variance / _AVERAGED_ROWS, np.abs(pull), 0)
    return _largest_around(is_significant, _AVERAGED_ROWS // 2)


def _largest_around(values: np.ndarray, reach: int) -> np.ndarray:
    """(n,) the largest of values (n,) up to `reach` places away."""
    largest = values.copy()
    for step in range(1, reach + 1):
        np.maximum(largest[step:], values[:-step], out=largest[step:])
        np.maximum(largest[:-step], values[step:], out=largest[:-step])
    return largest


def _pull(rows, row, centre, table, noise):
    """Pull (n,) px and its variance: the background's pattern counts, not its brightness under the laser."""
    size = 2 * table.half + 1
    start = np.clip(np.rint(centre).astype(np.intp) - table.half, 0, rows.width - size)
    first = ((start - centre) / table.width).astype(np.float32)
    profile = first[:, None] + np.arange(size, dtype=np.float32) / np.float32(table.width)
    np.square(profile, out=profile)
    profile *= np.float32(-0.5)
    np.exp(profile, out=profile)
    profile *= rows.under_windows(row, start, size).astype(np.float32)
    phase = np.rint((centre - start - table.half + 0.5) * PHASES).astype(np.intp)
    phase = np.clip(phase, 0, PHASES)
    table_index = np.arange(len(row)) * (PHASES + 1) + phase
    peak, moment = ((profile @ _answer(table, number)).take(table_index) for number in (1, 2))
    scale = table.width / np.maximum(peak, 1e-3 * row_max(profile) + 1e-9)
    pull = np.clip(scale * moment, -1.5 * table.width, 1.5 * table.width)
    return pull, (scale * noise) ** 2 * table.at("across_lit", phase)


def _answer(table: Bank, number: int) -> np.ndarray:
    """(pixels, starts) by which pixels add to one of the four numbers b, A, B, C of the fit."""
    starts = table.inverse_r.shape[1]
    q = table.q.reshape(-1, starts, 4)
    inverse_r = table.inverse_r.reshape(4, 4, starts)
    return np.einsum("wpk,kp->wp", q, inverse_r[number])
