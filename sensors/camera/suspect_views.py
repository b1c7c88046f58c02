"""Suspect images and corners of a camera, and the case in which the lens model is suspect instead.

Judged before the camera is known: a image of a board is smooth across the board, whatever the
lens. Judged after: a corner that is off unlike its neighbours is a blunder; what many boards are off
by smoothly is the lens's, and its corners stay.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera.corners import Corners
from sensors.camera.start import spread
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.rigid import rotation_matrix

if TYPE_CHECKING:
    from sensors.boards.detection import View

BLUNDER_RATIO = 6.0
"""A corner is a blunder where it is more than this many times as far off as half of all corners are, about 7 sigmas."""
_FLAT = 1e-3  # of the board's extent along its corners: they lie on a line where across they extend less
_MIN_MEDIAN_SIGMA = 0.05
_MIN_REDUNDANCY = 3  # corners more than a warp has numbers: fewer are no test of it
_ORDER = 5
_NEIGHBOURS = 40  # corners of a board pose below which a warp of that order across the board would follow single ones
_MANY = 3  # board poses that are off smoothly from which on the lens is the cause


def is_collinear(views: Sequence["View"], board) -> np.ndarray:
    """(V,) True for views whose corners lie on one line of the board."""
    count = np.array([len(view.index) for view in views])
    of_view = np.repeat(np.arange(len(views)), count)
    corners = np.concatenate([view.index for view in views])
    places = board.points[:2, corners]

    def sums(values):
        return np.bincount(of_view, values, len(views))

    middle = np.stack([sums(row) for row in places]) / np.maximum(count, 1)
    x, y = places - middle[:, of_view]
    xx = sums(x * x)
    yy = sums(y * y)
    xy = sums(x * y)
    # the product of the variances along and across the corners, over the square of the larger one, which is the first
    product = xx * yy - xy * xy
    return product < _FLAT**2 * (xx + yy) ** 2


def repeated_views(views: Sequence["View"]) -> list[int | None]:
    """Of each view the number of an earlier one with the very same corners, None where there is none."""
    first: dict[tuple, int] = {}
    keys = [(np.asarray(view.index).tobytes(), np.asarray(view.pixels).tobytes()) for view in views]
    return [None if first.setdefault(key, k) == k else first[key] for k, key in enumerate(keys)]


def smoothness_misfit(chain: Corners) -> np.ndarray:
    """(G,) RMS that a quadratic warp of the board leaves of some corners, over the extent of its image.

    Of a board through any lens hardly anything, of corners in a wrong order most of it. inf where
    there are too few corners to decide.
    """
    chosen, new = spread(chain)
    is_used = new[..., None]
    x, y = chain.place[:, chosen]
    rows = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1) * is_used
    seen = np.moveaxis(chain.pixels[:, chosen], 0, -1) * is_used
    residual = seen - rows @ (np.linalg.pinv(rows) @ seen)
    count = new.sum(1)
    middle = seen.sum(1) / count[:, None]
    extent = ((seen - middle[:, None] * is_used) ** 2).sum((1, 2))
    share = np.sqrt((residual**2).sum((1, 2)) / np.maximum(extent, 1e-300))
    # residuals are smaller than errors: the warp has numbers of its own
    spare = count - rows.shape[-1]
    error = share * np.sqrt(count / np.maximum(spare, 1))
    return np.where(spare < _MIN_REDUNDANCY, np.inf, error)


def is_behind_board(poses: np.ndarray) -> np.ndarray:
    """(G,) True where the board shows another side than in most images: corners numbered in mirror image."""
    side = (rotation_matrix(poses[:, 3:])[:, :, 2] * poses[:, :3]).sum(1) > 0
    return side != (2 * side.sum() > len(side))


def find_blunders(chain: Corners, residual: np.ndarray) -> np.ndarray:
    """(n,) True for corners that are far off and unlike their neighbours, and for most of a image that contradicts.

    What a lens does that is not of the model fitted is smooth across each board, and many boards show
    it: it is no blunder. Images that are off as a whole, and few of them, are.
    """
    is_blunder = _far_off(residual / chain.sigma)
    if not is_blunder.any():
        return is_blunder
    group = chain.labels["placement"]
    count = np.bincount(group)
    rough = _far_off(_rough(chain, residual) / chain.sigma) | (count < _NEIGHBOURS)[group]
    smooth = np.bincount(group, is_blunder & ~rough) > 0
    is_whole_view = (np.bincount(group, is_blunder) > count / 2) & (smooth.sum() < _MANY)
    return is_blunder & (rough | is_whole_view[group])


def _far_off(scaled):
    """(n,) True beyond the bound; what is well within its stated sigma is none, however good the others are."""
    distance = np.sqrt((scaled**2).sum(0))
    return distance > BLUNDER_RATIO * max(np.median(distance), _MIN_MEDIAN_SIGMA)


def _rough(chain, residual):
    """(2, n) residuals less a smooth warp across the board of each pose."""
    x, y = chain.place
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    rows = np.stack([x**i * y**j for i, j in powers])
    # corners of one pose stand together: one sum a pose, from each start to the next
    start = np.flatnonzero(np.diff(chain.labels["placement"], prepend=-1))
    count = np.diff(start, append=residual.shape[1])
    gram = np.add.reduceat(rows[:, None] * rows, start, axis=2).transpose(2, 0, 1)
    right = np.add.reduceat(rows[:, None] * residual, start, axis=2).transpose(2, 0, 1)
    small = 1e-9 * len(rows) * np.eye(len(rows))
    warp = solve_positive(gram + small, right)
    of_corner = np.repeat(np.arange(len(start)), count)
    return residual - np.einsum("kn,nkc->cn", rows, warp[of_corner])
