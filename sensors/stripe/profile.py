"""The Gaussian profile of a laser line: its bounds, its noise, and the linear fit of it made ready as tables.

A row of pixels is d(x) = b + A exp(-(x - c)^2 / (2 w^2)) + noise. Around a start (c0, w0) this is
linear in four numbers, d = b + A g + B g u + C g u^2 with u = (x - c0) / w0 and g = exp(-u^2 / 2):
c = c0 + w0 B / A, w = w0 (1 + C / A). One linear step from a near start is the Gauss-Newton step
of the maximum-likelihood fit of all four unknowns, and so reaches the Cramer-Rao bound.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

PHASES = 8
"""Starts a pixel for which the fit is tabulated."""
NARROWEST, WIDEST = 0.45, 40.0
"""px, the Gaussian widths that are fitted."""
_FINE, _COARSE = 0.015, 0.06
"""ln: steps of the tabulated widths below one pixel, where pixels are too large to leave room, and above."""
_FINEST = int(np.ceil(-np.log(NARROWEST) / _FINE))
RATIOS = (0.0, 1.0, 3.0, 9.0, 27.0, 81.0)
"""Photon variance at the peak over the variance next to the line, for which weights are tabulated."""


@dataclass(frozen=True)
class Noise:
    """Variance of a pixel of level L: read^2 + gain L, both in grey values (photon transfer curve).

    `read` (grey values, 1 sigma) holds everything that does not depend on the light, quantisation
    too; `gain` is grey values an electron, so that gain L is the photons' (Poisson) variance.
    """

    read: float
    gain: float = 0.0

    def variance(self, level):
        """Grey values squared, at any level."""
        if self.gain == 0:
            return np.full(np.shape(level), self.read**2, np.float32)
        return self.read**2 + self.gain * np.maximum(level, 0)


@dataclass(frozen=True)
class Bank:
    """The four-number fit for starts at `PHASES` + 1 places across a pixel, as tables.

    `width` px; `half` px, pixels each side; `ratio` as in `RATIOS`; `q` (pixels, 4 starts)
    whitened orthonormal basis; `inverse_r` (16, starts) upper triangle from those to (b, A, B, C);
    `weight` (pixels, starts) of a pixel; `spread`, each (starts,): variance of B ("across") and C
    ("wide") for variance 1 next to the line, what a variance g adds ("across_lit", "wide_lit"), and
    1 sigma of the second whitened number, the line's matched filter, where there is no line
    ("detect"); `leverage` (starts, pixels).
    """

    width: float
    ratio: float
    half: int
    q: np.ndarray
    inverse_r: np.ndarray
    weight: np.ndarray
    spread: dict[str, np.ndarray]
    leverage: np.ndarray

    @property
    def even(self) -> bool:
        """Whether the line is sampled so finely that only `q` depends on the start."""
        return self.width > 1.2

    def at(self, name: str, start: np.ndarray):
        """(n,) or one number: `spread` under its name for starts (n,)."""
        return self.spread[name][PHASES // 2] if self.even else self.spread[name].take(start)


def width_bin(log_width: np.ndarray) -> np.ndarray:
    """(n,) int, index of the tabulated width that is nearest to exp(log_width)."""
    log = np.clip(log_width, np.log(NARROWEST), np.log(WIDEST))
    return np.rint(np.where(log < 0, log / _FINE, log / _COARSE)).astype(np.intp) + _FINEST


def binned_width(width: int) -> float:
    """px, the width of a bin."""
    return float(np.exp((width - _FINEST) * (_FINE if width < _FINEST else _COARSE)))


def ratio_bin(ratio: np.ndarray) -> np.ndarray:
    """(n,) int, which of `RATIOS` is the nearest one."""
    return np.searchsorted(np.sqrt([0.12, 3.0, 27.0, 243.0, 2187.0]), ratio)


@lru_cache(maxsize=512)
def bank(width: int, ratio: int) -> Bank:
    """The tables of one width and one ratio, by their numbers."""
    w = binned_width(width)
    half = int(np.ceil(3 * w)) + 1
    phases = np.arange(PHASES + 1) / PHASES - 0.5
    pixel = np.arange(-half, half + 1)
    u = (pixel - phases[:, None]) / w
    g = np.exp(-u * u / 2)
    weight = 1 / (1 + RATIOS[ratio] * g)
    root = np.sqrt(weight)
    # background, amplitude, centre and width: an orthonormal basis of their weighted columns, of positive diagonal
    basis = np.stack([np.ones_like(g), g, g * u, g * u * u], -1)
    q, r = np.linalg.qr(root[..., None] * basis)
    sign = np.sign(np.einsum("pii->pi", r))[:, None]
    q = q * sign
    inverse_r = np.linalg.inv(r) * sign
    weighted = q * root[..., None]
    table = weighted.transpose(1, 0, 2).reshape(len(pixel), -1)
    single = [_contiguous(part) for part in (table, inverse_r.reshape(-1, 16).T, weight.T)]
    leverage = (q**2).sum(-1)
    return Bank(w, RATIOS[ratio], half, *single, _spread(q, inverse_r, root, g), leverage)


def _contiguous(values: np.ndarray) -> np.ndarray:
    """In single precision, row after row."""
    return np.ascontiguousarray(values.astype(np.float32))


def _spread(q, inverse_r, root, g) -> dict[str, np.ndarray]:
    """By name, (phases,) how noise of the pixels reaches the detection, the centre and the width of a line.

    The entries `..._lit` hold the part that grows with the light of the line.
    """
    detect = (q[..., 1] ** 2 * root**2).sum(1)
    spread = {"detect": np.sqrt(detect)}
    solution = np.einsum("pij,pwj,pw->ipw", inverse_r, q, root)
    for name, row in (("across", solution[2]), ("wide", solution[3])):
        spread[name] = (row**2).sum(-1)
        spread[name + "_lit"] = (row**2 * g).sum(-1)
    return {name: values.astype(np.float32) for name, values in spread.items()}
