"""Lines that stay at one place of the image: a scratch or a reflection that was taken for the laser's line.

A light plane and a pixel have one depth. Centres of one step at one pixel, on boards at different depths, are therefore
not of the laser. A plane through the camera's centre fits such centres perfectly, so that no residual shows them; it
triangulates nothing.
"""

from dataclasses import dataclass

import numpy as np

_MOST_PX = 2.0  # by which centres of one cell of the image may be apart
_LEAST_BASE = (
    0.05  # distance of light plane and camera over depth, below which a scanner measures nothing
)
_FEWEST = 20  # centres
_FEWEST_IMAGES = 3
_NEAR_PX = 1.5  # from the line, of centres that make it
_WIDTH_PX = 3.0  # from the line, of centres that it may have displaced
_GAP_PX = 5.0  # along the line, up to which its centres follow one another
_ROUNDING_PX = 1e-6  # the same place, computed twice
_SHARE = 0.3  # of the centres that contradict each other, on one line: a wrong step contradicts everywhere
_MAX_LINES = 5  # lines
_TRIALS = 200


@dataclass(frozen=True)
class Centres:
    """Centres (2, n) px on boards: `pixels`, `scan` (2,) in which they were measured, `step` (n,), `image` (n,) label
    of the image, and `depth` (n,) mm of the board there, by its corners alone."""

    pixels: np.ndarray
    scan: np.ndarray
    step: np.ndarray
    image: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class StationaryLine:
    """A line of the image between `ends` (2, 2) px, with `centres` on it in `images` images."""

    ends: np.ndarray
    centres: int
    images: int

    @property
    def sentence(self) -> str:
        """State what was found, why it matters, what to do."""
        (u0, v0), (u1, v1) = np.rint(self.ends.T).astype(int)
        return (
            f"{self.centres} stripe centres in {self.images} images lie on one line of the image, from ({u0}, {v0}) to "
            f"({u1}, {v1}) px, although the boards stood at different depths: a scratch, a reflection or stray light "
            "that was taken for the laser line. They were left out here, but scans show the same line: clean optics "
            "and mirror, or shield the light, and take the images again"
        )


def find_stationary_lines(
    centres: Centres, focal: float
) -> tuple[tuple[StationaryLine, ...], np.ndarray]:
    """Lines that stay in the image, and (n,) bool which centres lie next to one of them.

    focal: of the camera, px.
    """
    displaced = np.zeros(len(centres.step), bool)
    open_ = contradicting(centres, focal)
    lines = []
    while len(lines) < _MAX_LINES and open_.sum() >= _FEWEST:
        line = _line(centres.pixels[:, open_])
        is_inlier = open_ & (_distance(line, centres.pixels) < _NEAR_PX)
        images = len(np.unique(centres.image[is_inlier]))
        is_line = is_inlier.sum() >= max(_FEWEST, _SHARE * open_.sum()) and images >= _FEWEST_IMAGES
        if not is_line:
            break
        is_on_line = _distance(line, centres.pixels) < _NEAR_PX
        ends = _ends(line, centres.pixels[:, is_inlier], centres.pixels[:, is_on_line])
        lines.append(StationaryLine(ends, int(is_inlier.sum()), images))
        is_within_width = _distance(line, centres.pixels) < _WIDTH_PX
        displaced |= is_within_width & _is_between(ends, centres.pixels)
        open_ &= ~(displaced | is_inlier)
    return tuple(lines), displaced


def contradicting(centres: Centres, focal: float) -> np.ndarray:
    """(n,) bool: another centre of the same step is at the same pixel, on a board at another depth."""
    stripe_place = _numbered(np.rint((centres.pixels[::-1] * centres.scan[:, None]).sum(0)))
    scan_place = (centres.pixels * centres.scan[:, None]).sum(0)
    place = _numbered(centres.step) * (stripe_place.max(initial=0) + 1) + stripe_place
    height = np.log(centres.depth)
    found = np.zeros(len(height), bool)
    for shift in (0.0, 0.5):
        column = _numbered(np.floor(scan_place + shift))
        cell = _numbered(place * (column.max(initial=0) + 1) + column)
        low = np.full(len(height), np.inf)
        high = np.full(len(height), -np.inf)
        np.minimum.at(low, cell, height)
        np.maximum.at(high, cell, height)
        found |= (high - low)[cell] > _MOST_PX / (_LEAST_BASE * focal)
    return found


def _numbered(values: np.ndarray) -> np.ndarray:
    """(n,) int from 0, equal where values (n,) are equal."""
    return np.unique(values, return_inverse=True)[1].ravel()


def _line(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point and unit direction (2,) of the line through most of pixels (2, n)."""
    from skimage.measure import LineModelND, ransac

    _, inliers = ransac(
        pixels.T, LineModelND, 2, residual_threshold=_NEAR_PX, max_trials=_TRIALS, rng=0
    )
    line_pixels = pixels[:, inliers] if inliers is not None and inliers.sum() > 1 else pixels
    middle = line_pixels.mean(1)
    return middle, np.linalg.svd(line_pixels - middle[:, None], full_matrices=False)[0][:, 0]


def _distance(line, pixels) -> np.ndarray:
    """(n,) px of pixels (2, n) from a line."""
    middle, direction = line
    normal = np.array([-direction[1], direction[0]])
    return np.abs(normal @ (pixels - middle[:, None]))


def _ends(line, pixels, dense_pixels) -> np.ndarray:
    """(2, 2) px, one end a column, of the part of a line that pixels (2, n) cover, `dense_pixels` (2, m) without a
    gap.
    """
    middle, direction = line
    place = direction @ (pixels - middle[:, None])
    first = place.min()
    last = place.max()
    covered = np.sort(direction @ (dense_pixels - middle[:, None]))
    gaps = np.flatnonzero(np.diff(covered) > _GAP_PX)
    starts = covered[np.append(0, gaps + 1)]
    stops = covered[np.append(gaps, len(covered) - 1)]
    first = starts[starts <= first + _ROUNDING_PX].max(initial=-np.inf)
    last = stops[stops >= last - _ROUNDING_PX].min(initial=np.inf)
    return middle[:, None] + np.outer(direction, [first, last])


def _is_between(ends: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(n,) whether pixels (2, n) lie between the ends of a line, or at most `_WIDTH_PX` beyond."""
    way = ends[:, 1] - ends[:, 0]
    length = np.hypot(*way)
    place = (way / length) @ (pixels - ends[:, :1])
    return (place > -_WIDTH_PX) & (place < length + _WIDTH_PX)
