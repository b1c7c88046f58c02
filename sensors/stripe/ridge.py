"""The laser line as a ridge of the smoothed image (Steger): for noisy images, at a price in resolution.

The image is smoothed by a Gaussian across the line (as wide as the line, which is the matched
filter) and one along it (`smoothing` rows). On a ridge the first derivative across it vanishes;
the Taylor polynomial of the smoothed image says where, to a fraction of a pixel: C. Steger, An
unbiased detector of curvilinear structures, IEEE PAMI 20 (1998) 113, section 3. Centres of rows
nearer than the stated resolution are not independent, and a line that curves by k (1/px) is seen
k smoothing^2 / 2 inside of its bend.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from sensors.stripe.fit import CANDIDATE, Fits, Setting
from sensors.stripe.flags import flags, runs
from sensors.stripe.pilot import SAMPLE, first_look
from sensors.stripe.rows import Rows, brightest
from workbench.core.errors import InputError

FWHM = 2 * np.sqrt(2 * np.log(2))
STRONG = 6.0
"""Curvature over its sigma below which a ridge is weak: noise reaches it once in 10^9 places."""
SECOND = 0.25
"""Part of the main ridge's curvature from which a second ridge in its row is counted."""


def ridge_parts(task, smoothing: float):
    """Parts as the mode "gauss" makes them, the `Noise` of a pixel, and the rows that a centre averages (FWHM)."""
    if not 0.5 <= smoothing <= task.height / 4:
        raise InputError(
            f"smoothing: expected 0.5 to {task.height / 4:g} rows, found {smoothing:g}; choose another"
        )
    setting = _look(task, smoothing)
    parts = []
    for k in range(len(task.stack)):
        fits, count = _image(task.rows(slice(k, k + 1))[0], setting, smoothing)
        flag = flags(fits, count > 0, task.height, task.height, setting, np.inf, strong=STRONG)
        parts.append((k, fits, flag, count))
    return parts, setting.noise, FWHM * smoothing


def _look(task, smoothing) -> Setting:
    """Noise from the pixels as they are, the line's width from a few images smoothed along it."""
    count = len(task.stack)
    step = max(1, task.height * count // SAMPLE)
    setting, _ = first_look(*task.rows(slice(0, count), step), task.saturation)
    images = [_net(task.rows(slice(k, k + 1))[0]) for k in sorted({0, count // 2, count - 1})]
    kernel = gaussian_kernel(smoothing, 0)
    soft = np.concatenate([_along(image, kernel)[:: max(1, int(smoothing))] for image in images])
    width = first_look(Rows(soft, len(soft) // len(images)), soft, np.inf)[0].width
    return replace(setting, width=width)


def gaussian_kernel(sigma: float, order: int) -> np.ndarray:
    """(2 h + 1,) `order`-th derivative of a Gaussian, for correlation; exact for polynomials of degree 2."""
    x = np.arange(-np.ceil(4 * sigma), np.ceil(4 * sigma) + 1)
    g = np.exp(-x * x / (2 * sigma**2))
    g /= g.sum()
    second = (x * x * g).sum()
    if order < 2:
        return g if order == 0 else x * g / second
    bent = (x * x - second) * g
    return 2 * bent / (x * x * bent).sum()


@dataclass(frozen=True)
class Kernels:
    """Derivatives of the smoothing: `across` and `along` the line, orders 0 to 2; `sigma` (2,) px and rows."""

    sigma: tuple[float, float]
    across: list[np.ndarray]
    along: list[np.ndarray]

    @classmethod
    def of(cls, width: float, smoothing: float) -> "Kernels":
        orders = range(3)
        return cls(
            (width, smoothing),
            [gaussian_kernel(width, k) for k in orders],
            [gaussian_kernel(smoothing, k) for k in orders],
        )

    def noise(self, across: int, along: int) -> float:
        """1 sigma of a derivative for pixels of noise 1."""
        return float(np.sqrt((self.across[across] ** 2).sum() * (self.along[along] ** 2).sum()))


def _image(rows: Rows, setting: Setting, smoothing: float):
    """`Fits` of one image's ridge, a row each, and how many further ridges each row has (n,)."""
    kernels = Kernels.of(max(setting.width, 0.8), smoothing)
    smooth = [_along(_net(rows), kernel) for kernel in kernels.along]
    bent = -cv2.sepFilter2D(
        smooth[0], cv2.CV_32F, kernels.across[2], np.ones(1), borderType=cv2.BORDER_REPLICATE
    )
    if rows.region is not None:
        bent[~rows.region] = 0
    column = np.minimum(brightest(bent).column, rows.width - 1)
    limit = setting.noise.read * kernels.noise(2, 0)
    square = setting.width**2 + kernels.sigma[0] ** 2
    fits = _centres(smooth, np.arange(len(bent)), column, kernels, rows.width, square)
    fits.strength = (bent[fits.row, column] / limit).astype(np.float32)
    last = len(bent) - 1 - int(2.5 * smoothing)
    fits.cut |= (fits.row < 2.5 * smoothing) | (fits.row > last)
    keep = (fits.strength > CANDIDATE) & (fits.peak > 0)
    fits, bent = fits.take(keep), bent[keep]
    _uncertain(fits, kernels, setting, rows)
    return fits, _others(bent, fits, column[keep], kernels, limit)


def _net(rows: Rows) -> np.ndarray:
    row = np.arange(len(rows.pixels))
    return rows.windows(row, 0 * row, rows.width)[1]


def _along(image, kernel):
    return cv2.sepFilter2D(image, cv2.CV_32F, np.ones(1), kernel, borderType=cv2.BORDER_REPLICATE)


def _centres(smooth, row, column, kernels: Kernels, width: int, square: float) -> Fits:
    """`Fits` with centre, width, peak, background: two steps of the Taylor polynomial."""
    fits = Fits.empty(row)
    half = len(kernels.across[0]) // 2
    fits.cut = (column < half) | (column >= width - half)
    for _ in range(2):
        at = np.clip(column, 0, width - 1)
        inside = np.clip(at[:, None] + np.arange(-half, half + 1), 0, width - 1)
        pieces = [image[row[:, None], inside] for image in smooth]
        d = {
            (i, j): pieces[j] @ kernels.across[i]
            for i, j in ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2))
        }
        across = _crossing(d, square)
        column = np.rint(at + across).astype(np.intp)
    fits.centre = at + across
    _profile(fits, d, pieces[0], kernels)
    return fits


def _crossing(d, square: float) -> np.ndarray:
    """(n,) px from the pixel's middle to where the ridge crosses its row: Steger's t n, followed along the ridge.

    n, the direction of the strongest curvature, is an eigenvector of the Hessian; on the ridge's
    tangent through t n the row is crossed at t / nx. On a Gaussian of variance `square` (px^2) the
    quadratic Taylor polynomial overshoots: t = d / (1 - d^2 / square), solved for d.
    """
    slope_x = d[1, 0]
    slope_y = d[0, 1]
    xx = d[2, 0]
    xy = d[1, 1]
    yy = d[0, 2]
    # curvature along one eigenvector of the Hessian; that along the other is the rest of its trace
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    cosine, sine = np.cos(angle), np.sin(angle)
    first = xx * cosine * cosine + 2 * xy * cosine * sine + yy * sine * sine
    second = xx + yy - first
    is_first = first <= second
    nx = np.where(is_first, cosine, -sine)
    ny = np.where(is_first, sine, cosine)
    strongest = np.minimum(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.nan_to_num(-(slope_x * nx + slope_y * ny) / strongest)
    distance = 2 * along / (1 + np.sqrt(1 + 4 * along**2 / square))
    # a ridge nearly along its row crosses it nowhere near: the shift is 0 there
    steep = np.where(np.abs(nx) > 0.3, nx, np.inf)
    return np.clip(distance / steep, -3, 3)


def _profile(fits, d, piece, kernels):
    """Width and height of a Gaussian line from the smoothed one: its curvature at the top and its height."""
    ends = max(1, piece.shape[1] // 10)
    ground = (piece[:, :ends].mean(1) + piece[:, -ends:].mean(1)) / 2
    height = d[0, 0] - ground
    bent = np.maximum(-d[2, 0], 1e-9)
    across = kernels.sigma[0] ** 2
    square = np.clip(height / bent, 1.05 * across, 30 * across)
    fits.width = np.sqrt(square - across).astype(np.float32)
    fits.peak = (height * np.sqrt(square) / fits.width).astype(np.float32)
    fits.background = ground.astype(np.float32)


def _uncertain(fits, kernels: Kernels, setting: Setting, rows: Rows):
    """Noise of the first derivative over the curvature; photons add where the line is bright."""
    taps = len(kernels.across[0])
    x = np.arange(taps) - taps // 2
    lit = np.exp(-0.5 * (x / fits.width[:, None]) ** 2)
    middle = np.rint(fits.centre)
    inside = np.clip(middle, 0, rows.width - 1).astype(np.intp)
    ambient = 2 * rows.ambient(fits.row, inside)
    dark = setting.noise.variance(fits.background + ambient)[:, None]
    variance = dark + setting.noise.gain * fits.peak[:, None] * lit
    slope = (variance * kernels.across[1] ** 2).sum(1) * (kernels.along[0] ** 2).sum()
    total = fits.width**2 + kernels.sigma[0] ** 2
    fits.sigma = (np.sqrt(slope) * total**1.5 / (fits.peak * fits.width)).astype(np.float32)
    fits.wide = 2 * fits.sigma / fits.width
    fits.misfit = np.ones(len(fits.row), np.float32)
    neighbours = middle[:, None] + np.array([-1, 0, 1])
    around = np.clip(neighbours, 0, rows.width - 1).astype(np.intp)
    fits.saturated = (rows.pixels[fits.row[:, None], around] >= setting.saturation).any(1)


def _others(bent, fits, column, kernels, limit):
    """(n,) how many further stretches of rows `bent` (n, width) are ridges."""
    reach = 4 * np.sqrt(fits.width**2 + kernels.sigma[0] ** 2)
    far = np.abs(np.arange(bent.shape[1]) - fits.centre[:, None]) > reach[:, None]
    high = far & (
        bent > np.maximum(SECOND * bent[np.arange(len(bent)), column], 6 * limit)[:, None]
    )
    return runs(high, fits.width.max(initial=1))
