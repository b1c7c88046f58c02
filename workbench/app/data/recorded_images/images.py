"""Images of a recording with what is detected in them: corners of a board, the centreline of a laser stripe."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from workbench.app.security import resolve_inside
from workbench.core.errors import InputError

MOST_PIXELS = 1_000_000
"""Larger images are sent smaller; the overlay is in pixels of the full image."""
_MOST_MARKS = 3000


@dataclass(frozen=True)
class Overlay:
    """An image as a data address, its `size` (width, height) px, and marks over it.

    `corners` and `stripe` (2, k) px of the full image; `index` (k,) which corners of the board.
    `why` nothing was found, "" where something was.
    """

    name: str
    role: str
    source: str
    size: tuple[int, int]
    corners: np.ndarray
    stripe: np.ndarray
    why: str
    index: np.ndarray | None = None


def image_rows(recording) -> list[dict]:
    """Index, name, role, board pose and scan of every image, for lists."""
    rows = []
    for k, row in enumerate(recording.images):
        role = row.get("role", "")
        rows.append({"index": k, "name": row["image"], "role": role, "tags": _tags(row)})
    return rows


def _tags(row: Mapping) -> str:
    """Board pose, scan and step of an image, as far as they are stated."""
    keys = [key for key in ("placement", "scan", "step") if row.get(key) not in (None, "")]
    return ", ".join(f"{key} {row[key]}" for key in keys)


def overlay(recording, index: int) -> Overlay:
    """The image at place `index` of images.csv with its corners and stripe. Raises InputError."""
    from sensors.images import read

    row = _row_at(recording, index)
    image = read(_path_of(recording, row), f"{recording.name}/{row['image']}")
    corners, index, why = _corners(recording, row, image)
    stripe, is_lost = _stripe(row, image)
    return Overlay(
        row["image"],
        row.get("role", ""),
        encoded(image.grey),
        image.size,
        corners,
        stripe,
        why or is_lost,
        index,
    )


@lru_cache(maxsize=24)
def overlay_of(opened, index: int) -> tuple[Overlay, np.ndarray | None]:
    """The image of an opened run with its marks, and (2, k) px reprojection errors of its corners, None without.

    Raises InputError as `overlay`.
    """
    from workbench.app.data.sensor import reprojection

    shown = overlay(opened.recording, index)
    if not shown.corners.shape[1] or shown.index is None:
        return shown, None
    return shown, reprojection(opened, shown.corners, shown.index)


def _row_at(recording, index: int) -> Mapping:
    if not 0 <= index < len(recording.images):
        raise InputError(
            f"{recording.name}, images.csv: expected an image from 0 to {len(recording.images) - 1}, found {index}; "
            "choose another"
        )
    return recording.images[index]


def _path_of(recording, row: Mapping) -> Path:
    path = resolve_inside(Path(recording.folder), row["image"])
    if path is None:
        raise InputError(
            f"{recording.name}/images.csv, image {row['image']}: expected a file in the recording's folder, "
            "found none; correct the row"
        )
    return path


def encoded(grey: np.ndarray) -> str:
    """A data address (JPEG) of an image (H, W), made smaller where it is large."""
    import cv2

    scale = np.sqrt(MOST_PIXELS / grey.size)
    grey = _with_8_bits(grey)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    code = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    return "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode()


def _with_8_bits(grey: np.ndarray) -> np.ndarray:
    """(H, W) uint8: of deeper images the brightest pixel becomes 255."""
    if grey.dtype == np.uint8:
        return grey
    factor = 255 / max(int(grey.max()), 1)
    return (grey.astype(np.float32) * factor).astype(np.uint8)


def _corners(recording, row: Mapping, image) -> tuple[np.ndarray, np.ndarray | None, str]:
    from sensors.boards.board import Board
    from sensors.boards.detection import View, detect

    if row.get("role") != "board" or recording.board is None:
        return np.zeros((2, 0)), None, ""
    keys = {key: value for key, value in recording.board.items() if key != "fixed_to"}
    found = detect(image, Board.of(keys), row["image"])
    if isinstance(found, View):
        return found.pixels, found.index, ""
    return np.zeros((2, 0)), None, found.why


def _stripe(row: Mapping, image) -> tuple[np.ndarray, str]:
    """The laser line, searched along rows and columns; the direction with the smaller uncertainty is shown."""
    from sensors.stripe.find import find_stripes

    if row.get("role") not in ("board-laser", "scan"):
        return np.zeros((2, 0)), ""
    found = [find_stripes(image.grey[None], direction) for direction in ("rows", "columns")]
    best = min(found, key=lambda stripe: float(np.median(stripe.width)) if len(stripe) else np.inf)
    if not len(best):
        return np.zeros((2, 0)), "no laser line was found in this image"
    keep = np.linspace(0, len(best) - 1, min(len(best), _MOST_MARKS)).astype(int)
    return best.pixels[:, keep], ""
