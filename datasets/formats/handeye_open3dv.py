"""Images of a board with flange poses: a camera on the flange (8), and a stationary camera (5).

Poses `posN.txt`: Rx Ry Rz in degrees (about the fixed axes, x first), then X Y Z in mm. The board has
asymmetric circles, white on dark, 7 in each of 11 rows; neighbours in a row are 20 mm apart in the
hand's set and 40 mm in the other, which is two steps of the grid. `param.txt`: the authors' camera.
"""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.formats.native import checked, flange_columns, image_recording
from datasets.recording import Recording

VARIANTS = {"in-hand": ("input_EyeInHand", 8, 10.0), "to-hand": ("input_EyeToHand", 5, 20.0)}
"""Folder, number of poses, and step of the grid in mm."""


def read(folder: Path, variant: str) -> Recording:
    """One sample per image. In the `to-hand` set the arm holds the board: board key fixed_to is "tool"."""
    name, count, step = VARIANTS[variant]
    images = [f"{name}/pos{k}.png" for k in range(count)]
    paths = checked(
        folder, *images, *(f"{name}/pos{k}.txt" for k in range(count)), f"{name}/param.txt"
    )
    poses = np.array([_numbers(path, 6) for path in paths[count:-1]])
    columns = {"sample": np.arange(1.0, count + 1), **flange_columns(poses[:, 3:], poses[:, :3])}
    rows = [
        {"image": image, "role": "board", "placement": str(k), "sample": k + 1}
        for k, image in enumerate(images)
    ]
    board = {
        "kind": "circles",
        "columns": 7,
        "rows": 11,
        "square_mm": step,
        "asymmetric": True,
        "fixed_to": "tool" if variant == "to-hand" else "base",
    }
    camera = _camera(_numbers(paths[-1], 14))
    return image_recording(
        "board-images",
        rows,
        board,
        paths,
        f"Board of circles and flange poses, camera {variant}",
        columns,
        {"camera": camera},
    )


def _numbers(path: Path, min_count: int) -> np.ndarray:
    try:
        found = np.array(path.read_text(encoding="utf-8").split(), float)
    except ValueError as problem:
        raise complaint(
            f"{path.parent.name}/{path.name}", "numbers", str(problem)[:60], "fetch it again"
        ) from None
    if len(found) < min_count:
        raise complaint(
            f"{path.parent.name}/{path.name}",
            f"{min_count} numbers",
            str(len(found)),
            "fetch it again",
        )
    return found


def _camera(numbers: np.ndarray) -> dict:
    """Camera matrix by rows, then k1 k2 p1 p2 k3."""
    fx, _, cx, _, fy, cy = (float(v) for v in numbers[:6])
    return {
        "fx_px": fx,
        "fy_px": fy,
        "cx_px": cx,
        "cy_px": cy,
        "distortion": [float(k) for k in numbers[9:14]],
    }
