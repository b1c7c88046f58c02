"""A flat calibration board: its kind, its size and where its corners or circles lie."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensors.boards.aprilgrid import grid_points
from workbench.core.errors import InputError

KINDS = ("chessboard", "charuco", "circles", "aprilgrid", "asymmetric-circles")
MIN_BOARD_CORNERS = 6
"""Corners below which a image says nothing about a camera: its pose alone takes three."""


@dataclass(frozen=True)
class Board:
    """A flat board. `columns` and `rows` count inner corners (also of ChArUco) or circles, `square_mm` is their step.

    `flatness_mm`: certified height of the highest over the lowest point, None where it is not known.
    The square between corners 0, 1, columns and columns + 1 is dark. Asymmetric circles are OpenCV's: `columns`
    in each of `rows` rows, every second row shifted by one step, circles of a row two steps apart. An AprilGrid has two
    columns and two rows of corners for each tag, `square_mm` from tag to tag, and tags of side `marker_mm`.
    """

    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float | None = None
    dictionary: str = ""
    legacy: bool = False
    flatness_mm: float | None = None

    @classmethod
    def of(cls, keys: Mapping) -> "Board":
        """From the keys of a recording's [board]. Raises InputError where they make no board."""
        kind = "asymmetric-circles" if keys.get("asymmetric") else keys.get("kind")
        if kind not in KINDS:
            raise InputError(
                f"[board], key kind: expected one of {', '.join(KINDS[:4])}, found {kind!r}; correct it"
            )
        optional = ("marker_mm", "dictionary", "legacy", "flatness_mm")
        further_keys = {name: keys[name] for name in optional if name in keys}
        size = [int(keys["columns"]), int(keys["rows"])]
        if kind == "aprilgrid":
            if not further_keys.get("marker_mm"):
                raise InputError(
                    "[board], key marker_mm: expected the side of a tag of the AprilGrid, found none; add it"
                )
            size = [2 * size[0], 2 * size[1]]
        board = cls(kind, *size, float(keys["square_mm"]), **further_keys)
        if min(board.columns, board.rows) < 2 or board.count < MIN_BOARD_CORNERS:
            raise InputError(
                f"[board], keys columns and rows: expected 2 or more of each and {MIN_BOARD_CORNERS} in all, found "
                f"{board.columns} and {board.rows}; count the inner corners or the circles"
            )
        if kind == "charuco" and not (board.marker_mm and board.dictionary):
            raise InputError(
                "[board], keys marker_mm and dictionary: expected both for a ChArUco board, found none; "
                'add them, such as marker_mm = 7.5 and dictionary = "DICT_5X5_250"'
            )
        return board

    @property
    def count(self) -> int:
        """Number of corners or circles."""
        return self.columns * self.rows

    @cached_property
    def points(self) -> np.ndarray:
        """(3, N) mm, z = 0: x along a row, y down the columns, row after row from corner 0."""
        if self.kind == "aprilgrid":
            return self._tag_corners()
        row, column = np.divmod(np.arange(self.count), self.columns)
        column_position = 2 * column + row % 2 if self.kind == "asymmetric-circles" else column
        return self.square_mm * np.stack([column_position, row, np.zeros_like(row)]).astype(float)

    def _tag_corners(self) -> np.ndarray:
        """(3, N) mm, the corners of all tags of an AprilGrid."""
        tags = self.columns // 2, self.rows // 2
        flat = grid_points(*tags, self.marker_mm, self.square_mm)
        return np.vstack([flat, np.zeros(self.count)])

    @property
    def middle(self) -> np.ndarray:
        """(3,) mm, of the rectangle around `points`."""
        return (self.points.min(1) + self.points.max(1)) / 2

    @property
    def half_diagonal(self) -> float:
        """mm, half the diagonal of the rectangle around `points`."""
        return float(np.linalg.norm(np.ptp(self.points, axis=1)) / 2)

    @property
    def rotational_symmetry(self) -> int:
        """In how many ways the board can be laid on itself by rotation: 1 (its origin is seen), 2 or 4."""
        even = (self.columns + self.rows) % 2 == 0
        square = self.columns == self.rows
        if self.kind == "chessboard":
            return (4 if square and self.columns % 2 == 0 else 2) if even else 1
        if self.kind == "circles":
            return 4 if square else 2
        return 2 if self.kind == "asymmetric-circles" and self.rows % 2 == 0 else 1

    @property
    def marks(self) -> str:
        """Plural noun of the features of this board, such as corners."""
        return "circles" if self.kind.endswith("circles") else "corners"

    @property
    def title(self) -> str:
        """Size and kind in words; the size of an AprilGrid is that in tags."""
        if self.kind == "aprilgrid":
            return f"{self.columns // 2} x {self.rows // 2} aprilgrid"
        return f"{self.columns} x {self.rows} {self.kind}"
