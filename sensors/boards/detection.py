"""Calibration boards in images: which corner or circle is seen where, or why a image is of no use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sensors import images
from sensors.boards import finders as board_finders
from sensors.boards.board import MIN_BOARD_CORNERS, Board
from sensors.boards.patches import DISC_LOG_BLUR, SADDLE_LOG_BLUR
from sensors.images import Image
from workbench.core.errors import InputError

if TYPE_CHECKING:
    from datasets.recording import Recording


@dataclass(frozen=True, eq=False)
class View:
    """One image of a board: `pixels` (2, k) of the board's corners `index` (k,), `sigma` (k,) px of a coordinate.

    Where the board looks the same after a rotation, x points as far right in the image as it can. `radius_mm`:
    of the discs, for `circles.centre_shift`, 0 without; `row`: what images.csv says of the image.
    """

    image: str
    placement: str
    index: np.ndarray
    pixels: np.ndarray
    size: tuple[int, int]
    sigma: np.ndarray
    radius_mm: float = 0.0
    row: Mapping = field(default_factory=dict)
    note: str = ""
    blur_px: float = float("nan")
    """1 sigma of the Gaussian that blurs the edges of the board, median of its corners, px; nan where unknown."""


@dataclass(frozen=True)
class Rejected:
    """A image of no use, and why; `found` is the size (columns, rows) of board that it seems to show, if any."""

    image: str
    why: str
    placement: str = ""
    found: tuple[int, int] | None = None

    def __str__(self) -> str:
        return f"{self.image}: {self.why}"


@dataclass(frozen=True)
class Detection:
    """Images of a recording in which the board was found, and the others."""

    board: Board
    views: tuple[View, ...]
    rejected: tuple[Rejected, ...]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) px of the images."""
        return self.views[0].size


def detect(
    image: Image | np.ndarray,
    board: Board,
    name: str = "",
    placement: str = "",
    row: Mapping | None = None,
) -> View | Rejected:
    """Find the board's corners in an image (H, W), or state why they are not known."""
    image = images.as_image(image)
    if why := images.flaw(image):
        return Rejected(name, why, placement)
    eight = images.to_eight_bits(image.grey)
    found = board_finders.find(eight, board)
    if found.why:
        bright = (
            f" ({100 * image.saturated:.0f} % of the pixels are saturated)"
            if image.saturated > 0.1
            else ""
        )
        blurred = images.blur(image.grey) if found.size is None else None
        why = f"{blurred}; {found.why}" if blurred else found.why
        return Rejected(name, why + bright, placement, found.size)
    grey = image.grey.astype(np.float32)
    index, fit, radius = board_finders.refine(grey, board, found)
    if fit.good.sum() < max(MIN_BOARD_CORNERS, 0.5 * len(index)):
        return Rejected(
            name,
            f"{images.blur(image.grey) or 'blurred or covered'}; {fit.good.sum()} of {len(index)} {board.marks} are "
            "sharp enough",
            placement,
        )
    is_usable = fit.good
    return View(
        name,
        placement,
        index[is_usable],
        fit.centre[:, is_usable],
        image.size,
        fit.sigma[is_usable],
        radius,
        dict(row or {}),
        image.note,
        _blur(fit, is_disc=radius > 0),
    )


def _blur(fit, is_disc: bool) -> float:
    """Median blur of the marks of a `patches.Fit`, px."""
    logarithm = fit.values[fit.good, DISC_LOG_BLUR if is_disc else SADDLE_LOG_BLUR]
    return float(np.exp(np.median(logarithm)))


def detect_all(
    recording: "Recording",
    progress: Callable[[int, int, str], None] | None = None,
    said_in: str = "",
) -> Detection:
    """Every `board` image of a recording, one in memory at a time.

    progress: called with how many are done, how many there are, and the image's name. said_in: where the user
    describes the board, for messages; recording.toml if empty.
    Raises InputError where an image cannot be read, or none shows the board.
    """
    board = Board.of(_board_keys(recording))
    rows = [row for row in recording.images if row["role"] == "board"]
    if not rows:
        raise InputError(
            f"{recording.name}/images.csv, column role: expected images of a board, found none; "
            "add rows with role board"
        )
    found = []
    seen = {}
    for k, row in enumerate(rows):
        found.append(_view_or_rejection(recording, row, board, seen))
        if progress:
            progress(k + 1, len(rows), row["image"])
    found = _of_one_size(found)
    views = tuple(v for v, _ in found if isinstance(v, View))
    rejected = tuple(v for v, _ in found if isinstance(v, Rejected))
    if not views or _of_another_size(board, views, rejected):
        where = said_in or f"{recording.name}/recording.toml, [board]"
        raise _nothing(where, board, rejected, len(found))
    return Detection(board, views, rejected)


def _board_keys(recording: "Recording") -> Mapping:
    if not recording.board:
        raise InputError(
            f"{recording.name}/recording.toml, key [board]: expected this section, found none; add it"
        )
    return recording.board


def _view_or_rejection(
    recording: "Recording", row: Mapping, board: Board, seen: dict
) -> tuple[View | Rejected, tuple[int, int]]:
    """View or rejection of one image, and its size; `seen` holds the pixels that were met before."""
    name = row["image"]
    placement = str(row.get("placement", ""))
    image = images.read(Path(recording.folder or ".") / name, f"{recording.name}/{name}")
    view = detect(image, board, name, placement, row)
    if isinstance(view, View):
        pixels = image.size, hash(image.grey.tobytes())
        if first := seen.get(pixels):
            why = "listed twice" if first == name else f"the same pixels as {first}"
            return Rejected(name, why, placement), image.size
        seen[pixels] = name
    return view, image.size


def _of_one_size(found: list) -> list:
    odd = images.odd_sizes(size for _, size in found)
    return [
        (Rejected(v.image, odd[k], v.placement), size) if k in odd else (v, size)
        for k, (v, size) in enumerate(found)
    ]


def _of_another_size(board: Board, views: tuple[View, ...], rejected: tuple[Rejected, ...]) -> bool:
    """Whether no image shows every column and row as written, and more show a whole board of another size than not:
    a board of fewer columns near the image's edge passes for one that is cut there."""
    if any(_shows_full_size(view, board) for view in views):
        return False
    other_sizes = sum(rejection.found is not None for rejection in rejected)
    return other_sizes > len(views)


def _shows_full_size(view: View, board: Board) -> bool:
    """Whether some corner of every column and of every row is seen."""
    row, column = np.divmod(view.index, board.columns)
    return len(np.unique(column)) == board.columns and len(np.unique(row)) == board.rows


def _nothing(where: str, board: Board, rejected: tuple[Rejected, ...], count: int) -> InputError:
    """The sentence where no image shows the board: the size that most of them do show, else the first reason."""
    sizes = [r.found for r in rejected if r.found]
    if sizes:
        return _wrong_size(where, board, sizes, count)
    return InputError(
        f"{where}: expected a {board.title} in the images, found it in none of {count} "
        f"({rejected[0]}); correct the board or take the images again"
    )


def _wrong_size(where: str, board: Board, sizes: list[tuple[int, int]], count: int) -> InputError:
    size = max(set(sizes), key=sizes.count)
    return InputError(
        f"{where}: expected {board.title} as written there in the images, "
        f"found {size[0]} x {size[1]} in {sizes.count(size)} of {count}; "
        "correct columns and rows"
    )


def relabelled(view: View, board: Board, rotation: int) -> View:
    """The same image with the board rotated by `rotation` of its `rotational_symmetry` steps: other indices."""
    grid = np.arange(board.count).reshape(board.rows, board.columns)
    rotated = np.rot90(grid, rotation * 4 // board.rotational_symmetry).ravel()
    return replace(view, index=np.argsort(rotated)[view.index])
