"""From which grey value on a pixel is clipped: the number type does not say it, because 10 to 14 bits come in 16."""

from dataclasses import dataclass

import numpy as np

_DEPTHS = (10, 12, 14, 16)
_PILE, _MIN_COUNT = 3.0, 20
"""A line's height that is cut off piles up in one grey value. Without that the highest value of a line has at most 1.5
times the pixels of another near it: rounding makes at most three pixels flat where two are at every value below, and a
parabola has 1.4 times as many within half a step of its top as in the next step; noise makes it less. `_MIN_COUNT`:
pixels that are more than chance, where there are as many values as pixels."""
_HIGH = 0.25
"""Part of the images' range, from its upper end, whose values are compared."""
_COARSE = 16
"""Grey values of range below which a quarter of it says nothing."""
_LINES = 1024
"""Rows of a stack from which it is judged."""


@dataclass(frozen=True)
class Counts:
    """Range of the counts of 16-bit images: their `largest` count and the bits that occur in any (`used`)."""

    largest: int = 0
    used: int = 0

    @classmethod
    def of(cls, images: np.ndarray) -> "Counts":
        """Of whole numbers of any shape."""
        return cls(int(images.max(initial=0)), int(np.bitwise_or.reduce(images, axis=None)))

    def __or__(self, other: "Counts") -> "Counts":
        return Counts(max(self.largest, other.largest), self.used | other.used)

    @property
    def step(self) -> int:
        """Between grey values: 16 where 12 bits stand in the upper part of 16."""
        return self.used & -self.used or 1

    @property
    def full(self) -> int:
        """The end of the 10, 12, 14 or 16 bits that they fill, or of those that stand in the upper part of 16."""
        if self.largest >> 15:
            return 2**16 - self.step
        return next(2**bits - 1 for bits in _DEPTHS if self.largest < 2**bits)


def clip_level(
    stack: np.ndarray, saturation: float | None = None, scan_dimension: int = 2
) -> float:
    """Grey value from which pixels of images (F, H, W) count as clipped.

    saturation: full scale where it is known; None takes it from the images. Below that it is
    their largest value where values pile up there. scan_dimension: the axis along which lines are searched.
    """
    if stack.dtype == np.uint8:
        full = 255
    elif stack.dtype.kind == "u":
        full = Counts.of(stack).full if saturation is None else saturation
    else:
        full = np.inf
    level = float(full if saturation is None else saturation)
    lines = _some_lines(stack, scan_dimension)
    largest = lines.max()
    # only where values pile up in some lines it has to be known whether others have larger ones
    if largest < level and _piles_up(lines, largest) and stack.max() == largest:
        return float(largest)
    return level


def _some_lines(stack: np.ndarray, scan_dimension: int) -> np.ndarray:
    """(F, n, w) every so-manieth line of all images."""
    lines = np.moveaxis(stack, scan_dimension, 2)
    return np.ascontiguousarray(lines[:, :: max(1, lines.shape[0] * lines.shape[1] // _LINES)])


def _piles_up(lines: np.ndarray, largest) -> bool:
    """Whether far more pixels have the largest value than have any other one near it."""
    step = Counts.of(lines).step if lines.dtype.kind == "u" else 1
    span = float(largest) - float(np.median(lines[:, ::4, ::4]))
    if not span >= _COARSE * step or np.count_nonzero(lines == largest) < _MIN_COUNT:
        return False
    count = _counts(lines, float(largest) - _HIGH * span, largest)
    return bool(count[-1] >= _MIN_COUNT and count[-1] > _PILE * max(count[:-1], default=0))


def _counts(lines: np.ndarray, low: float, largest) -> np.ndarray:
    """Number of pixels with each value above `low`; the last is that of `largest`."""
    import cv2

    if lines.dtype.kind == "u":
        ends = [int(low) + 1, int(largest) + 1]
        return cv2.calcHist([lines.reshape(len(lines), -1)], [0], None, [ends[1] - ends[0]], ends)[
            :, 0
        ]
    high = lines[lines > low]
    return np.append(
        np.unique(high[high < largest], return_counts=True)[1], np.count_nonzero(high == largest)
    )
