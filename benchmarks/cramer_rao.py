"""The Cramer-Rao bound of the centre of a laser line, with which its detection is compared."""

import numpy as np

from sensors.stripe.profile import Noise
from workbench.core.least_squares.linear_algebra import inverse_positive


def centre_bound(
    width, amplitude, noise: Noise, background: float = 0.0, phase: float = 0.0
) -> float:
    """Cramer-Rao bound, px (1 sigma), of one row's centre; amplitude, background, centre and width unknown.

    Fisher information J' V^-1 J of the four unknowns over the pixels within 6 widths, V the
    diagonal of `noise` (normal approximation; the information in the variance itself is not counted).
    For pure read noise sigma it is sigma / amplitude * sqrt(2 width / sqrt(pi)): centre and width
    do not correlate, so that knowing the width does not improve it.
    """
    half = int(np.ceil(6 * width)) + 1
    pixel = np.arange(-half, half + 1)
    u = (pixel - phase) / width
    g = np.exp(-u * u / 2)
    by_background, by_amplitude = np.ones_like(u), g
    by_centre = amplitude * g * u / width
    by_width = amplitude * g * u * u / width
    rows = np.stack([by_background, by_amplitude, by_centre, by_width])
    variance = noise.variance(background + amplitude * g)
    information = rows / variance @ rows.T
    covariance = inverse_positive(information)
    return float(np.sqrt(covariance[2, 2]))
