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
# explain it, and the random effects of stripes and board poses in the covariance hold it.
_RELEVANT = 0.5
_FARTHEST = 60  # points
_MAX_STRIPES = 30  # stripes that the autocovariance of noise is taken from
_ROUNDS = 8
_BEYOND_ZERO = 1  # lags, by which the remainders' autocovariance falls to zero too early


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
    residual: np.ndarray,
    stripe: np.ndarray,
    stripe_place: np.ndarray,
    known: np.ndarray | None = None,
) -> Misfit | None:
    """Lack of fit of residuals (n,) px along the scan line; None where there are too few stripes.

    stripe (n,) int: label of the stripe of each centre. along (n,) px: its place along the stripe.
    known (n,) px^2: variance of each residual from stated errors that move its whole stripe (of flange poses, of a
    turntable); what these explain is no lack of fit.
    """
    stated = 0.0 if known is None else float(known.sum())
    order = np.lexsort((stripe_place, stripe))
    residual, stripe, stripe_place = residual[order], stripe[order], stripe_place[order]
    edges = np.flatnonzero(np.diff(stripe)) + 1
    stripes = [
        _decomposed(values, places)
        for values, places in zip(np.split(residual, edges), np.split(stripe_place, edges))
        if len(values) >= _FEWEST_POINTS
    ]
    if len(stripes) < _FEWEST_STRIPES:
        return None
    return _tested(stripes, stated)


@dataclass(frozen=True)
class _Stripe:
    """One stripe: `basis` (n, 4) orthonormal polynomials, `explained` (4,) squares, `residual` (n,) remainder, px."""

    basis: np.ndarray
    explained: np.ndarray
    residual: np.ndarray


def _decomposed(values: np.ndarray, places: np.ndarray) -> _Stripe:
    """Residuals (n,) of one stripe at places (n,), by polynomial degree."""
    middle = (places[0] + places[-1]) / 2
    half = max((places[-1] - places[0]) / 2, 1e-9)
    powers = np.vander((places - middle) / half, _ORDERS, increasing=True)
    basis = np.linalg.qr(powers)[0]
    coefficients = basis.T @ values
    return _Stripe(basis, coefficients**2, values - basis @ coefficients)


def _tested(stripes: list[_Stripe], stated: float) -> Misfit:
    from scipy.special import fdtrc

    explained = np.sum([stripe.explained for stripe in stripes], axis=0)
    count = sum(len(stripe.residual) for stripe in stripes)
    noise = _autocovariance(stripes)
    # Correlated noise gives low degrees of a polynomial more than the variance of independent noise.
    expected = np.sum([_explained_by_noise(stripe.basis, noise) for stripe in stripes], axis=0)
    by_noise = float(expected.sum())
    ratio = float(explained.sum()) / max(by_noise + stated, 1e-300)
    inflation = max(1.0, float(noise[0] + 2 * noise[1:].sum()) / max(float(noise[0]), 1e-300))
    independent = len(stripes) if stated > by_noise / _ORDERS else _ORDERS * len(stripes)
    degrees = max((count - _ORDERS * len(stripes)) / inflation, 1.0)
    p_value = float(fdtrc(independent, degrees, ratio))
    of_shift = np.array([stated, 0.0, 0.0, 0.0])
    excess = np.sqrt(np.maximum(explained - expected - of_shift, 0.0) / count)
    bend = float(np.hypot(excess[2], excess[3]))
    sigma = float(np.sqrt(max(float(noise[0]), 1e-300)))
    return Misfit(sigma, float(excess[0]), float(excess[1]), bend, p_value, len(stripes))


def _autocovariance(stripes: list[_Stripe]) -> np.ndarray:
    """(lags,) px^2, of the noise along stripes, up to where it falls to zero.

    That of the remainders is too small, since the polynomial takes a part of correlated noise: for a noise of the
    autocovariance C the remainder (I - H) e has (I - H) C (I - H). C is corrected until the two agree.
    """
    lags = int(np.clip(min(len(stripe.residual) for stripe in stripes) // 2, 1, _FARTHEST))
    sample = stripes[:: -(-len(stripes) // _MAX_STRIPES)]
    measured = _by_lag([np.outer(stripe.residual, stripe.residual) for stripe in sample], lags)
    ends = np.flatnonzero(measured < 0)
    used = np.arange(lags) < (ends[0] + _BEYOND_ZERO if len(ends) else lags)
    noise = np.where(used, measured, 0.0)
    for _ in range(_ROUNDS):
        remainders = [_remainder(stripe.basis, noise) for stripe in sample]
        noise = np.where(used, noise + measured - _by_lag(remainders, lags), 0.0)
    return noise


def _by_lag(matrices: list[np.ndarray], lags: int) -> np.ndarray:
    """(lags,) mean over the diagonals of all matrices (n, n)."""
    sums = [[np.trace(matrix, offset=lag) for lag in range(lags)] for matrix in matrices]
    counts = [[len(matrix) - lag for lag in range(lags)] for matrix in matrices]
    return np.sum(sums, axis=0) / np.sum(counts, axis=0)


def _toeplitz(noise: np.ndarray, n: int) -> np.ndarray:
    """(n, n) covariance of noise with an autocovariance (lags,)."""
    from scipy.linalg import toeplitz

    return toeplitz(np.pad(noise, (0, max(n - len(noise), 0)))[:n])


def _remainder(basis: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(n, n) covariance of what the polynomials (n, 4) leave of noise."""
    covariance = _toeplitz(noise, len(basis))
    remainder = covariance - basis @ (basis.T @ covariance)
    return remainder - (remainder @ basis) @ basis.T


def _explained_by_noise(basis: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(4,) px^2 that polynomials (n, 4) are expected to explain of noise."""
    return np.einsum("nk,nm,mk->k", basis, _toeplitz(noise, len(basis)), basis, optimize=True)
