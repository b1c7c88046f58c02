"""Rows of pixels, a block of images at a time: windows out of them, and the brightest place of each."""

from dataclasses import dataclass

import cv2
import numpy as np

SEGMENT = 64
"""px a row is searched in pieces of about so many: the largest pixel of a piece costs next to nothing."""


_EXPOSURE = 1 / 512
"""Steps of a background's exposure where lines are searched: less than the rounding of 8 bits. Fits take it exactly."""
_KEPT = 8
"""Exposures of a background that are kept."""


@dataclass(frozen=True)
class Rows:
    """Rows (n, width) of one or several images of `height` rows each, one under the other.

    `background` (n or height, width): what to subtract, times `scale` (images,); None for nothing.
    `region` (height, width) bool: where to search; None for everywhere.
    """

    pixels: np.ndarray
    height: int
    background: np.ndarray | None = None
    scale: np.ndarray | None = None
    region: np.ndarray | None = None

    @property
    def width(self) -> int:
        return self.pixels.shape[1]

    def windows(
        self, row: np.ndarray, start: np.ndarray, size: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, size) of rows (n,) from column start (n,), as recorded and, as float32, less what is under."""
        raw = _cut(self.pixels, row * self.width + start, size)
        net = raw.astype(np.float32)
        if self.background is not None:
            net -= self.ambient_windows(row, start, size)
        return raw, net

    def ambient(self, row: np.ndarray, column: np.ndarray) -> np.ndarray | float:
        """(n,) grey values that are subtracted at rows (n,) and columns (n,); 0 where there are none."""
        if self.background is None:
            return 0.0
        return self.ambient_windows(row, column, 1)[:, 0]

    def ambient_windows(self, row: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
        """(n, size) grey values that are subtracted in windows as `windows` cuts them."""
        background = self.under_windows(row, start, size)
        return background * self.scale[row // self.height, None]

    def under_windows(self, row: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
        """(n, size) pixels of the background image in the windows that `windows` cuts, as recorded."""
        return _cut(self.background, row % len(self.background) * self.width + start, size)

    def searched(self, exposures: dict | None = None) -> np.ndarray:
        """(n, width) where the line is searched: less what is under, its least value outside the region.

        kept: what is under at some exposures, for further rows of the same background.
        """
        if self.background is None and self.region is None:
            return self.pixels
        searched = np.empty_like(self.pixels)
        exposures = {} if exposures is None else exposures
        for k in range(len(self.pixels) // self.height):
            place = slice(k * self.height, (k + 1) * self.height)
            if self.background is None:
                searched[place] = self.pixels[place]
            else:
                cv2.subtract(self.pixels[place], self._exposed(k, exposures), dst=searched[place])
            if self.region is not None:
                searched[place] = np.where(self.region, searched[place], floor(searched[place]))
        return searched

    def _exposed(self, image: int, exposures: dict) -> np.ndarray:
        """(height, width) what is under an image at its exposure, to a half of `_EXPOSURE`."""
        scale = float(self.scale[image])
        steps = round(float(self.scale[image]) / _EXPOSURE)
        if len(self.background) > self.height:
            background = self.background[image * self.height :][: self.height]
            is_same_exposure = abs(scale - 1) < _EXPOSURE / 2
            return (
                background
                if is_same_exposure
                else cv2.addWeighted(background, scale, background, 0, 0)
            )
        if steps * _EXPOSURE == 1:
            return self.background
        exposed = exposures.get(steps)
        if exposed is None:
            exposed = cv2.addWeighted(self.background, steps * _EXPOSURE, self.background, 0, 0)
            exposures.update({steps: exposed} if len(exposures) < _KEPT else {})
        return exposed


def _cut(pixels, first, size):
    """(n, size) stretches of the flat array; each is copied as one element of `size` pixels, which is fast."""
    flat = pixels.reshape(-1)
    step = flat.itemsize
    pieces = np.ndarray((flat.size - size + 1,), f"V{size * step}", flat, strides=(step,))
    return pieces[first].view(flat.dtype).reshape(-1, size)


@dataclass(frozen=True)
class Brightest:
    """Largest pixel of each row of `image` (n, w): `column` (n,), `value` (n,); and of each of its `pieces` (p, n)."""

    image: np.ndarray
    pieces: np.ndarray
    column: np.ndarray
    value: np.ndarray

    @property
    def piece(self) -> int:
        """px, how long a piece is."""
        return self.image.shape[1] // len(self.pieces)


def brightest(image: np.ndarray) -> Brightest:
    """The largest pixel of every row of (n, width)."""
    image = _divisible(image)
    width = image.shape[1]
    length = _piece(width)
    largest = cv2.reduce(image.reshape(-1, length), 1, cv2.REDUCE_MAX)
    # whole columns are compared ten times as fast as the few numbers of each row
    pieces = cv2.transpose(largest.reshape(-1, width // length))
    piece, value = _argmax(pieces.T)
    rows = np.arange(0, pieces.size, len(pieces)) + piece
    column = _place(image.reshape(-1, length).take(rows, 0), value) + piece * length
    return Brightest(image, pieces, column, value)


def _argmax(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`table.argmax(1)` and `table.max(1)` of (n, w <= 256); bytes are packed with their place, four times as fast."""
    if table.dtype != np.uint8:
        place = table.argmax(1)
        return place, np.take_along_axis(table, place[:, None], 1)[:, 0]
    packed = table.astype(np.uint16)
    packed <<= 8
    packed |= np.arange(table.shape[1] - 1, -1, -1, dtype=np.uint16)
    largest = packed.max(1)
    return table.shape[1] - 1 - (largest & 255).astype(np.intp), (largest >> 8).astype(np.uint8)


def _place(table: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(n,) first place in rows of (n, w) that has the row's largest value (n,).

    64 places are the bits of one number: all but the leading one of each run are cleared, so that
    a conversion to double precision does not round up, and its exponent tells the leading bit.
    """
    if table.shape[1] != 64:
        return table.argmax(1) if table.dtype != np.uint8 else _argmax(table)[0]
    bits = np.packbits((table == value[:, None]).reshape(-1)).view(">u8").astype(np.uint64)
    bits &= ~(bits >> np.uint64(1))
    return 63 + 1023 - (bits.astype(np.float64).view(np.int64) >> 52)


def floor(table: np.ndarray):
    """A value that no pixel of `table` is below, of its type."""
    return table.dtype.type(0) if table.dtype.kind == "u" else table.min(initial=0)


def row_max(table: np.ndarray) -> np.ndarray:
    """(n,) largest of each row of (n, w)."""
    return (
        cv2.reduce(table, 1, cv2.REDUCE_MAX)[:, 0]
        if table.size
        else np.zeros(len(table), table.dtype)
    )


def spikes(image: np.ndarray, row: np.ndarray, column: np.ndarray, noise: float) -> np.ndarray:
    """(n,) whether the pixel stands alone, both its neighbours under 0.15 of its height: hot, and no line.

    A row's first and last pixel are never said to: there the image cuts a line.
    """
    first = row * image.shape[1]
    width = image.shape[1]
    three = _cut(image, first + np.clip(column - 1, 0, width - 3), 3)
    neighbour = np.maximum(three[:, 0], three[:, 2])
    top = three[:, 1].astype(np.float32)
    alone = np.flatnonzero(top - neighbour > 8 * noise)
    pixels = _cut(image, first[alone] + np.clip(column[alone] - 4, 0, width - 9), 9)
    base = np.median(pixels, axis=1)
    is_spike = np.zeros(len(row), bool)
    is_spike[alone] = neighbour[alone] - base < 0.15 * (top[alone] - base)
    return is_spike


def without_spikes(
    image: np.ndarray, row: np.ndarray, column: np.ndarray, noise: float
) -> np.ndarray:
    """(n,) columns, those on a hot pixel replaced by the next largest pixel of their row that is none."""
    column, spiked = column.copy(), np.flatnonzero(spikes(image, row, column, noise))
    spiked_rows = image[row[spiked]]
    while len(spiked):
        spiked_rows[np.arange(len(spiked_rows)), column[spiked]] = floor(spiked_rows)
        column[spiked] = spiked_rows.argmax(1)
        is_spiked = spikes(spiked_rows, np.arange(len(spiked_rows)), column[spiked], noise)
        spiked, spiked_rows = spiked[is_spiked], spiked_rows[is_spiked]
    return column


def _piece(width: int) -> int | None:
    """The divisor of `width` that is nearest to `SEGMENT`, None where there is none."""
    fit = [k for k in range(SEGMENT // 2, 2 * SEGMENT + 1) if width % k == 0]
    return min(fit, key=lambda k: abs(k - SEGMENT)) if fit else None


def _divisible(image):
    if _piece(image.shape[1]):
        return np.ascontiguousarray(image)
    padding = -image.shape[1] % SEGMENT
    return np.ascontiguousarray(np.pad(image, ((0, 0), (0, padding)), constant_values=image.min()))


def without_hot(image: np.ndarray) -> np.ndarray:
    """(n, w) every pixel cut to the larger of its two neighbours."""
    neighbour = np.maximum(image[:, 2:], image[:, :-2])
    return np.pad(np.minimum(image[:, 1:-1], neighbour), ((0, 0), (1, 1)), mode="edge")


def lines_enhanced(image: np.ndarray, width: float) -> np.ndarray:
    """(n, w) float32: the mean over a stretch as long as the line is wide, less the mean of its surroundings.

    2.8 Gaussian widths is the stretch with the largest ratio of a Gaussian's mean to its noise.
    """
    inner_size = 2 * int(round(1.4 * width - 0.5)) + 1
    outer_size = 3 * inner_size + 4
    image = image.astype(np.float32, copy=False)
    inner = cv2.blur(image, (inner_size, 1))
    outer = cv2.blur(image, (outer_size, 1))
    inner -= outer
    inner *= outer_size / (outer_size - inner_size)
    return inner
