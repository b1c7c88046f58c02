"""Light of the scene next to the laser's line, and by how much its slope pulls the centres of the line.

Light on a ball falls off towards its outline. The fit of a Gaussian on a constant background takes a slope of s grey
values a pixel for a shift of

    c = k s w^2 / peak,   k = sum W x^2 g / sum W x^2 g^2

of a line of width w, with g the Gaussian of 1 sigma w at x w from its middle and W the weights of the pixels: k = 2.8
where all count alike. The slope is that of the scene without the line: of the lower quartile of several images in
which nothing but the line moves.
"""

from collections.abc import Sequence

import numpy as np

MOST_IMAGES = 9
"""Images of a scan that are looked at: the line hides a place in a quarter of them at most."""
_FEWEST_IMAGES = 4
_QUARTILE = 0.25
_SMOOTH = 2.0  # px, 1 sigma: noise of the slope becomes a tenth of that of the line's centre
_MARGIN = 8  # px about the lines that are looked at: what the smoothing reaches
_REACH = 3.5  # widths to each side that a fit sees
_STEEPEST = 0.05
"""Of the peak: change of the background over one width beyond which no line is straight."""
_RATIOS = np.geomspace(1e-2, 1e2, 21)


def chosen_images(count: int) -> np.ndarray:
    """Numbers (k,) of the images of a scan that show the scene without the line; none where there are too few."""
    if count < _FEWEST_IMAGES:
        return np.zeros(0, int)
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, MOST_IMAGES))).astype(int))


def slope_pull(
    images: Sequence[np.ndarray],
    pixels: np.ndarray,
    shape: np.ndarray,
    is_across_columns: bool,
) -> np.ndarray:
    """(n,) px along the scan line by which the slope of the scene's light pulls centres at pixels (2, n).

    images: (H, W) each, the `chosen_images`; shape (3, n): width px, `Stripes.shape` and peak of the lines.
    is_across_columns: whether centres are sought along the rows of an image. 0 without images.
    """
    if not len(images) or not pixels.shape[1]:
        return np.zeros(pixels.shape[1])
    column, row = np.rint(pixels).astype(int)
    left, top = max(column.min() - _MARGIN, 0), max(row.min() - _MARGIN, 0)
    seen = slice(top, row.max() + _MARGIN + 1), slice(left, column.max() + _MARGIN + 1)
    rank = int(_QUARTILE * len(images))
    scene = np.partition(np.stack([image[seen] for image in images]), rank, axis=0)[rank]
    slope = _slope(scene.astype(np.float32), 1 if is_across_columns else 0)
    height, width = scene.shape
    own = slope[np.clip(row - top, 0, height - 1), np.clip(column - left, 0, width - 1)]
    change = np.clip(own * shape[0] / np.maximum(shape[2], 1e-6), -_STEEPEST, _STEEPEST)
    return _gain(shape[1]) * shape[0] * change


def _slope(scene: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) grey values per px along an axis, smoothed."""
    import cv2

    smooth = cv2.GaussianBlur(scene, (0, 0), _SMOOTH, borderType=cv2.BORDER_REPLICATE)
    return np.gradient(smooth, axis=axis)


def _gain(ratio: np.ndarray) -> np.ndarray:
    """(n,) k of fits whose pixels of height g (peak 1) weigh 1 / (1 + ratio g)."""
    x = np.linspace(-_REACH, _REACH, 141)
    g = np.exp(-x * x / 2)
    weight = x * x * g / (1 + _RATIOS[:, None] * g)
    return np.interp(ratio, _RATIOS, weight.sum(1) / (weight * g).sum(1))


__all__ = ["chosen_images", "slope_pull"]
