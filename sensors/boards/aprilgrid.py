"""Finder of Kalibr's AprilGrid: AprilTags of family 36h11 in rows, with small dark squares between their corners.

Tag 0 is at the bottom left, and the numbers go to the right, then up. The four corners of each tag are saddle points
of the image, because a dark square of the gap meets each of them. Kalibr prints tags with a border of two modules,
other programs with one; both are looked for.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from sensors.boards.homography import project

DICTIONARY = "DICT_APRILTAG_36h11"
NARROWEST_BORDER = 1 / 8
"""Share of a tag's side that its dark border takes at least: one module of eight."""
_BORDERS = (2, 1)
_FEWEST_TAGS = 2
_FLAT = 0.1
"""RMS distance from a homography, in sides of a tag, that the distortion of a lens leaves at most."""
_WIDEST = 24


@dataclass(frozen=True)
class Tags:
    """Numbers (t,) of the tags that are seen, and their corners (t, 4, 2) px, clockwise in the image."""

    numbers: np.ndarray
    corners: np.ndarray


def tags_in(image: np.ndarray) -> Tags:
    """The tags of an image (H, W) uint8, in the border in which most are found."""
    found = [_detected(image, bits) for bits in _BORDERS]
    return max(found, key=lambda tags: len(tags.numbers))


def corner_indices(numbers: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """(t, 4) index of the corners top left, top right, bottom right, bottom left of tags in the grid of corners.

    columns, rows: of tags. The grid has 2 columns corners in each of 2 rows rows, from the top left corner.
    """
    up, column_of_tag = np.divmod(numbers, columns)
    down = rows - 1 - up
    row = 2 * down[:, None] + np.array([0, 0, 1, 1])
    column = 2 * column_of_tag[:, None] + np.array([0, 1, 1, 0])
    return row * 2 * columns + column


def ordered_corners(tags: Tags, points: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, float]:
    """Corners (t, 4, 2) px in the order of `index` (t, 4), and their RMS distance from a homography in mm.

    points: (2, N) mm of the grid. A detector starts each tag at the same corner of its code; which one that is on the
    board follows from how the tags lie to one another.
    """
    rotated = [np.roll(tags.corners, shift, axis=1) for shift in range(4)]
    misfits = [_misfit(points[:, index.ravel()], corners.reshape(-1, 2).T) for corners in rotated]
    best = int(np.argmin(misfits))
    return rotated[best], misfits[best]


def other_columns(tags: Tags, marker: float, pitch: float, rows: int) -> int | None:
    """The number of columns of tags that explains how the tags lie; None where none does."""
    misfits = {}
    for columns in range(2, _WIDEST + 1):
        needed = max(rows, int(tags.numbers.max()) // columns + 1)
        points = grid_points(columns, needed, marker, pitch)
        index = corner_indices(tags.numbers, columns, needed)
        misfits[columns] = ordered_corners(tags, points, index)[1]
    best = min(misfits, key=misfits.get)
    return best if misfits[best] <= _FLAT * marker else None


def is_flat(misfit_mm: float, marker: float) -> bool:
    """Whether corners lie as those of a flat board."""
    return misfit_mm <= _FLAT * marker


def grid_points(columns: int, rows: int, marker: float, pitch: float) -> np.ndarray:
    """(2, N) mm of the corners of columns x rows tags, row after row from the top left, y down."""
    horizontal = _edges(columns, marker, pitch)
    down = _edges(rows, marker, pitch)
    return np.stack([np.tile(horizontal, len(down)), np.repeat(down, len(horizontal))])


def _edges(count: int, marker: float, pitch: float) -> np.ndarray:
    """(2 count,) mm of both edges of each tag in a row or column of tags."""
    first_edge = pitch * np.arange(count)[:, None]
    return (first_edge + np.array([0.0, marker])).ravel()


def is_enough(tags: Tags) -> bool:
    """Whether so many tags are seen, each once, that their order on the board shows."""
    return len(tags.numbers) >= _FEWEST_TAGS and len(set(tags.numbers)) == len(tags.numbers)


def _detected(image: np.ndarray, bits: int) -> Tags:
    corners, numbers, _ = _detector(bits).detectMarkers(image)
    if numbers is None or len(numbers) == 0:
        return Tags(np.zeros(0, int), np.zeros((0, 4, 2)))
    return Tags(numbers.ravel().astype(int), np.array(corners, float).reshape(-1, 4, 2))


@cache
def _detector(bits: int):
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = bits
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _misfit(points: np.ndarray, pixels: np.ndarray) -> float:
    """RMS mm by which points (2, k) differ from a homography of pixels (2, k); inf where there is none."""
    import cv2

    matrix, _ = cv2.findHomography(pixels.T, points.T, 0)
    if matrix is None:
        return np.inf
    return _rms_distance(project(matrix, pixels), points)


def _rms_distance(points: np.ndarray, others: np.ndarray) -> float:
    """RMS distance of points (2, k) from others (2, k)."""
    squares = np.sum((points - others) ** 2, axis=0)
    return float(np.sqrt(np.mean(squares)))
