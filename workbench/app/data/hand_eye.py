"""Errors of a hand-eye run by image or pose, and where flange, sensor and board stand."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from workbench.app.data.opened import Opened
from workbench.app.edits.session import HAND_EYE
from workbench.core.errors import InputError

TO_HAND = "to-hand"


@dataclass(frozen=True)
class PoseError:
    """Error of one image or pose, `unit` px or mm.

    `residual` of the fit and `held_out`, None where not computed; `rows` of the samples measured there, () where the
    recording has none of that name; `is_outlier`: the run left it out, `why`.
    """

    name: str
    residual: float | None
    held_out: float | None
    unit: str
    rows: tuple[int, ...]
    is_outlier: bool = False
    why: str = ""


@lru_cache(maxsize=4)
def pose_errors(opened: Opened) -> tuple[PoseError, ...]:
    """Errors in the order of the answer; () for a run that is no hand-eye calibration."""
    found = (opened.answer or {}).get("errors")
    if opened.command != HAND_EYE or not isinstance(found, list):
        return ()
    rows = _rows_by_name(opened)
    return tuple(_pose_error(row, rows) for row in found if isinstance(row, Mapping))


def error_of_row(opened: Opened, row: int) -> PoseError | None:
    """Error of the image or pose that a row belongs to; None where it has none."""
    return next((error for error in pose_errors(opened) if row in error.rows), None)


def _pose_error(row: Mapping, rows: Mapping) -> PoseError:
    name = str(row.get("name", ""))
    residual, held_out = (_number(row.get(key)) for key in ("residual", "held_out"))
    return PoseError(
        name,
        residual,
        held_out,
        str(row.get("unit", "")),
        rows.get(name, ()),
        bool(row.get("outlier")),
        str(row.get("why") or ""),
    )


def _number(value: object) -> float | None:
    is_number = isinstance(value, int | float) and np.isfinite(value)
    return float(value) if is_number else None


def _rows_by_name(opened: Opened) -> dict[str, tuple[int, ...]]:
    """Rows of the samples of each image, and of each pose by the name that the answer gives it."""
    found = _rows_of_images(opened)
    return found if found or not opened.recording.n else _rows_of_poses(opened)


def _rows_of_images(opened: Opened) -> dict[str, tuple[int, ...]]:
    """Image -> rows of its sample, of the images that name one."""
    numbers = opened.edit_ids
    found = {}
    for image in opened.recording.images:
        if image.get("sample") is not None:
            rows = np.flatnonzero(numbers == int(image["sample"]))
            found[image["image"]] = tuple(rows.tolist())
    return found


def _rows_of_poses(opened: Opened) -> dict[str, tuple[int, ...]]:
    """Name of each pose -> rows of its samples."""
    labels = opened.samples.columns.get("pose", opened.recording.poses)[opened.rows]
    return {
        f"pose {label:g}": tuple(np.flatnonzero(labels == label).tolist())
        for label in np.unique(labels)
    }


def has_flange(opened: Opened) -> bool:
    """Whether the flange poses of the samples are known."""
    return flange_poses_of(opened) is not None


@lru_cache(maxsize=4)
def flange_poses_of(opened: Opened) -> np.ndarray | None:
    """(n, 4, 4) T_base_flange of the samples, mm; None where neither poses nor an arm are recorded."""
    from workbench.files.images.flange import flange_poses

    try:
        return flange_poses(opened.samples) if opened.samples.n else None
    except InputError:
        return None


@dataclass(frozen=True)
class Placed:
    """T_base_sensor and T_base_board at flange poses: `sensors` and `boards` (k, 4, 4) mm, one where it is fixed.

    `ball`: (3,) mm, centre of the ball that was measured instead of a board, `boards` is then None.
    """

    sensors: np.ndarray
    boards: np.ndarray | None
    ball: np.ndarray | None = None


def placed(opened: Opened, flange: np.ndarray) -> Placed | None:
    """Sensor and board at flange poses (k, 4, 4); None without a hand-eye transform."""
    if opened.command != HAND_EYE:
        return None
    sensor = _matrix(opened.answer.get("hand_eye"))
    target = opened.answer.get("target") or {}
    board = _matrix(target)
    ball = target.get("xyz_mm")
    if sensor is None:
        return None
    if opened.answer.get("kind") == TO_HAND:
        return Placed(sensor[None], None if board is None else flange @ board)
    if board is None:
        centre = None if ball is None else np.array(ball, float)
        return Placed(flange @ sensor, None, centre)
    return Placed(flange @ sensor, board[None])


def _matrix(keys: object) -> np.ndarray | None:
    """(4, 4) of an object of the answer; None where it holds none that is complete."""
    matrix = keys.get("matrix") if isinstance(keys, Mapping) else None
    if matrix is None:
        return None
    found = np.array(matrix, float)
    return found if found.shape == (4, 4) and np.isfinite(found).all() else None
