"""Flange poses and pixels as they come in: what is no pose, or no pixel, is named."""

from collections.abc import Sequence

import numpy as np

from workbench.core.errors import InputError
from workbench.core.rigid import nearest_rotation

_ROUNDED = 5e-3  # matrices written with three decimals are off by half of this


def checked_flange(flange: np.ndarray, called: str) -> np.ndarray:
    """(P, 4, 4) flange poses with rotations that are exact; `called`: for the sentence. InputError for what is none."""
    flange = np.array(flange, float)
    if flange.ndim != 3 or flange.shape[1:] != (4, 4) or not np.isfinite(flange).all():
        raise InputError(
            f"{called}: expected finite flange poses (n, 4, 4), found shape {flange.shape}; correct them"
        )
    rotations = flange[:, :3, :3]
    for wrong, found in (
        (
            np.abs(flange[:, 3] - [0, 0, 0, 1]).max(1) > 1e-6,
            "a last row other than 0 0 0 1; is the matrix transposed?",
        ),
        (
            np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3)).max((1, 2)) > _ROUNDED,
            "axes that are not of unit length and at right angles; correct it",
        ),
        (np.linalg.det(rotations) < 0, "left-handed axes; correct the sign of one of them"),
    ):
        if wrong.any():
            number = int(np.argmax(wrong))
            raise InputError(
                f"{called}, flange pose {number}: expected a rotation and a place, found {found}"
            )
    flange[:, :3, :3] = nearest_rotation(rotations)
    return flange


def check_pixels(views: Sequence) -> None:
    """InputError where a view has a pixel that is no number."""
    for number, view in enumerate(views):
        bad = ~np.isfinite(np.asarray(view.pixels, float)).all(0)
        if bad.any():
            raise InputError(
                f"image {number}: expected pixels that are numbers, found nan at corner "
                f"{view.index[np.argmax(bad)]} of the board; take the corner out"
            )
