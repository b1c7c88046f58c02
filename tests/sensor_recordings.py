"""Small rendered recordings of a scanner, made once a worker, for the tests of the commands and of their pages."""

import atexit
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

SCENE = """
title = "small scanner <for> tests"
seed = 3
balls = [[0.0, 0.0, 0.0, 12.0]]
parts = [3, 2]
[camera]
width_px = 400
height_px = 320
fx_px = 620.0
fy_px = 619.0
cx_px = 201.0
cy_px = 157.0
distortion = [-0.1, 0.05, 0.0003, -0.0004, 0.0]
[lens]
blur_px = 0.6
defocus_px = 0.0
[laser]
width_mm = 0.2
[mirror]
steps = 12
first_deg = -4.0
last_deg = 4.0
[board]
kind = "chessboard"
columns = 7
rows = 5
square_mm = 6.0
dark = 0.25
[placements]
count = 9
laser = 4
range_mm = [112.0, 140.0]
tilt_deg = 35.0
aside = 0.3
[scans]
count = 2
range_mm = [126.0, 132.0]
aside = 0.05
"""


@cache
def scanner_recording() -> tuple[Path, dict]:
    """The folder of a rendered scan-images recording without an arm, and its truth."""
    from workbench.jobs.sensor.render import render

    home = Path(mkdtemp(prefix="workbench-test-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    (home / "scene.toml").write_text(SCENE, encoding="utf-8")
    made = render(home / "scene.toml", home / "small", lambda text: None)
    return home / "small", made["truth"]


@cache
def handeye_recording() -> tuple[Path, np.ndarray]:
    """The same images of the board with flange poses of a camera in the hand, and the true T_flange_camera."""
    from dataclasses import replace

    from scipy.spatial.transform import Rotation

    import datasets
    from datasets.samples.columns import FLANGE
    from workbench.core.rigid import inverse, rotation_matrix, transform

    folder, truth = scanner_recording()
    poses = np.array([one["T_camera_board"] for one in truth["boards"]])
    camera_board = transform(rotation_matrix(poses[:, 3:]), poses[:, :3])
    hand_eye = transform(rotation_matrix(np.array([0.1, -0.2, 1.2])), np.array([15.0, -30.0, 80.0]))
    base_board = transform(
        rotation_matrix(np.array([3.0, 0.1, 0.2])), np.array([400.0, 50.0, 100.0])
    )
    flange = base_board @ inverse(camera_board) @ inverse(hand_eye)
    x, y, z, w = Rotation.from_matrix(flange[:, :3, :3]).as_quat().T
    columns = {
        "sample": np.arange(1.0, len(flange) + 1),
        **dict(zip(FLANGE, (*flange[:, :3, 3].T, w, x, y, z))),
    }
    boards = [row for row in datasets.read(folder).images if row["role"] == "board"]
    images = tuple({**row, "sample": int(row["placement"])} for row in boards)
    made = replace(
        datasets.read(folder), measures="board-images", columns=columns, images=images, balls={}
    )
    return datasets.write(made, folder.parent / "hand"), hand_eye
