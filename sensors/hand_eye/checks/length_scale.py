"""Lengths that images show compared with those of the flange: a regression with errors in both variables.

The board's place is one for all poses: R_i (b Rx c_i + x) + t_i = w, with R_i and t_i of the flange, Rx and x of the
unknown hand-eye transform, c_i the board in the camera, and b the length of the flange for one of the images. Without
x, w and a small error of Rx, which are eliminated linearly, t_i and c_i each leave one vector. Both have errors, of
which only the sum is known. Least squares of either on the other then bounds the ratio from both sides (Frisch 1934;
Klepper & Leamer, Econometrica 52 (1984)): errors of the explaining variable attenuate the slope. A camera that looks
at the middle of the board from a constant distance leaves errors alone, and the interval is unbounded.
"""

from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.start import align
from workbench.core.distributions import student
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.core.rigid import skew

_LEVEL = 1e-4
"""How often the interval of a right recording may exclude the ratio, whatever the errors are."""
_SIGMA = 0.3173
"""Probability of more than one standard deviation."""
_RANK = 1e-9


@dataclass(frozen=True)
class LengthScale:
    """Lengths that images show over those of the flange: `value` and its standard deviation `std`.

    The interval from `low` to `high` excludes a right ratio once in 10,000 recordings. Where the poses do not determine
    the ratio, `value` is nan, `std` and `high` are inf, and `low` is 0.
    """

    value: float
    std: float
    low: float
    high: float


UNKNOWN = LengthScale(np.nan, np.inf, 0.0, np.inf)


def length_scale(moved: np.ndarray, seen: np.ndarray) -> LengthScale:
    """Of poses `moved` (P, 4, 4) of the camera's mount in the board's, and of the board in the camera `seen` (P, 4, 4).

    The origin of the board should be its middle, where its position is known best.
    """
    flange, camera, degrees = _reduced(moved, seen)
    moments = np.array([camera @ camera, camera @ flange, flange @ flange])
    if degrees < 1 or not moments[[0, 2]].min() > 0 or moments[1] <= 0:
        return UNKNOWN
    low, high = _bounds(moments, degrees, _LEVEL)
    one_sigma_bounds = _bounds(moments, degrees, _SIGMA)
    if not np.isfinite(high):
        return UNKNOWN
    value = float(np.sqrt(moments[0] / moments[2]))
    return LengthScale(value, (one_sigma_bounds[1] - one_sigma_bounds[0]) / 2, low, high)


def _bounds(moments, degrees: int, level: float) -> tuple[float, float]:
    """Least and largest ratio: confidence limits of least squares of the camera on the flange, and the reverse."""
    quantile = float(student.isf(level / 2, degrees))
    square, mixed, other = moments
    half_width = np.sqrt(max(1 - mixed**2 / (square * other), 0.0) / degrees) * quantile
    low = mixed / other - half_width * np.sqrt(square / other)
    slope = mixed / square - half_width * np.sqrt(other / square)
    return max(float(low), 0.0), float(1 / slope) if slope > 0 else np.inf


def _reduced(moved, seen) -> tuple[np.ndarray, np.ndarray, int]:
    """(3P,) mm of the flange and of the camera without what the hand-eye transform explains, and degrees of freedom."""
    rotation = align(moved, seen)[0][:3, :3]
    flange_rotations = moved[:, :3, :3]
    count = len(moved)
    places = np.einsum("pij,pj->pi", flange_rotations @ rotation, seen[:, :3, 3])
    spins = skew(places) @ flange_rotations
    fixed = np.tile(np.eye(3), (count, 1, 1))
    nuisance = np.concatenate([flange_rotations, fixed, spins], axis=2).reshape(3 * count, 9)
    nuisance = nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300)
    base, sizes, _ = thin_svd(nuisance)
    base = base[:, sizes > _RANK * sizes[0]]
    translations = np.stack([moved[:, :3, 3].ravel(), -places.ravel()], axis=1)
    flange, camera = (translations - base @ (base.T @ translations)).T
    return flange, camera, 3 * count - base.shape[1] - 1
