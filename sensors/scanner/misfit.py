"""Lack of fit of stripe centres: what a model leaves, compared with the noise that the images themselves show.

Neighbouring centres of one stripe err by noise alone, whatever the model misses: an unmodelled effect moves a stripe
as a whole, tilts it or bends it. A cubic polynomial along each stripe therefore separates the two. What remains after
it is pure error; what it explains beyond the share of pure error is lack of fit (Draper & Smith, Applied Regression
Analysis, 3rd ed. (1998), sec. 2.1).
"""

from dataclasses import dataclass

import numpy as np

_ORDERS = 4  # polynomials of degree 0 to 3
_FEWEST_POINTS = 12
_FEWEST_STRIPES = 3
_LEVEL = 1e-3
# Share of the noise of a single centre from which lack of fit matters. Below it, uneven reflectance and perspective
# explain it, and the random effects of stripes and placements in the covariance hold it.
_RELEVANT = 0.5
_RELATED = 0.05  # autocorrelation below which noise along a stripe counts as independent
_FARTHEST = 60  # points


@dataclass(frozen=True)
class Misfit:
    """Lack of fit of `stripes` stripes.

    `noise_px` 1 sigma of a single centre, from its neighbours along the stripe. `shift_px`, `tilt_px` and `bend_px`:
    RMS displacement of centres by shift, tilt and bend (degrees 2 and 3) of whole stripes beyond noise. `p_value` of
    an F test that noise alone does as much.
    """

    noise_px: float
    shift_px: float
    tilt_px: float
    bend_px: float
    p_value: float
    stripes: int

    @property
    def total_px(self) -> float:
        """RMS displacement of centres by lack of fit of all kinds."""
        return float(np.sqrt(self.shift_px**2 + self.tilt_px**2 + self.bend_px**2))

    @property
    def is_relevant(self) -> bool:
        """Whether lack of fit is significant and not small compared with the noise of a single centre."""
        return self.p_value < _LEVEL and self.total_px > _RELEVANT * self.noise_px

    @property
    def sentence(self) -> str:
        """Size of the lack of fit by kind, in words."""
        return (
            f"stripes are shifted as a whole by {self.shift_px:.2g} px, tilted by {self.tilt_px:.2g} px and bent by "
            f"{self.bend_px:.2g} px against the model (RMS beyond noise); the noise of one centre is "
            f"{self.noise_px:.2g} px"
        )

    def as_json(self) -> dict:
        """The object `misfit` of the JSON contract."""
        return {
            "noise_px": self.noise_px,
            "shift_px": self.shift_px,
            "tilt_px": self.tilt_px,
            "bend_px": self.bend_px,
            "total_px": self.total_px,
            "p_value": self.p_value,
            "stripes": self.stripes,
            "relevant": self.is_relevant,
        }


def stripe_misfit(
    residual: np.ndarray, stripe: np.ndarray, along: np.ndarray, known: np.ndarray | None = None
) -> Misfit | None:
    """Lack of fit of residuals (n,) px along the scan line; None where there are too few stripes.

    stripe (n,) int: label of the stripe of each centre. along (n,) px: its place along the stripe.
    known (n,) px^2: variance of each residual from stated errors that move its whole stripe (of flange poses, of a
    turntable); what these explain is no lack of fit.
    """
    stated = 0.0 if known is None else float(known.sum())
    order = np.lexsort((along, stripe))
    residual, stripe, along = residual[order], stripe[order], along[order]
    edges = np.flatnonzero(np.diff(stripe)) + 1
    parts = [
        _decomposed(values, places)
        for values, places in zip(np.split(residual, edges), np.split(along, edges))
        if len(values) >= _FEWEST_POINTS
    ]
    if len(parts) < _FEWEST_STRIPES:
        return None
    explained = np.sum([part[0] for part in parts], axis=0)
    rest = [part[1] for part in parts]
    return _tested(explained, rest, stated)


def _decomposed(values: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares (4,) explained by each polynomial degree, and the remainder (k,) of one stripe."""
    middle = (places[0] + places[-1]) / 2
    half = max((places[-1] - places[0]) / 2, 1e-9)
    powers = np.vander((places - middle) / half, _ORDERS, increasing=True)
    basis = np.linalg.qr(powers)[0]
    coefficients = basis.T @ values
    return coefficients**2, values - basis @ coefficients


def _tested(explained: np.ndarray, rest: list[np.ndarray], stated: float) -> Misfit:
    from scipy.special import fdtrc

    stripes = len(rest)
    count = sum(len(part) for part in rest)
    degrees = count - _ORDERS * stripes
    squares = float(sum(part @ part for part in rest))
    variance = max(squares / degrees, 1e-300)
    inflation = _memory(rest)
    # Correlated noise gives low degrees of a polynomial more than the variance of independent noise.
    expected = variance * inflation * stripes
    ratio = float(explained.sum()) / (_ORDERS * expected + stated)
    independent = stripes if stated > expected else _ORDERS * stripes
    p_value = float(fdtrc(independent, max(degrees / inflation, 1.0), ratio))
    of_shift = np.array([stated, 0.0, 0.0, 0.0])
    beyond = np.sqrt(np.maximum(explained - expected - of_shift, 0.0) / count)
    bend = float(np.hypot(beyond[2], beyond[3]))
    return Misfit(
        float(np.sqrt(variance)), float(beyond[0]), float(beyond[1]), bend, p_value, stripes
    )


def _memory(rest: list[np.ndarray]) -> float:
    """1 + 2 times the sum of the autocorrelations up to the first small one (Geyer, Statistical Science 7 (1992))."""
    power = sum(float(part @ part) for part in rest)
    total = 1.0
    for lag in range(1, _FARTHEST):
        pairs = sum(float(part[lag:] @ part[:-lag]) for part in rest if len(part) > lag)
        share = pairs / max(power, 1e-300)
        if share < _RELATED:
            break
        total += 2 * share
    return total
