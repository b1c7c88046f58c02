"""Reprojection error of each board image, and the standard deviations of the camera that was fitted to them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from workbench.app.data.opened import Opened


@dataclass(frozen=True)
class ImageError:
    """One board image: `name`, its `place` in images.csv and the RMS distance of its corners, `rms` px."""

    name: str
    place: int
    rms: float


def _rms_by_image(found) -> dict[str, object]:
    """Image -> RMS as the answer states it, which may be no number; {} where the answer lists no images."""
    rows = [row for row in found if isinstance(row, Mapping)] if isinstance(found, list) else []
    return {str(row.get("image")): row.get("rms_px") for row in rows}


@lru_cache(maxsize=4)
def image_errors(opened: Opened) -> tuple[ImageError, ...]:
    """Errors in the order of images.csv; () for a run that calibrated no camera."""
    rms = _rms_by_image(camera_answer(opened).get("images"))
    errors = []
    for place, image in enumerate(opened.recording.images):
        value = rms.get(image["image"])
        if isinstance(value, int | float) and np.isfinite(value):
            errors.append(ImageError(image["image"], place, float(value)))
    return tuple(errors)


def camera_answer(opened: Opened) -> Mapping:
    """Statements of the run on the camera that it calibrated; {} where it calibrated none."""
    answer = opened.answer or {}
    paths = ((), ("camera",), ("calibration", "camera"), ("sensor", "calibration", "camera"))
    for path in paths:
        keys = answer
        for name in path:
            keys = keys.get(name) if isinstance(keys, Mapping) else None
        if isinstance(keys, Mapping) and "fx_px" in keys:
            return keys
    return {}


def camera_deviations(opened: Opened) -> dict[str, float]:
    """Standard deviation (1 sigma) of each value of the camera, px or 1, by name such as "fx" or "k1"."""
    found = camera_answer(opened).get("std")
    if not isinstance(found, Mapping):
        return {}
    return {
        name.removesuffix("_px"): float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and np.isfinite(value)
    }
