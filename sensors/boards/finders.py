"""Finders of whole or partly visible boards in 8-bit images, each with its reason where it finds none."""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from sensors.boards import aprilgrid, circles
from sensors.boards.homography import project
from sensors.boards.patches import STEPS, Fit, fit_saddles

if TYPE_CHECKING:
    from sensors.boards.board import Board

LARGE = 1600
"""px: images are made this small to look for corners; their places are refined in the image itself."""
SMALL = 900
"""px: as above, where only the size of a board that was not found is looked for."""
CONTINUES = 0.8
"""Share of a side along which the grid goes on, beyond which the board is larger than said."""
_FEW_STEPS = 12
"""From a start within a fifth of a square, corners are found to a few hundredths of a pixel in so many."""


@dataclass(frozen=True)
class Found:
    """Corners `index` (k,) at about `pixels` (2, k), or `why` not and the `size` that would fit.

    `discs` (6, k): candidates of `circles.candidates` behind the pixels.
    """

    index: np.ndarray | None = None
    pixels: np.ndarray | None = None
    why: str = ""
    size: tuple[int, int] | None = None
    discs: np.ndarray | None = None


def find(image: np.ndarray, board: "Board") -> Found:
    """The board in a image (H, W) uint8."""
    finders = {"chessboard": _chessboard, "charuco": _charuco, "aprilgrid": _aprilgrid}
    return finders.get(board.kind, _circles)(image, board)


def refine(image: np.ndarray, board: "Board", found: Found) -> tuple[np.ndarray, Fit, float]:
    """Index (k,), fitted places in the image (H, W) float, and the discs' radius in mm (0 for corners)."""
    points = board.points[:2, found.index]
    if found.discs is not None:
        fit = circles.refine(image, found.discs)
        has_homography = fit.good.sum() >= 4
        return found.index, fit, circles.radius_mm(fit, points) if has_homography else 0.0
    step, rim = _saddle_size(board)
    row_step, down = _steps(points, found.pixels, step)
    return found.index, fit_saddles(image, found.pixels, row_step, down, rim), 0.0


def _saddle_size(board: "Board") -> tuple[float, float]:
    """Size (mm) of the squares that meet in a corner, and the share of them next to the edges that is plain."""
    if board.kind == "aprilgrid":  # a dark square in the gap, against the border of the tag
        step = 2 * (board.square_mm - board.marker_mm)
        return step, aprilgrid.NARROWEST_BORDER * board.marker_mm / step
    if board.kind == "charuco":
        return board.square_mm, (1 - board.marker_mm / board.square_mm) / 2
    return board.square_mm, 1.0


def _steps(points: np.ndarray, pixels: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """(2, k) px from each corner to its next one along x and along y, by the homography through all of them."""
    import cv2

    h = cv2.findHomography(points.T, pixels.T, 0)[0]
    shift = step / 2 * np.eye(2)[:, :, None]
    return tuple(project(h, points + s) - project(h, points - s) for s in shift)


# Chessboards


def _chessboard(image: np.ndarray, board: "Board") -> Found:
    corners = _inner_corners(image, board.columns, board.rows)
    if corners is None:
        return _another_chessboard(image, board)
    grid = _upright(
        corners.reshape(board.rows, board.columns, 2), _chess_rotations(image, corners, board)
    )
    larger = _larger_chessboard(image, grid)
    if larger != (board.columns, board.rows):
        return Found(why=_other(board, larger), size=larger)
    if _second_chessboard(image, grid):
        return Found(why=_two(board))
    return Found(np.arange(board.count), grid.reshape(-1, 2).T)


def _second_chessboard(image: np.ndarray, grid: np.ndarray) -> bool:
    """Whether there is another one of that size, once the first is painted over with a square around it."""
    import cv2

    rows, columns = grid.shape[:2]
    small, scale = _shrunk(image, SMALL)
    corners = (grid.reshape(-1, 2) + 0.5) / scale - 0.5
    middle = corners.mean(0)
    wider = 1 + 3 / (min(rows, columns) - 1)
    hull = cv2.convexHull(np.rint(middle + wider * (corners - middle)).astype(np.int32))
    painted_over = cv2.fillConvexPoly(small.copy(), hull, int(np.median(small)))
    # the quick look answers no in a hundredth of the time that the search takes
    return bool(
        cv2.checkChessboard(painted_over, (columns, rows))
        and cv2.findChessboardCornersSB(painted_over, (columns, rows))[0]
    )


def _inner_corners(image: np.ndarray, columns: int, rows: int) -> np.ndarray | None:
    """(N, 2) px by the sector-based finder (Duda and Frese, BMVC 2018), else by OpenCV's older one."""
    import cv2

    small, scale = _shrunk(image, LARGE)
    for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE):
        is_found, corners = cv2.findChessboardCornersSB(small, (columns, rows), flags=flags)
        if is_found:
            return (corners.reshape(-1, 2).astype(float) + 0.5) * scale - 0.5
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    is_found, corners = cv2.findChessboardCorners(small, (columns, rows), flags=flags)
    if not is_found:
        return None
    window = _window(corners.reshape(rows, columns, 2))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    corners = cv2.cornerSubPix(small, corners, (window, window), (-1, -1), stop)
    return (corners.reshape(-1, 2).astype(float) + 0.5) * scale - 0.5


def _window(grid: np.ndarray) -> int:
    """Half the side of OpenCV's search window: 40 % of the shortest distance between corners."""
    steps = [np.hypot(*np.moveaxis(np.diff(grid, axis=k), 2, 0)).min() for k in (0, 1)]
    return int(np.clip(0.4 * min(steps), 2, 11))


def _shrunk(image: np.ndarray, longest: int) -> tuple[np.ndarray, float]:
    """The image made smaller by a whole number, and that number."""
    import cv2

    scale = max(1, int(np.ceil(max(image.shape) / longest)))
    if scale == 1:
        return image, 1.0
    height, width = (side // scale for side in image.shape)
    return cv2.resize(
        image[: height * scale, : width * scale], (width, height), interpolation=cv2.INTER_AREA
    ), scale


def _chess_rotations(image: np.ndarray, corners: np.ndarray, board: "Board") -> list[int]:
    """Rotations by 90 deg after which the square between corners 0, 1, columns and columns + 1 is dark."""
    rotations = (0, 1, 2, 3) if board.columns == board.rows else (0, 2)
    grid = _right_handed(corners.reshape(board.rows, board.columns, 2))
    dark = [k for k in rotations if _first_is_dark(image, np.rot90(grid, k))]
    return dark or list(rotations)


def _first_is_dark(image: np.ndarray, grid: np.ndarray) -> bool:
    """Whether squares of the first one's colour are the darker ones.

    All squares of one colour are compared with all of the other, so that a reflection on one square decides nothing.
    """
    upper = grid[:-1]
    lower = grid[1:]
    middle = (upper[:, :-1] + lower[:, :-1] + upper[:, 1:] + lower[:, 1:]) / 4
    u, v = np.rint(middle).astype(int).reshape(-1, 2).T
    height, width = image.shape
    clipped_places = np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)
    grey = image[clipped_places].astype(float)
    row, column = np.indices(middle.shape[:2])
    same_colour = (row + column).ravel() % 2 == 0
    return np.median(grey[same_colour]) < np.median(grey[~same_colour])


def _larger_chessboard(image: np.ndarray, grid: np.ndarray) -> tuple[int, int]:
    """(columns, rows) of the grid and of the rows and columns of corners that go on beyond it."""
    size = [grid.shape[1], grid.shape[0]]
    image = image.astype(np.float32)
    inner = fit_saddles(image, *_chess_frame(grid))
    for quarter in range(4):
        rotated = np.rot90(grid, quarter)
        next_corner = 2 * rotated[0] - rotated[1]
        row_step = np.gradient(next_corner, axis=0).T
        down = (rotated[0] - rotated[1]).T
        is_inside = (next_corner > 3).all(1) & (next_corner < np.array(image.shape[::-1]) - 4).all(
            1
        )
        if is_inside.sum() < 0.5 * len(is_inside):
            continue
        places = next_corner.T[:, is_inside], row_step[:, is_inside], down[:, is_inside]
        size[(quarter + 1) % 2] += int(_goes_on(image, places, inner))
    return size[0], size[1]


def _goes_on(image: np.ndarray, places: tuple[np.ndarray, ...], inner: Fit) -> bool:
    """Whether corners like the inner ones are at most places: starts, and steps along and down, each (2, n) px.

    A fit where no corner is never settles; that most of them are none shows after a few steps.
    """
    start, _, down = places
    for steps in (_FEW_STEPS, STEPS):
        fit = fit_saddles(image, *places, steps=steps)
        is_near_start = np.hypot(*(fit.centre - start)) < 0.25 * np.hypot(*down)
        is_corner = fit.good & is_near_start & _is_alike(fit, inner)
        if is_corner.mean() <= CONTINUES:
            return False
    return True


def _is_alike(fit: Fit, inner: Fit) -> np.ndarray:
    """(n,) whether saddles have about the contrast and the standard deviation of the inner ones."""
    contrast = np.abs(fit.values[:, 6])
    inner_contrast = np.median(np.abs(inner.values[:, 6]))
    inner_sigma = np.median(inner.sigma)
    return (contrast > 0.5 * inner_contrast) & (fit.sigma < 3 * inner_sigma)


def _chess_frame(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        grid.reshape(-1, 2).T,
        np.gradient(grid, axis=1).reshape(-1, 2).T,
        np.gradient(grid, axis=0).reshape(-1, 2).T,
    )


def _another_chessboard(image: np.ndarray, board: "Board") -> Found:
    """Describe what is there in place of the expected chessboard."""
    import cv2

    small, scale = _shrunk(image, SMALL)
    smallest_size = tuple(max(3, n - 3) for n in (board.columns, board.rows))
    for start in (smallest_size, smallest_size[::-1], (3, 3)):
        is_found, corners, meta = cv2.findChessboardCornersSBWithMeta(
            small, start, cv2.CALIB_CB_LARGER
        )
        if is_found and meta.shape != (board.rows, board.columns):
            grid = (corners.reshape(*meta.shape, 2).astype(float) + 0.5) * scale - 0.5
            if fit_saddles(image.astype(np.float32), *_chess_frame(grid)).good.mean() < CONTINUES:
                continue
            size = _as_written(meta.shape[::-1], (board.columns, board.rows))
            cut = _leaves(grid, image.shape) and size[0] <= board.columns and size[1] <= board.rows
            return Found(why=_other(board, size, cut), size=None if cut else size)
    return Found(
        why="no chessboard found (covered, blurred, cut off by the edge, or of another kind)"
    )


def _as_written(size: tuple[int, int], expected: tuple[int, int]) -> tuple[int, int]:
    """A size with its larger number where the expected one has its: a chessboard does not show which is which."""
    return tuple(sorted(size, reverse=expected[0] >= expected[1]))


def _leaves(grid: np.ndarray, shape: tuple[int, int]) -> bool:
    """Whether the next row or column on some side, with half a step around it, would not lie within the image."""
    edges = [2.5 * np.rot90(grid, k)[0] - 1.5 * np.rot90(grid, k)[1] for k in range(4)]
    boundary = np.concatenate(edges)
    return bool(((boundary < 0) | (boundary > np.array(shape[::-1]) - 1)).any())


def _other(board: "Board", size: tuple[int, int], cut: bool = False) -> str:
    seen = f"{size[0]} x {size[1]} {board.marks} found, {board.columns} x {board.rows} expected"
    if cut:
        return f"{seen}: the board is cut by the image's edge"
    return f"{seen}: if the board has {size[0]} x {size[1]}, correct columns and rows, else show all of it"


def _two(board: "Board") -> str:
    """Which of them is meant, nothing says."""
    return f"two boards of {board.columns} x {board.rows} {board.marks} found: show one, or cover the other"


# Circles


def _circles(image: np.ndarray, board: "Board") -> Found:
    asymmetric = board.kind == "asymmetric-circles"
    disc_sets = [circles.candidates(image, light) for light in (False, True)]
    for discs in sorted(disc_sets, key=lambda d: abs(d.shape[1] - board.count)):
        chosen = circles.grid_among(discs, board.columns, board.rows, asymmetric)
        if chosen is None:
            continue
        order = _circle_order(discs[:2, chosen], board)
        discs_in_order = discs[:, chosen[order]]
        larger = _larger_grid(
            discs, discs_in_order[:2].T.reshape(board.rows, board.columns, 2), asymmetric
        )
        if larger != (board.columns, board.rows):
            return Found(why=_other(board, larger), size=larger)
        if (
            circles.grid_among(np.delete(discs, chosen, 1), board.columns, board.rows, asymmetric)
            is not None
        ):
            return Found(why=_two(board))
        return Found(np.arange(board.count), discs_in_order[:2], discs=discs_in_order)
    return _another_grid(disc_sets, board, image.shape)


def _circle_order(pixels: np.ndarray, board: "Board") -> np.ndarray:
    """(N,) order of a grid as OpenCV gives it, so that z points away from the camera and x to the right."""
    order = np.arange(board.count).reshape(board.rows, board.columns)
    grid = pixels.T.reshape(board.rows, board.columns, 2)
    if _handedness(grid) < 0:
        # Of an asymmetric grid only the rows can be reversed: reversed columns are another pattern.
        order = order[::-1] if board.kind == "asymmetric-circles" else order[:, ::-1]
    rotations = range(0, 4, 4 // board.rotational_symmetry)
    shape = [np.rot90(order, k) for k in rotations if np.rot90(order, k).shape == order.shape]
    return max(shape, key=lambda o: _rightward(pixels.T[o])).ravel()


def _larger_grid(discs: np.ndarray, grid: np.ndarray, asymmetric: bool) -> tuple[int, int]:
    """(columns, rows) of the grid and of what goes on beyond it among the candidates (6, n)."""
    size = [grid.shape[1], grid.shape[0]]
    step_of_columns = 2 if asymmetric else 1
    for quarter in range(4):
        rotated = np.rot90(grid, quarter)
        sideways = quarter % 2
        step = 1 if sideways else step_of_columns
        if rotated.shape[0] <= step:
            continue
        next_column = (
            2 * rotated[0] - rotated[step]
            if sideways or not asymmetric
            else rotated[1] + rotated[0] - rotated[2]
        )
        distance = np.hypot(*(next_column.T[:, :, None] - discs[:2, None])).min(1)
        reach = 0.2 * np.hypot(*(rotated[0] - rotated[step]).T)
        size[(quarter + 1) % 2] += int((distance < reach).mean() > CONTINUES)
    return size[0], size[1]


def _another_grid(disc_sets: list[np.ndarray], board: "Board", shape: tuple[int, int]) -> Found:
    """Find another grid of circles: sizes around the expected one, the largest first."""
    wide = board.columns
    high = board.rows
    asymmetric = board.kind == "asymmetric-circles"
    near_sizes = {
        (a, b)
        for a in range(max(3, wide // 2), wide + 2)
        for b in range(max(3, high // 2), high + 2)
    }
    sizes = [(*s, asymmetric) for s in (near_sizes | {(high, wide)}) - {(wide, high)}] + [
        (wide, high, not asymmetric)
    ]
    for columns, rows, kind in sorted(sizes, key=lambda s: -s[0] * s[1]):
        for discs in disc_sets:
            chosen = circles.grid_among(discs, columns, rows, kind)
            if chosen is None:
                continue
            if kind != asymmetric:
                other = "an asymmetric" if kind else "a symmetric"
                return Found(
                    why=f"{other} grid of {columns} x {rows} circles found: correct asymmetric under [board]"
                )
            grid = discs[:2, chosen].T.reshape(rows, columns, 2)
            cut = _leaves(grid, shape) and columns <= wide and rows <= high
            return Found(
                why=_other(board, (columns, rows), cut), size=None if cut else (columns, rows)
            )
    count = max(d.shape[1] for d in disc_sets)
    return Found(why=f"no grid of circles found: {count} discs of one size, {board.count} expected")


# ChArUco


def _charuco(image: np.ndarray, board: "Board") -> Found:
    """Corners between markers that are seen: a board may be cut or partly covered, or printed white on dark."""
    for shown in (image, 255 - image):
        index, pixels, markers = _marked(shown, board.columns, board.rows, board)
        if len(markers):
            break
    if len(index) >= 6 and circles.is_flat(board.points[:2, index], pixels):
        return Found(index, pixels)
    if len(markers):
        return _another_charuco(shown, board, len(index), markers)
    return Found(why=f"no marker of {board.dictionary} found")


def _another_charuco(image: np.ndarray, board: "Board", corners: int, markers: np.ndarray) -> Found:
    """Find another ChArUco board that explains the markers: the one with most corners, of these the smallest."""
    wide = board.columns
    high = board.rows
    best = (max(5, 1.3 * corners), 0, None)
    near_boards = {(wide + a, high + b, board.legacy) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    for columns, rows, legacy in {
        *near_boards,
        (high, wide, board.legacy),
        (wide, high, not board.legacy),
    }:
        index, pixels, _ = (
            _marked(image, columns, rows, board, legacy)
            if min(columns, rows) > 1
            else ((), None, 0)
        )
        rank = (len(index), -columns * rows)
        if rank > best[:2] and circles.is_flat(
            np.array(np.divmod(index, columns)[::-1], float), pixels
        ):
            best = (*rank, (columns, rows, legacy))
    if best[2] is None and len(np.unique(markers)) < 0.7 * len(
        markers
    ):  # on one board every marker stands once
        return Found(why=_two(board))
    if best[2] is None:
        seen = f"{len(markers)} markers and {corners} corners between them found"
        return Found(why=f"{seen}, 6 corners needed: show more of the board")
    if best[2][:2] == (wide, high):
        return Found(
            why=f"the markers are those of a board with legacy = {str(best[2][2]).lower()}: correct it"
        )
    return Found(why=_other(board, best[2][:2]), size=best[2][:2])


def _marked(image, columns: int, rows: int, board: "Board", legacy: bool | None = None):
    """Index (k,), pixels (2, k) and numbers (m,) of the markers of a board of this size."""
    detector = _detector(
        columns,
        rows,
        board.square_mm,
        board.marker_mm,
        board.dictionary,
        board.legacy if legacy is None else legacy,
    )
    corners, ids, _, markers = detector.detectBoard(image)
    seen = np.ravel(() if markers is None else markers)
    if ids is None or len(ids) == 0:
        return np.zeros(0, int), np.zeros((2, 0)), seen
    order = np.argsort(ids.ravel())
    return ids.ravel()[order].astype(int), corners.reshape(-1, 2)[order].T.astype(float), seen


@cache
def _detector(columns, rows, square, marker, dictionary, legacy):
    import cv2

    kind = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), square, marker, kind)
    board.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(board)


# AprilGrid


def _aprilgrid(image: np.ndarray, board: "Board") -> Found:
    """Corners of the tags that are seen: a board may be cut or partly covered."""
    tags = aprilgrid.tags_in(image)
    if not aprilgrid.is_enough(tags):
        seen = len(tags.numbers)
        if seen != len(set(tags.numbers.tolist())):
            return Found(why=_two(board))
        return Found(why=f"{seen} tags of {aprilgrid.DICTIONARY} found: show more of the board")
    columns = board.columns // 2
    rows = board.rows // 2
    if tags.numbers.max() < columns * rows:
        index = aprilgrid.corner_indices(tags.numbers, columns, rows)
        corners, misfit = aprilgrid.ordered_corners(tags, board.points[:2], index)
        if aprilgrid.is_flat(misfit, board.marker_mm):
            order = np.argsort(index.ravel())
            return Found(index.ravel()[order], corners.reshape(-1, 2)[order].T)
    other = aprilgrid.other_columns(tags, board.marker_mm, board.square_mm, rows)
    if other is None:
        return Found(
            why="the tags do not lie as on a flat AprilGrid: correct square_mm and marker_mm"
        )
    needed = max(rows, int(tags.numbers.max()) // other + 1)
    seen = f"tags of a board with {other} columns and {needed} rows or more found"
    return Found(
        why=f"{seen}, {columns} x {rows} expected: correct columns and rows", size=(other, needed)
    )


# Which way a grid lies


def _handedness(grid: np.ndarray) -> float:
    """Above 0 where y is clockwise from x in the image, so that the board's z points away from the camera."""
    row_step = np.diff(grid, axis=1)[:-1]
    down = np.diff(grid, axis=0)[:, :-1]
    return float(np.sum(row_step[..., 0] * down[..., 1] - row_step[..., 1] * down[..., 0]))


def _right_handed(grid: np.ndarray) -> np.ndarray:
    return grid if _handedness(grid) > 0 else grid[:, ::-1]


def _rightward(grid: np.ndarray) -> float:
    return float(np.sum(np.diff(grid, axis=1)[..., 0]) / (grid.shape[1] - 1))


def _upright(grid: np.ndarray, rotations: list[int]) -> np.ndarray:
    """The grid after that one of the allowed quarter turns in which x points farthest to the right."""
    rotated = [np.rot90(_right_handed(grid), k) for k in rotations]
    return max(rotated, key=_rightward)
