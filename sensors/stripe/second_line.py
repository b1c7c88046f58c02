"""A second, weaker line parallel to the laser line, from the asymmetry of the mean profile: a ghost line.

Light that is reflected twice in a cover glass or a front-coated mirror makes a copy of the line at a constant distance.
Where the copy lies within the line's width it makes the profile asymmetric and displaces the centre. Such a profile is
also made by a laser whose own beam is asymmetric (coma, a clipped beam). Both are fitted to the odd part of the mean
profile, the latter as Gram-Charlier series of third and fifth order (Kendall & Stuart, The Advanced Theory of
Statistics, vol. 1, ch. 6), and compared by the Bayesian information criterion.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import expit

from sensors.stripe.asymmetry import PLACES, Profiles, mean_odd_profile

_FINE = np.linspace(-8.0, 10.0, 721)  # widths
_ROUNDS = 12
_STARTS = tuple((share, offset) for share in (0.05, 0.3) for offset in (0.8, 1.5, 2.5, 3.5))
_LARGEST_SHARE, _FARTHEST = 0.9, 5.0
_POSITIVE = PLACES > 0
_NORMAL = np.exp(-0.5 * PLACES[_POSITIVE] ** 2)


@dataclass(frozen=True)
class SecondLine:
    """`share` of the brightness of the line, at `offset_px` from it along the scan line, with standard uncertainties
    `std` (2,) of both; `shift_px` displacement of the fitted centre; `probability` against an asymmetric beam."""

    share: float
    offset_px: float
    std: np.ndarray
    shift_px: float
    probability: float

    def as_json(self) -> dict:
        """The object `second_line` of the JSON contract."""
        return {
            "share": self.share,
            "share_std": float(self.std[0]),
            "offset_px": self.offset_px,
            "offset_std_px": float(self.std[1]),
            "shift_px": self.shift_px,
            "probability": self.probability,
        }


def second_line(profiles: Profiles) -> SecondLine | None:
    """The second line that fits the mean profile of all images best; None where there are too few images."""
    found = mean_odd_profile(profiles)
    if found is None:
        return None
    odd, std, width_px = found
    side = float(np.sign(odd[_POSITIVE] @ (PLACES[_POSITIVE] ** 3 * _NORMAL))) or 1.0
    target, std = side * odd[_POSITIVE], std[_POSITIVE]

    def residual(values):
        return _difference_over_std((target - _odd_profile(*values)[0]) / std, std)

    bounds = ([0.0, 0.1], [_LARGEST_SHARE, _FARTHEST])
    fits = [least_squares(residual, start, bounds=bounds, x_scale=(0.1, 1.0)) for start in _STARTS]
    best = min(fits, key=lambda fit: fit.cost)
    squares = 2 * best.cost
    beam, order = _asymmetric_beam(target, std)
    count = len(target) - 1
    scale = max(squares / (count - 2), 1.0)
    criterion = (squares - beam) / scale + (2 - order) * np.log(count)
    _, width, shift = _odd_profile(*best.x)
    covariance = scale * np.linalg.pinv(best.jac.T @ best.jac)
    to_px = width_px / width
    share, offset = best.x
    deviations = np.sqrt(np.diag(covariance)) * np.array([1.0, to_px])
    px_scale = side * to_px
    return SecondLine(
        float(share),
        float(px_scale * offset),
        deviations,
        float(px_scale * shift),
        float(expit(-criterion / 2)),
    )


def _asymmetric_beam(target: np.ndarray, std: np.ndarray) -> tuple[float, int]:
    """Sum of squares and number of parameters of the better series, of third or of fifth order."""
    x = PLACES[_POSITIVE]
    third = (x**3 - 3 * x) * _NORMAL
    fifth = (x**5 - 10 * x**3 + 15 * x) * _NORMAL
    best = (np.inf, 0)
    for columns in ([third], [third, fifth]):
        rows = np.stack([_difference_over_std(column / std, std) for column in columns], axis=1)
        goal = _difference_over_std(target / std, std)
        left = goal - rows @ np.linalg.lstsq(rows, goal, rcond=None)[0]
        squares = float(left @ left)
        penalty = len(columns) * np.log(len(target))
        if squares + penalty < best[0] + best[1] * np.log(len(target)):
            best = squares, len(columns)
    return best


def _difference_over_std(values: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Values (k,) over std without what another definition of the centre makes: the derivative of the line."""
    slope = PLACES[_POSITIVE] * _NORMAL / std
    return values - slope * (slope @ values) / (slope @ slope)


def _odd_profile(share: float, offset: float) -> tuple[np.ndarray, float, float]:
    """Odd part at positive places of two lines of width 1, `offset` apart, about the Gaussian that fits them best.

    Also the width of this Gaussian and its distance from the first line.
    """
    line = np.exp(-0.5 * _FINE**2) + share * np.exp(-0.5 * (_FINE - offset) ** 2)
    peak, centre, width = 1.0, share * offset / (1 + share), 1.0
    for _ in range(_ROUNDS):
        place = (_FINE - centre) / width
        shape = np.exp(-0.5 * place**2)
        rows = np.stack([shape, peak * shape * place / width, peak * shape * place**2 / width])
        step = np.linalg.solve(rows @ rows.T, rows @ (line - peak * shape))
        peak, centre, width = np.array([peak, centre, width]) + step
    width = abs(width)

    def at(place):
        position = centre + width * place
        return np.exp(-0.5 * position**2) + share * np.exp(-0.5 * (position - offset) ** 2)

    places = PLACES[_POSITIVE]
    return (at(places) - at(-places)) / (2 * peak), float(width), float(centre)
