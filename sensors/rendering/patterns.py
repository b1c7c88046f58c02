"""Print of a board: its reflectance at any place, averaged over a small square.

Places are in the board's own frame (`sensors.boards.board.Board`), mm. A mean over the square of side
`width`, with edges taken as straight within it, makes the few samples a pixel has count as many.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensors.boards.board import Board


@dataclass(frozen=True)
class Pattern:
    """A printed board: `white` and `dark` reflectances, `margin` of blank board in steps around it.

    `negative` swaps them: white circles on a dark board. `radius` of circles, in steps.
    """

    board: Board
    white: float = 0.85
    dark: float = 0.06
    margin: float = 1.0
    negative: bool = False
    radius: float = 0.3

    @property
    def middle(self) -> np.ndarray:
        """(2,) mm, of the grid of corners."""
        return self.board.middle[:2]

    @property
    def half_diagonal(self) -> float:
        """mm, of the grid of corners."""
        return self.board.half_diagonal

    @cached_property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (x, y) of the board itself, mm."""
        points = self.board.points[:2]
        step = self.board.square_mm
        border = step * (self.margin + (0 if self.board.marks == "circles" else 1))
        return points.min(1) - border, points.max(1) + border

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n,) bool: on the board."""
        low, high = self.extent
        return (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])

    def albedo(self, x: np.ndarray, y: np.ndarray, width: np.ndarray | float) -> np.ndarray:
        """(n,) mean reflectance over squares of side `width` mm around (x, y)."""
        ink = (_circles if self.board.marks == "circles" else self._squares)(
            *self._flat(x, y, width)
        )
        return self.white + (self.dark - self.white) * (1 - ink if self.negative else ink)

    def _flat(self, x, y, width):
        if self.board.marks == "circles":
            return self.board, x, y, width, self.radius
        step = self.board.square_mm
        return x / step, y / step, np.asarray(width) / step

    def _squares(self, x, y, width):
        """Share of ink; x, y and width in squares."""
        checks = (1 + _wave(x, width) * _wave(y, width)) / 2
        ink = checks * _step(self._to_edge(x, y), width)
        if self.board.kind == "chessboard":
            return ink
        return np.maximum(ink, self._markers(x, y, width))

    def _to_edge(self, x, y):
        """(n,) squares to the nearest edge of the pattern, negative beyond it."""
        horizontal = np.minimum(x + 1, self.board.columns - x)
        vertical = np.minimum(y + 1, self.board.rows - y)
        return np.minimum(horizontal, vertical)

    def _markers(self, x, y, width):
        """Ink of the ArUco markers in the light squares, from a table of their bits."""
        column = np.floor(x).astype(int) + 1
        row = np.floor(y).astype(int) + 1
        known = (
            (column >= 0) & (column <= self.board.columns) & (row >= 0) & (row <= self.board.rows)
        )
        number = np.where(
            known, self._table[np.where(known, row, 0), np.where(known, column, 0)], -1
        )
        side = self.board.marker_mm / self.board.square_mm
        bits = self._bits.shape[1]
        u, v = (((place - np.floor(place)) - (1 - side) / 2) / side * bits for place in (x, y))
        sharp = np.asarray(width) / side * bits
        return np.where(number >= 0, _texture(self._bits, np.maximum(number, 0), u, v, sharp), 0.0)

    @cached_property
    def _aruco(self):
        import cv2

        board = self.board
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        squares = (board.columns + 1, board.rows + 1)
        marker = board.marker_mm / board.square_mm
        charuco = cv2.aruco.CharucoBoard(squares, 1.0, marker, dictionary)
        charuco.setLegacyPattern(bool(board.legacy))
        return charuco, dictionary

    @cached_property
    def _table(self):
        """(rows + 1, columns + 1) place in `_bits` of each square's marker, -1 for none."""
        board, _ = self._aruco
        table = np.full((self.board.rows + 1, self.board.columns + 1), -1)
        for k, corners in enumerate(board.getObjPoints()):
            column, row = np.floor(np.mean(corners, axis=0)[:2]).astype(int)
            table[row, column] = k
        return table

    @cached_property
    def _bits(self):
        """(markers, side, side) 1 where a bit, or the marker's frame, is ink."""
        board, names = self._aruco
        side = names.markerSize + 2
        return np.stack(
            [names.generateImageMarker(int(k), side) < 128 for k in board.getIds().ravel()]
        ).astype(float)


def _wave(x, width):
    """(n,) +1 in even squares and -1 in odd ones, averaged over `width`; x and width in squares."""
    cell = np.floor(x)
    edge = np.minimum(x - cell, cell + 1 - x)
    return (1 - 2 * (cell % 2)) * np.minimum(1, 2 * edge / np.maximum(width, 1e-9))


def _step(depth, width):
    """(n,) share of a square of side `width` that is within an edge `depth` away."""
    return np.clip(0.5 + depth / np.maximum(width, 1e-9), 0, 1)


def _circles(board, x, y, width, radius):
    """Share of ink of discs of `radius` steps around the board's points."""
    step = board.square_mm
    row = np.clip(np.round(y / step), 0, board.rows - 1)
    # Of an asymmetric grid the nearest may be of the row above or below.
    offsets = (-1, 0, 1) if board.kind == "asymmetric-circles" else (0,)
    distances = [_nearest(board, x, y, row + k) for k in offsets]
    return _step(radius * step - np.min(distances, axis=0), width)


def _nearest(board, x, y, row):
    """(n,) mm to the nearest point of the board in these rows, or in its first or last row beyond it."""
    step = board.square_mm
    row = np.clip(row, 0, board.rows - 1)
    spread = 2 if board.kind == "asymmetric-circles" else 1
    shift = row % 2 if spread == 2 else 0
    column = np.clip(np.round((x / step - shift) / spread), 0, board.columns - 1)
    return np.hypot(x - step * (spread * column + shift), y - step * row)


def _texture(bits, number, u, v, width):
    """(n,) mean of the marker `number` over squares; places and `width` in bits, 0 outside the marker."""
    side = bits.shape[1]
    padded = np.pad(bits, ((0, 0), (1, 1), (1, 1)))
    share = 0.0
    (column_cell, right_share), (row_cell, below_share) = (
        _cell_and_share(u, width),
        _cell_and_share(v, width),
    )
    for column_offset in (0, 1):
        for down in (0, 1):
            column = np.clip(column_cell + column_offset + 1, 0, side + 1)
            row = np.clip(row_cell + down + 1, 0, side + 1)
            weight = (right_share if column_offset else 1 - right_share) * (
                below_share if down else 1 - below_share
            )
            share = share + weight * padded[number, row, column]
    return share


def _cell_and_share(place, width):
    """The cell before the nearest edge, and the share of the square that lies beyond that edge."""
    edge = np.round(place)
    return edge.astype(int) - 1, _step(place - edge, width)
