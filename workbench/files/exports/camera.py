"""A calibrated camera in the files of other programs: ROS camera_info, OpenCV, Kalibr; and read back."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from sensors.camera.model import BROWN, FISHEYE, Camera
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import least_squares

_GRID, _STEPS, _MOST_PX = 41, 10, 0.1


def camera_text(camera: Camera, name: str) -> str:
    """The text of a camera in the format `name`, one of `CAMERA_FORMATS`; InputError where that cannot hold it."""
    if name not in CAMERA_FORMATS:
        raise InputError(
            f"--to: expected one of {', '.join(CAMERA_FORMATS)}, found '{name}'; name one of them"
        )
    return CAMERA_FORMATS[name][0](camera)


def read_camera_text(text: str, name: str) -> Camera:
    """The camera of a text in the format `name`; InputError where it is not that."""
    import yaml

    try:
        return CAMERA_FORMATS[name][1](_loaded(text))
    except (KeyError, TypeError, ValueError, IndexError, yaml.YAMLError) as problem:
        raise InputError(
            f"camera file: expected the {name} format, found that {str(problem)[:80]} is missing or not "
            "usable; export it again"
        ) from None


def _loaded(text: str) -> Any:
    """YAML, with OpenCV's own header and matrix tag taken off."""
    import yaml

    lines = [
        line.replace("!!opencv-matrix", "")
        for line in text.splitlines()
        if not line.startswith("%YAML")
    ]
    return yaml.safe_load("\n".join(lines))


def _dump(keys: Mapping) -> str:
    import yaml

    return yaml.safe_dump(dict(keys), sort_keys=False, default_flow_style=None)


def _floats(values) -> list[float]:
    return [float(v) for v in np.ravel(values)]


def _ros(camera: Camera) -> str:
    """sensor_msgs/CameraInfo as `camera_calibration_parsers` reads it."""
    model = {BROWN: "plumb_bob", FISHEYE: "equidistant"}.get(
        len(camera.values), "rational_polynomial"
    )
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    return _dump(
        {
            "image_width": camera.size[0],
            "image_height": camera.size[1],
            "camera_name": "camera",
            "camera_matrix": {"rows": 3, "cols": 3, "data": _floats(camera.matrix)},
            "distortion_model": model,
            "distortion_coefficients": {
                "rows": 1,
                "cols": len(camera.distortion),
                "data": _floats(camera.distortion),
            },
            "rectification_matrix": {"rows": 3, "cols": 3, "data": _floats(np.eye(3))},
            "projection_matrix": {"rows": 3, "cols": 4, "data": _floats(projection)},
        }
    )


def _from_ros(keys) -> Camera:
    size = keys["image_width"], keys["image_height"]
    is_fisheye = keys["distortion_model"] == "equidistant"
    return _camera(keys, size, is_fisheye)


def _opencv(camera: Camera) -> str:
    """OpenCV's FileStorage, as its own calibration sample writes it.

    `fisheye_model` is the sample's key: 1 says that the four coefficients are those of cv2.fisheye, not k1 k2 p1 p2.
    """
    import cv2

    storage = cv2.FileStorage("camera.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.size[0])
    storage.write("image_height", camera.size[1])
    storage.write("fisheye_model", int(camera.is_fisheye))
    storage.write("camera_matrix", camera.matrix)
    storage.write("distortion_coefficients", np.array([camera.distortion]))
    return storage.releaseAndGetString()


def _from_opencv(keys) -> Camera:
    size = keys["image_width"], keys["image_height"]
    return _camera(keys, size, bool(keys.get("fisheye_model")))


def with_supported_distortion(camera: Camera, name: str) -> tuple[Camera, float]:
    """The camera as the format `name` can hold it, and px by which it is off the given one, at most in the image.

    Kalibr's radtan model has no third radial coefficient: the nearest camera without one stands in for
    it. InputError where that is off by more than a tenth of a pixel, or where
    part of the image cannot be undone.
    """
    if name != "kalibr" or camera.is_fisheye or not any(camera.distortion[4:]):
        return camera, 0.0
    wide, high = camera.size
    pixels = np.stack(
        np.meshgrid(np.linspace(0, wide - 1, _GRID), np.linspace(0, high - 1, _GRID))
    ).reshape(2, -1)
    flat = camera.normalised(pixels)
    seen = np.isfinite(flat).all(0)
    points = np.vstack([flat, np.ones(flat.shape[1])])[:, seen]
    found = Camera.of([*camera.values[:8], 0], camera.size)
    for _ in range(_STEPS):
        rows = found.project_rows(points)[2][:8].reshape(8, -1)
        right = (pixels[:, seen] - found.project(points)).ravel()
        step = least_squares(rows.T, right)
        found = Camera.of([*found.values[:8] + step, 0], camera.size)
    deviation = float(np.linalg.norm(found.project(points) - pixels[:, seen], axis=0).max())
    if not (deviation < _MOST_PX and seen.all()):
        raise InputError(
            f"export to Kalibr: expected a camera that its radtan model (k1, k2, p1, p2) follows to "
            f"{_MOST_PX} px, found one that it misses by {deviation:.2g} px; export to ROS or OpenCV instead"
        )
    return found, deviation


def _kalibr(camera: Camera) -> str:
    """Kalibr's camchain: radial-tangential distortion has four coefficients, see `with_supported_distortion`."""
    higher_order = () if camera.is_fisheye else camera.distortion[4:]
    if any(higher_order):
        raise InputError(
            "export to Kalibr: expected a camera with k1, k2, p1, p2 alone, found k3 or rational terms, "
            "which its radtan model does not have; export to ROS or OpenCV instead"
        )
    return _dump({"cam0": _kalibr_keys(camera)})


def _kalibr_keys(camera: Camera) -> dict:
    return {
        "camera_model": "pinhole",
        "intrinsics": _floats(camera.values[:4]),
        "distortion_model": "equidistant" if camera.is_fisheye else "radtan",
        "distortion_coeffs": _floats(camera.distortion[:4]),
        "resolution": list(camera.size),
        "rostopic": "/camera",
    }


def _from_kalibr(keys) -> Camera:
    camera = keys["cam0"]
    higher_order = () if camera["distortion_model"] == "equidistant" else (0.0,)
    values = np.array([*camera["intrinsics"], *camera["distortion_coeffs"], *higher_order])
    return Camera.of(values, camera["resolution"])


def _camera(keys, size, is_fisheye: bool) -> Camera:
    """Four coefficients are k1 k2 p1 p2, with k3 = 0, unless the file names the fisheye model."""
    matrix = np.reshape(keys["camera_matrix"]["data"], (3, 3))
    distortion = list(keys["distortion_coefficients"]["data"])
    if len(distortion) == 4 and not is_fisheye:
        distortion.append(0.0)
    return Camera.of(
        np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion]), size
    )


CAMERA_FORMATS: dict[str, tuple[Callable[[Camera], str], Callable[[Any], Camera]]] = {
    "ros": (_ros, _from_ros),
    "opencv": (_opencv, _from_opencv),
    "kalibr": (_kalibr, _from_kalibr),
}
"""Name of a format -> how it is written, and how read back."""
