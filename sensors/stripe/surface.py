"""What an uneven surface does to the line's centre: an edge between black and white pulls it to the white side."""

from dataclasses import replace

import cv2
import numpy as np

from sensors.stripe.fit import Fits
from sensors.stripe.profile import PHASES, bank, width_bin
from sensors.stripe.rows import Rows

_OVER = 5
"""Rows whose pulls are averaged, because a background image is noisy too; the largest of as many counts."""
NEGLIGIBLE = 0.04
"""Widths of the line; a smaller pull only widens sigma."""


def uneven_pull(rows: Rows, fits: Fits, noise: float) -> np.ndarray:
    """(n,) px, 0 or more, by which the fit of a line is pulled where the surface reflects as `rows.under` shows.

    The background image stands for the reflectivity: the fit's answer to the profile times the
    background. 0 without a background, and where it is too dark compared with `noise` (grey values, 1
    sigma) to tell. First order; right in size only where the scene's light is even and the camera
    linear, so that it serves to flag such rows and not to correct them.
    """
    pull = np.zeros((2, len(fits.row)))  # px, and its variance
    if rows.under is None or not len(fits.row):
        return pull[0]
    rows = replace(
        rows, scale=np.ones_like(rows.scale)
    )  # its pattern counts, not its brightness under the laser
    bins = width_bin(np.log(np.maximum(fits.width, 0.1)))
    for key in np.unique(bins):
        table, place = bank(int(key), 0), np.flatnonzero(bins == key)
        if 2 * table.half + 1 <= rows.width:
            pull[:, place] = _pull(
                rows, fits.row[place], fits.centre[place], table, noise / np.sqrt(2)
            )
    pull, variance = cv2.blur(pull, (_OVER, 1))
    sure = np.where(pull**2 > 9 * variance / _OVER, np.abs(pull), 0)
    return cv2.dilate(sure, np.ones((_OVER, 1)))[:, 0]


def _pull(rows, row, centre, table, noise):
    size = 2 * table.half + 1
    start = np.clip(np.rint(centre).astype(np.intp) - table.half, 0, rows.width - size)
    first = ((start - centre) / table.width).astype(np.float32)
    u = first[:, None] + np.arange(size, dtype=np.float32) / np.float32(table.width)
    lit = np.exp(-u * u / 2) * rows.ambient_windows(row, start, size)
    phase = np.clip(np.rint((centre - start - table.half + 0.5) * PHASES), 0, PHASES).astype(
        np.intp
    )
    at = np.arange(len(row)) * (PHASES + 1) + phase
    q = (lit @ table.q).reshape(-1, 4).take(at, 0)
    number = np.einsum("nij,nj->ni", table.back.T[phase].reshape(-1, 4, 4), q)
    scale = table.width / np.maximum(number[:, 1], 1e-3 * lit.max(1) + 1e-9)
    pull = np.clip(scale * number[:, 2], -1.5 * table.width, 1.5 * table.width)
    return pull, (scale * noise) ** 2 * table.at("across_lit", phase)
