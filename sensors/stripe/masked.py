"""The same fit where pixels are missing: clipped ones are left out, so are those beyond the image's edge."""

import numpy as np

_STEPS, _CHUNK = 12, 4096
_PRIOR = 0.4
"""1 sigma of ln(width) around the stack's width: flanks of a clipped line hardly separate width and amplitude."""


def fit_masked(rows, fits, setting):
    """`Fits` refined by weighted Gauss-Newton steps over their unclipped pixels, from where they stand.

    A pixel is left out where it is clipped and where the model says that its noise may clip it,
    not by its noisy value alone: that would favour one sign of the noise near the limit.
    """
    for first in range(0, len(fits.row), _CHUNK):
        place = np.arange(first, min(first + _CHUNK, len(fits.row)))
        fits.put(place, _fit(rows, fits.take(place), setting))
    return fits


def _fit(rows, fits, setting):
    half = int(min(np.ceil(3 * np.quantile(fits.width, 0.95)) + 2, (rows.width - 1) // 2))
    size = 2 * half + 1
    start = np.clip(np.rint(fits.centre).astype(np.intp) - half, 0, rows.width - size)
    raw, net = rows.windows(fits.row, start, size)
    x = start[:, None] + np.arange(size)
    net = net.astype(float)
    ambient = 2 * rows.ambient(
        fits.row, np.clip(np.rint(fits.centre), 0, rows.width - 1).astype(np.intp)
    )
    ambient = np.broadcast_to(ambient, len(fits.row))
    clipped = raw >= setting.saturation
    number = np.stack(
        [fits.background, np.maximum(fits.peak, 1e-3), fits.centre, np.log(fits.width)]
    ).astype(float)
    for _ in range(_STEPS):
        mask, basis, variance = _linear(number, x, clipped, raw - net, setting, ambient)
        inverse, answer = _solved(
            net, basis, mask / variance, number, clipped.any(1) / _PRIOR, setting.width
        )
        before, number = number, _moved(number, answer)
        if np.abs(number[2:] - before[2:]).max() < 0.01:
            break
    fits.saturated = clipped.any(1)
    return _read(
        fits, number, net, (mask, basis, variance, inverse, answer), rows.width, setting, ambient
    )


def _linear(number, x, clipped, background, setting, ambient):
    b, a, c, log = (v[:, None] for v in number)
    u = (x - c) / np.exp(log)
    g = np.exp(-u * u / 2)
    variance = setting.noise.variance(b + a * g + ambient[:, None])
    limit = setting.saturation - 2 * np.sqrt(variance) - background
    mask = (
        ~clipped
        & ((b + a * g < limit) | ~clipped.any(1)[:, None])
        & (np.abs(u) < 3 + 2 / np.exp(log))
    )
    return mask, np.stack([np.ones_like(g), g, g * u, g * u * u], 1), variance


def _solved(net, basis, weight, number, trust, width):
    normal = np.einsum("niw,nw,njw->nij", basis, weight, basis)
    right = np.einsum("niw,nw->ni", basis, weight * net)
    nought = 0 * trust
    prior = (
        np.stack([nought, number[3] - np.log(width), nought, nought + 1], 1)
        * (trust / number[1])[:, None]
    )
    normal += prior[:, :, None] * prior[:, None, :]
    scale = np.sqrt(np.einsum("nii->ni", normal)) + 1e-12
    normal = normal / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(4)
    inverse = np.linalg.inv(normal) / scale[:, :, None] / scale[:, None, :]
    return inverse, np.einsum("nij,nj->ni", inverse, right)


def _moved(number, answer):
    """The next b, A, c, ln w: steps are held, because far from the answer the linear fit overshoots."""
    b, a, displacement, wide = answer.T
    a = np.clip(a, 0.3 * number[1], 3 * number[1])
    width = np.exp(number[3])
    return np.stack(
        [
            b,
            a,
            number[2] + width * np.clip(displacement / a, -0.6, 0.6),
            number[3] + np.clip(wide / a, -0.3, 0.3),
        ]
    )


def _read(fits, number, net, last, width, setting, ambient):
    mask, basis, variance, inverse, answer = last
    fits.background = number[0].astype(np.float32)
    fits.peak = number[1].astype(np.float32)
    fits.centre = number[2]
    fits.width = np.exp(np.clip(number[3], -3, 5)).astype(np.float32)
    fits.sigma = (fits.width * np.sqrt(inverse[:, 2, 2]) / fits.peak).astype(np.float32)
    fits.wide = (np.sqrt(inverse[:, 3, 3]) / fits.peak).astype(np.float32)
    quiet = setting.noise.variance(number[0] + ambient)
    fits.strength = (_matched(basis[:, 1], net, basis[:, 1] > 1e-3) / np.sqrt(quiet)).astype(
        np.float32
    )
    remainder = net - np.einsum("niw,ni->nw", basis, answer)
    fits.misfit = ((mask * remainder**2 / variance).sum(1) / np.maximum(mask.sum(1) - 4, 1)).astype(
        np.float32
    )
    fits.cut = (number[2] < 1.5 * fits.width) | (number[2] > width - 1 - 1.5 * fits.width)
    return fits


def _matched(g, net, is_used):
    """(n,) the line's matched filter over its sigma for noise 1; clipped pixels as they are: they are no noise."""
    count = np.maximum(is_used.sum(1, keepdims=True), 1)
    g = is_used * (g - (is_used * g).sum(1, keepdims=True) / count)
    return (g * net).sum(1) / np.sqrt((g * g).sum(1) + 1e-12)
