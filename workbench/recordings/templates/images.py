"""Example recordings with rendered images: a board seen from a robot, and a laser scanner on a robot."""

from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from itertools import product
from pathlib import Path

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.formats.recording1 import read_recording
from datasets.formats.recording1_writer import write_csv
from datasets.recording import Recording
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_matrix, transform
from workbench.core.text.csv_text import csv_text
from workbench.jobs.robot.simulate import simulate
from workbench.jobs.sensor.render import render

_BOARDS = """
title = "example"
seed = 4
[camera]
width_px = 480
height_px = 384
fx_px = 750.0
fy_px = 749.3
cx_px = 241.4
cy_px = 188.2
distortion = [-0.15, 0.1, 0.0004, -0.0006, 0.0]
[lens]
focus_mm = 310.0
defocus_px = 2.0
[board]
kind = "chessboard"
columns = 9
rows = 6
square_mm = 12.0
[placements]
count = 14
laser = 0
range_mm = [260.0, 380.0]
tilt_deg = 35.0
aside = 0.4
"""
_HAND_EYE = transform(
    Rotation.from_euler("xyz", [5.0, -10.0, 80.0], degrees=True).as_matrix(),
    np.array([35.0, -20.0, 90.0]),
)
_BOARD = transform(
    Rotation.from_euler("xyz", [180.0, 3.0, 20.0], degrees=True).as_matrix(),
    np.array([550.0, 60.0, 20.0]),
)
_POSE_SIGMA_MM = 0.05
_EXAMPLE_BASE, _EXAMPLE_REACH_MM = "xyz_mm = [-420.0, -30.0, -120.0]", 1004.0
_AWAY_MM = (420.0, 340.0, 500.0)
_BELOW_MM = (-120.0, 0.0, -250.0, 120.0)
_SHARES = ("", "share_of_limits = 0.95\n")
"""Of the base in the frame of the balls, for the arm of the example and any arm in proportion to its reach."""


def board_images(folder: Path, progress) -> Recording:
    """14 images of a chessboard with the flange poses of a camera on the flange, rendered into `folder`."""
    scene = folder.with_name("scene.toml")
    scene.write_text(_BOARDS, encoding="utf-8")
    truth = render(scene, folder, progress)["truth"]
    boards = np.array([_pose(place["T_camera_board"]) for place in truth["boards"]])
    flange = _BOARD @ inverse(boards) @ inverse(_HAND_EYE)
    noise = np.random.default_rng(1).normal(size=(len(flange), 3))
    places = flange[:, :3, 3] + _POSE_SIGMA_MM * noise
    rotations = Rotation.from_matrix(flange[:, :3, :3]).as_quat(canonical=True)
    names = [f"flange_{name}" for name in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")]
    columns = {"sample": np.arange(1.0, len(flange) + 1)}
    columns |= dict(zip(names, (*places.T.round(4), *rotations.T[[3, 0, 1, 2]].round(8))))
    rendered = read_recording(folder)
    images = [
        {"image": row["image"], "role": "board", "sample": number}
        for number, row in enumerate(rendered.images, 1)
    ]
    write_csv(folder / "samples.csv", columns)
    _write_images(folder / "images.csv", images)
    return replace(rendered, columns=columns, images=tuple(images), title="example")


def _pose(values) -> np.ndarray:
    values = np.asarray(values, float)
    if values.shape == (4, 4):
        return values
    return transform(rotation_matrix(values[3:]), values[:3])


def _write_images(path: Path, rows) -> None:
    text = csv_text(rows[0], (row.values() for row in rows))
    path.write_text(text, encoding="utf-8")


def scan_images(folder: Path, robot: Mapping, progress) -> Recording:
    """A laser scanner on a robot: board, board with laser, and scans of three balls, rendered into `folder`."""
    scenes = resources.files("workbench").joinpath("files", "demo_scenes")
    scene = scenes.joinpath("scanner-on-arm.toml").read_text(encoding="utf-8")
    arm = scenes.joinpath("scanner-on-arm.arm.toml").read_text(encoding="utf-8")
    place = folder.parent
    (place / "robot.toml").write_text(tomli_w.dumps(dict(robot)), encoding="utf-8")
    arm = arm.replace('robot = "abb_irb120"', 'robot = "robot.toml"')
    write_reachable_scene(place / "scanner-on-arm.arm.toml", arm, robot)
    path = place / "scanner-on-arm.toml"
    path.write_text(scene, encoding="utf-8")
    render(path, folder, progress)
    return read_recording(folder)


def write_reachable_scene(path: Path, scene: str, keys: Mapping) -> None:
    """Write the scene of the arm with the balls where this arm can look at them from above. Raises InputError.

    Places are those of the example's arm in proportion to the reach, then nearer, farther, lower and higher ones.
    """
    robot = load_robot(keys, str(path))
    ratio = float(np.abs(robot.geometry[:, 1:3]).sum()) / _EXAMPLE_REACH_MM
    for share, distance, height in product(_SHARES, _AWAY_MM, _BELOW_MM):
        base = [-ratio * distance, -30.0 * ratio, ratio * height]
        numbers = ", ".join(f"{value:.1f}" for value in base)
        placed = scene.replace(_EXAMPLE_BASE, f"xyz_mm = [{numbers}]")
        path.write_text(f"{share}{placed}", encoding="utf-8")
        try:
            simulate(path)
        except InputError:
            continue
        return
    raise complaint(
        f"workbench new scan-images --robot, robot '{robot.name}'",
        "an arm that can look at balls from above at one of the places that are tried",
        "that it reaches too few views, as with joint limits or zero positions that are not those of the arm",
        "correct the robot file, or omit --robot and replace the example's robot afterwards",
    )
