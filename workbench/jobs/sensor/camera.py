"""From images of a board to a camera: the recording's part, the JSON contract and the file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.boards.detection import Rejected, detect_all
from sensors.camera.calibration import CameraCalibration, calibrate_camera
from sensors.camera.model import (
    Camera,
    camera_from_keys,
    camera_keys,
    covariance_from_keys,
    covariance_keys,
)
from sensors.trust import Trust, trust_from_keys
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml
from workbench.files.images.images import by_role
from workbench.files.provenance import provenance
from workbench.fitting.verdicts.sensor_verdict import camera_trust, camera_verdict, camera_warnings
from workbench.fitting.verdicts.verdict import Tolerance
from workbench.machine.progress import paced

FILE = "camera.toml"


@dataclass(frozen=True)
class CameraRun:
    """A recording's camera: `calibration`, and `rejected` images, those without a board and those that do not fit."""

    recording: Recording
    model: str
    calibration: CameraCalibration
    rejected: tuple[Rejected, ...]


def calibrate(recording: Recording, model: str, progress: Callable[[str], None]) -> CameraRun:
    """The camera of a recording with images of a board; `model` is "brown", "rational", "fisheye" or "auto".

    progress: called with one line a step. Raises InputError.
    """
    by_role(recording, "board")
    tick = paced(progress, "board in image")
    found = detect_all(recording, lambda done, total, name: tick(done, total))
    try:
        calibration = calibrate_camera(
            found.views, found.board, found.size, model, progress=progress
        )
    except InputError as problem:
        raise _with_reason(problem, found) from None
    model = model if calibration.choice is None else calibration.choice.chosen
    rejected = (*found.rejected, *calibration.rejected)
    return CameraRun(recording, model, calibration, rejected)


def _with_reason(problem: InputError, found) -> InputError:
    """The same sentence, and why images were left out, which may be what is wrong."""
    if not found.rejected:
        return problem
    first = found.rejected[0]
    total = len(found.views) + len(found.rejected)
    return InputError(
        f"{str(problem).rstrip('.')} ({len(found.rejected)} of {total} images left out; {first.image}: "
        f"{first.why})"
    )


def as_json(run: CameraRun, tolerances: Sequence[Tolerance] = ()) -> dict:
    """The camera's part of the JSON contract; tolerances: what its verdict is judged by."""
    calibration = run.calibration
    return {
        **camera_json(calibration.camera, calibration.std),
        "model": run.model,
        "model_choice": choice_json(calibration.choice),
        "rms_px": calibration.rms_px,
        "rms_coordinate_px": calibration.rms_coordinate_px,
        "rms_means": "rms_px counts 2-D distances, as OpenCV does; rms_coordinate_px is of one coordinate",
        "views": len(calibration.views),
        "placements": len(calibration.poses),
        "corners": int(calibration.view.size),
        "rejected": [
            {"image": rejection.image, "why": rejection.why} for rejection in run.rejected
        ],
        "images": images_json(calibration),
        "bow": bow_json(calibration),
        "held_out": held_out_json(calibration.held_out),
        "halves": halves_json(calibration.halves),
        "focal_scatter": focal_json(calibration.focal),
        "uncertainty": uncertainty_json(calibration.uncertainty),
        "undetermined": list(calibration.undetermined),
        "notes": list(calibration.notes),
        "warnings": camera_warnings(calibration),
        "verdict": camera_verdict(calibration, tolerances).as_json(),
        "provenance": provenance(run.recording),
    }


def camera_json(camera: Camera, std: Mapping[str, float]) -> dict:
    """Values in px with their 1 sigma under `std`, in the same order; std: by the keys of the solve."""
    known = {f"{name}_px": std.get(f"camera.{name}") for name in ("fx", "fy", "cx", "cy")}
    names = camera.names[4:]
    lens = [std.get(f"camera.{name}") for name in names]
    keys = camera_keys(camera)
    return {
        **{key: keys[key] for key in ("model", *known) if key in keys},
        "distortion": keys["distortion"],
        "width_px": camera.size[0],
        "height_px": camera.size[1],
        "std": {**known, "distortion": lens, **dict(zip(names, lens))},
    }


def choice_json(choice) -> dict | None:
    """The models compared by their errors on held-out board poses; None where the model was stated."""
    if choice is None:
        return None
    return {
        "chosen": choice.chosen,
        "sentence": choice.sentence,
        "extrapolation": list(choice.extrapolation),
        "candidates": [
            {
                "model": row.model,
                "parameters": row.parameters,
                "rms_px": row.fit_px,
                "held_out_rms_px": row.held_out_px,
                "excess_percent": None if row.excess is None else 100 * row.excess,
                "standard_error_percent": None if row.excess is None else 100 * row.standard_error,
                "corners_left_out": row.left_out,
                "why": row.why,
            }
            for row in choice.candidates
        ],
    }


def images_json(calibration: CameraCalibration) -> list[dict]:
    """One row a image used."""
    count = np.bincount(calibration.view, minlength=len(calibration.views))
    return [
        {
            "image": view.image,
            "placement": view.placement,
            "corners": int(k),
            "rms_px": float(rms),
            "note": view.note,
        }
        for view, k, rms in zip(calibration.views, count, calibration.view_rms_px)
    ]


def bow_json(calibration: CameraCalibration) -> dict | None:
    """The board's warp in mm, None where it was not fitted."""
    bow = calibration.bow
    if bow is None:
        return None
    return {
        "height_mm": bow.height_mm,
        "height_std_mm": bow.height_std_mm,
        "parameters": [
            {"name": name, "value": value, "std": bow.std[name], "unit": "mm"}
            for name, value in bow.parameters.items()
        ],
    }


def held_out_json(held_out) -> dict | None:
    """Errors on images left out, next to OpenCV's; None where there are too few."""
    if held_out is None:
        return None
    names = (
        "folds",
        "rms_px",
        "halved_rms_px",
        "opencv_rms_px",
        "opencv_halved_rms_px",
        "sentence",
    )
    return {name: getattr(held_out, name) for name in names}


def halves_json(halves) -> dict | None:
    """Difference of the projections of two cameras, each calibrated from half of the images."""
    if halves is None:
        return None
    return {
        "median_px": float(np.nanmedian(halves.difference.value)),
        "max_px": float(np.nanmax(halves.difference.value)),
        "over_sigma": halves.ratio,
        "sentence": halves.sentence,
    }


def focal_json(focal) -> dict | None:
    """Scatter of the focal length between board poses; None where there are too few."""
    if focal is None:
        return None
    names = ("share", "shift_px", "p_value", "significant")
    return {name: getattr(focal, name) for name in names}


def uncertainty_json(field) -> dict:
    """1 sigma of projection over the image."""
    return {
        "median_px": float(np.nanmedian(field.value)),
        "max_px": float(np.nanmax(field.value)),
        "distance_mm": field.distance_mm,
    }


def save(run: CameraRun, folder: Path) -> None:
    """Write camera.toml into `folder`: what `read` takes, with sigmas and where it comes from."""
    import tomli_w

    calibration = run.calibration
    std = {
        key.removeprefix("camera."): float(value)
        for key, value in calibration.std.items()
        if key.startswith("camera.")
    }
    text = {
        "format": "camera/1",
        **camera_keys(calibration.camera),
        "rms_coordinate_px": calibration.rms_coordinate_px,
        "std": std,
        **covariance_keys(_camera_covariance(calibration)),
        "verdict": camera_trust(calibration).as_keys(),
        "provenance": {key: value for key, value in provenance(run.recording).items() if value},
    }
    (folder / FILE).write_text(tomli_w.dumps(text), encoding="utf-8")


def _camera_covariance(calibration: CameraCalibration) -> np.ndarray:
    """(V, V) of the camera's values."""
    count = len(calibration.camera.values)
    return calibration.covariance[:count, :count]


def read(path: Path) -> Camera:
    """The camera of a camera.toml, or of a scanner.toml. Raises InputError."""
    return read_stated(path)[0]


def read_stated(path: Path) -> tuple[Camera, np.ndarray | None]:
    """The camera of a camera.toml or a scanner.toml, and the covariance (V, V) of its values; None where the file
    states none. Raises InputError."""
    inner = _camera_keys(path)
    camera = camera_from_keys(inner, str(path))
    covariance = covariance_from_keys(inner, camera, str(path))
    return camera, covariance


def read_trust(path: Path) -> Trust | None:
    """Trustworthiness of the camera calibration as stated in the file; None in files of older versions."""
    return trust_from_keys(_camera_keys(path), str(path))


def _camera_keys(path: Path) -> Mapping:
    """Keys of the camera in a camera.toml or a scanner.toml. Raises InputError."""
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path}: expected a calibrated camera (TOML), found none to read ({problem}); name the "
            "camera.toml that `workbench camera` writes"
        ) from None
    inner = keys.get("camera", keys)
    return inner if isinstance(inner, Mapping) else keys
