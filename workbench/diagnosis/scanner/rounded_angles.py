"""Rounded mirror angles: what rounding moves all points of one commanded angle by, as a random effect.

A controller that writes angles with a few digits rounds each of them, by the same amount whenever the mirror returns
there. That is no vibration and no error of an encoder: an error that is uniform in a last digit of u has the variance
u^2 / 12 (Widrow & Kollar, Quantization Noise, 2008, ch. 3).
"""

import numpy as np

from sensors.light.together import Step, decorrelated, random_effect
from workbench.diagnosis.levels import ANGLE_DECIMALS, NEGLIGIBLE_SHARE

_COARSEST = 0.05
"""Last digit over the usual distance of two angles, above which the angles are as commanded and not rounded."""


def rounding_std(angles: np.ndarray) -> float:
    """rad, 1 sigma by which commanded angles (n,) rad are rounded; 0 where they are not.

    Angles in equal steps are taken as exact.
    """
    degrees = np.rad2deg(np.unique(angles[np.isfinite(angles)]))
    if len(degrees) < 3:
        return 0.0
    for digits in range(ANGLE_DECIMALS + 1):
        whole = degrees * 10.0**digits
        if (np.abs(whole - np.rint(whole)) < NEGLIGIBLE_SHARE).all():
            gaps = np.diff(np.rint(whole))
            is_exact = np.ptp(gaps) == 0 or 1 > _COARSEST * np.median(gaps)
            return 0.0 if is_exact else float(np.deg2rad(10.0**-digits) / np.sqrt(12))
    return 0.0


def rounding_steps(
    angles: np.ndarray, by_angle: np.ndarray, sigma: np.ndarray, before: list[Step]
) -> list[Step]:
    """Factors that make points independent which one rounded angle displaces together, after those `before`.

    angles (n,) rad as commanded, by_angle (n,) px/rad by which the mirror moves a point, sigma (n,) px.
    """
    spread = rounding_std(angles)
    if not spread:
        return []
    label = np.unique(angles, return_inverse=True)[1]
    return [random_effect(spread, label, decorrelated(before, by_angle), sigma**-2.0)]
