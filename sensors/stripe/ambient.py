"""Light of the scene next to the laser's line, and by how much its slope pulls the centres of the line.

Light on a ball falls off towards its outline. The fit of a Gaussian on a constant background takes a slope of s grey
values a pixel for a shift of

    c = k s w^2 / peak,   k = sum W x^2 g / sum W x^2 g^2

of a line of width w, with g the Gaussian of 1 sigma w at x w from its middle and W the weights of the pixels: k = 2.8
where all count alike. The slope is that of the scene without the line: of the lower quartile of several images in
which nothing but the line moves. Fewer images hide places in all of them: there the light to both sides of the line is
interpolated across it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MOST_IMAGES = 9
"""Images of a scan that are looked at: the line hides a place in a quarter of them at most."""
_FEWEST_IMAGES = 4
"""Images from which on the lower quartile shows each place without the line."""
_HIDDEN = 4.0  # widths to each side of a line that its light covers
_WINDOW = 5  # px, of the windows next to the line whose mean counts
_QUARTILE = 0.25
_SMOOTH = 2.0  # px, 1 sigma: noise of the slope becomes a tenth of that of the line's centre
_MARGIN = 8  # px about the lines that are looked at: what the smoothing reaches
_REACH = 3.5  # widths to each side that a fit sees
_STEEPEST = 0.05
"""Of the peak: change of the background over one width beyond which no line is straight."""
_RATIOS = np.geomspace(1e-2, 1e2, 21)


@dataclass(frozen=True)
class Lines:
    """Centres of an image's laser lines: `pixels` (2, k), `width` (k,) px, and whether these are along the rows."""

    pixels: np.ndarray
    width: np.ndarray
    is_across_columns: bool

    @property
    def transposed(self) -> "Lines":
        """The same in the transposed image."""
        return Lines(self.pixels[::-1], self.width, not self.is_across_columns)


def chosen_images(count: int) -> np.ndarray:
    """Numbers (k,) of the images of a scan that show the scene."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, MOST_IMAGES))).astype(int))


def scene_of(image: np.ndarray, count: int, lines: Lines) -> np.ndarray:
    """An image (H, W) of `count` chosen ones for `ambient_bias`: without its lines where the images are few."""
    if count >= _FEWEST_IMAGES or not lines.pixels.shape[1]:
        return image
    if lines.is_across_columns:
        return _without_lines(image, lines)
    return _without_lines(image.T, lines.transposed).T


def _without_lines(image: np.ndarray, lines: Lines) -> np.ndarray:
    """An image (H, W) in which the light next to the lines along its columns goes on under them."""
    import cv2

    hidden = np.zeros(image.shape, np.uint8)
    reach = np.ceil(_HIDDEN * lines.width).astype(int)
    column, row = np.rint(lines.pixels).astype(int)
    for first, last, line in zip(column - reach, column + reach + 1, row):
        hidden[line, max(first, 0) : last] = 1
    seen = 1.0 - hidden
    window = (_WINDOW, _WINDOW)
    share = np.maximum(cv2.blur(seen, window), 1e-9)
    mean = cv2.blur(image * seen, window) / share
    masked = image.astype(np.float32)
    place = np.arange(image.shape[1])
    for line in np.flatnonzero(hidden.any(1) & ~hidden.all(1)):
        is_hidden = hidden[line] > 0
        masked[line, is_hidden] = np.interp(
            place[is_hidden], place[~is_hidden], mean[line, ~is_hidden]
        )
    return masked


def ambient_bias(
    images: Sequence[np.ndarray],
    pixels: np.ndarray,
    shape: np.ndarray,
    is_across_columns: bool,
) -> np.ndarray:
    """(n,) px along the scan line by which the slope of the scene's light pulls centres at pixels (2, n).

    images: (H, W) each, the `chosen_images` as of `scene_of`; shape (3, n): width px, `Stripes.shape` and peak of the
    lines.
    is_across_columns: whether centres are sought along the rows of an image. 0 without images.
    """
    if not len(images) or not pixels.shape[1]:
        return np.zeros(pixels.shape[1])
    column, row = np.rint(pixels).astype(int)
    left_column = max(column.min() - _MARGIN, 0)
    top = max(row.min() - _MARGIN, 0)
    seen = slice(top, row.max() + _MARGIN + 1), slice(left_column, column.max() + _MARGIN + 1)
    shown = np.stack([image[seen] for image in images])
    rank = int(_QUARTILE * len(images))
    has_few_images = len(images) < _FEWEST_IMAGES
    scene = shown.mean(0) if has_few_images else np.partition(shown, rank, axis=0)[rank]
    slope = _slope(scene.astype(np.float32), 1 if is_across_columns else 0)
    height, width = scene.shape
    local_slope = slope[
        np.clip(row - top, 0, height - 1), np.clip(column - left_column, 0, width - 1)
    ]
    change = np.clip(local_slope * shape[0] / np.maximum(shape[2], 1e-6), -_STEEPEST, _STEEPEST)
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


__all__ = ["Lines", "chosen_images", "scene_of", "ambient_bias"]
