"""Rendered hand-eye recordings that are right, with the truth known: the ground of the bench of user errors."""

import atexit
import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import datasets
from board_images import pattern
from datasets.recording import Recording
from datasets.samples.columns import FLANGE
from robot_model import load_robot
from robot_model.chain import forward
from sensors.boards.detection import Board
from sensors.camera.model import Camera
from workbench.core.rigid import inverse, rotation_vector, transform

SIZE = (640, 480)
CAMERA = Camera(900.0, 902.0, 320.0, 238.0, (0.0, 0.0, 0.0, 0.0, 0.0), SIZE)
SENSOR = transform(
    Rotation.from_euler("xyz", [12, -8, 95], degrees=True).as_matrix(), np.array([45.0, -30, 110])
)


@dataclass(frozen=True)
class Scene:
    """A recording that is right: board, where the sensor is, number of images, robot noise in mm, and the robot whose
    joints are recorded (None: flange poses)."""

    board: Board
    kind: str = "in-hand"
    count: int = 12
    noise_mm: float = 0.05
    robot: str | None = None


SCENES = {
    "chessboard": Scene(Board("chessboard", 9, 6, 8.0)),
    "ChArUco": Scene(Board("charuco", 7, 5, 12.0, 9.0, "DICT_5X5_250"), noise_mm=0.2),
    "circles": Scene(Board("circles", 8, 6, 9.0), count=14, noise_mm=0.1),
    "to-hand": Scene(Board("asymmetric-circles", 4, 11, 6.0), "to-hand", 11, 0.1),
    "joints": Scene(Board("chessboard", 8, 5, 8.0), count=12, robot="ur10e"),
}


@dataclass(frozen=True)
class Made:
    """A recording with the truth: T_flange_sensor (T_base_sensor for "to-hand"), and the camera's file."""

    recording: Recording
    sensor: np.ndarray
    kind: str
    camera: Path | None = None


@cache
def made(name: str) -> Made:
    """The rendered recording of a scene, read back from its folder."""
    scene, home = SCENES[name], Path(mkdtemp(prefix="workbench-test-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    random = np.random.default_rng(sorted(SCENES).index(name))
    seen = board_poses(scene, random)
    columns, robot, sensor = arm_columns(scene, seen, random)
    (home / "images").mkdir()
    rows = []
    for k, pose in enumerate(seen):
        image = f"images/{k + 1:02d}.png"
        cv2.imwrite(str(home / image), rendered(scene.board, pose, random))
        rows.append({"image": image, "role": "board", "placement": str(k + 1), "sample": k + 1})
    columns = {"sample": np.arange(1.0, scene.count + 1), **columns}
    recording = Recording(
        "board-images", columns, robot, images=tuple(rows), board=board_keys(scene), folder=home
    )
    camera = home / "camera.toml"
    camera.write_text(camera_text(CAMERA))
    return Made(datasets.read(datasets.write(recording, home / name)), sensor, scene.kind, camera)


REAL = ("handeye_open3dv:in-hand", "handeye_open3dv:to-hand")


@cache
def real(name: str) -> Made:
    """A real recording by its name, whose own result stands for the truth."""
    from workbench.jobs.sensor import hand_eye

    recording = datasets.read(name)
    run = hand_eye.calibrate(recording, None, None, lambda text: None)
    home = Path(mkdtemp(prefix="workbench-test-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    (home / "camera.toml").write_text(camera_text(run.calibration.camera))
    return Made(recording, run.made.sensor, run.made.kind, home / "camera.toml")


def camera_text(camera: Camera) -> str:
    keys = f"fx_px = {camera.fx}\nfy_px = {camera.fy}\ncx_px = {camera.cx}\ncy_px = {camera.cy}\n"
    size = f"width_px = {camera.size[0]}\nheight_px = {camera.size[1]}\n"
    return f'format = "camera/1"\n{keys}distortion = {list(camera.distortion)}\n{size}'


def board_keys(scene):
    board = scene.board
    asymmetric = board.kind == "asymmetric-circles"
    keys = {
        "kind": "circles" if asymmetric else board.kind,
        "columns": board.columns,
        "rows": board.rows,
    }
    keys |= {
        "square_mm": board.square_mm,
        "fixed_to": "tool" if scene.kind == "to-hand" else "base",
    }
    keys |= {"asymmetric": True} if asymmetric else {}
    return keys | (
        {"marker_mm": board.marker_mm, "dictionary": board.dictionary} if board.marker_mm else {}
    )


def board_poses(scene, random) -> np.ndarray:
    """(P, 4, 4) T_camera_board, tilted up to 30 degrees about any axis and filling half of the image."""
    tilts = random.uniform(-0.5, 0.5, (scene.count, 3)) * [1, 1, 1.2]
    turns = Rotation.from_rotvec(tilts).as_matrix()
    extent = np.ptp(scene.board.points[:2], axis=1) + 2 * scene.board.square_mm
    near = 1.5 * CAMERA.fx * max(extent / np.array(SIZE))
    away = near * random.uniform(1.0, 1.5, scene.count)
    aside = random.uniform(-0.06, 0.06, (scene.count, 2)) * away[:, None]
    return transform(turns, np.column_stack([aside, away]) - turns @ scene.board.middle)


def rendered(board, pose, random) -> np.ndarray:
    """(H, W) uint8: the board's texture through a homography, averaged over each pixel, blurred, with noise."""
    per_mm, over, margin = 12, 4, 2 * board.square_mm
    low, high = board.points.min(1)[:2] - margin, board.points.max(1)[:2] + margin
    x, y = (np.arange(a, b, 1 / per_mm) + 0.5 / per_mm for a, b in zip(low, high))
    texture = (255 * pattern(board)(*np.meshgrid(x, y)).astype(np.float32)).astype(np.uint8)
    to_board = np.array([[1 / per_mm, 0, x[0]], [0, 1 / per_mm, y[0]], [0, 0, 1]])
    fine = np.array([[over, 0, (over - 1) / 2], [0, over, (over - 1) / 2], [0, 0, 1]])
    h = fine @ CAMERA.matrix @ np.column_stack([pose[:3, :2], pose[:3, 3]]) @ to_board
    large = cv2.warpPerspective(texture, h, (SIZE[0] * over, SIZE[1] * over), borderValue=230)
    grey = cv2.GaussianBlur(
        cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.7
    ).astype(float)
    return np.clip(30 + 0.75 * grey + random.normal(0, 3.0, grey.shape), 0, 255).astype(np.uint8)


def arm_columns(scene, seen, random):
    """Columns of samples.csv, the robot, and the true sensor pose."""
    jolt = transform(
        Rotation.from_rotvec(random.normal(0, 3e-3 * scene.noise_mm, (scene.count, 3))).as_matrix(),
        random.normal(0, scene.noise_mm, (scene.count, 3)),
    )
    placed = transform(
        Rotation.from_euler("xyz", [175, 4, 40], degrees=True).as_matrix(),
        np.array([520.0, 80, 60]),
    )
    if scene.kind == "to-hand":
        sensor = placed
        flange = (
            sensor @ seen @ inverse(SENSOR)
        )  # the board sits on the flange where the sensor does elsewhere
        return flange_columns(jolt @ flange), {}, sensor
    if scene.robot is None:
        return flange_columns(jolt @ placed @ inverse(seen) @ inverse(SENSOR)), {}, SENSOR
    robot = load_robot({"builtin": scene.robot})
    start = np.radians([20.0, -80, 95, -100, -85, 30])
    middle = end_poses(robot, start[None])[0] @ SENSOR @ seen[0]
    joints = np.array(
        [inverted(robot, pose, start) for pose in middle @ inverse(seen) @ inverse(SENSOR)]
    )
    joints = np.degrees(joints + random.normal(0, 2e-3 * scene.noise_mm, joints.shape))
    return (
        {f"q{k + 1}_deg": column for k, column in enumerate(joints.T)},
        {"builtin": scene.robot},
        SENSOR,
    )


def end_poses(robot, joints) -> np.ndarray:
    """(n, 4, 4) T_base_flange of joints (n, J) rad."""
    frames = forward(robot, joints.T)
    return transform(np.stack(frames.end, -1).transpose(1, 0, 2), frames.end_origin.T)


def inverted(robot, pose, start):
    """(J,) rad at which the flange is at a pose."""

    def gap(joints):
        there = end_poses(robot, joints[None])[0]
        return np.concatenate(
            [there[:3, 3] - pose[:3, 3], 300 * rotation_vector(there[:3, :3] @ pose[:3, :3].T)]
        )

    found = least_squares(gap, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.cost < 1e-8
    return found.x


def flange_columns(poses) -> dict[str, np.ndarray]:
    x, y, z, w = Rotation.from_matrix(poses[:, :3, :3]).as_quat().T
    return dict(zip(FLANGE, (*poses[:, :3, 3].T, w, x, y, z)))


def of_profiles(points, pose, flange, first=1) -> Recording:
    """The recording of profiles of a ball of radius 20 mm: points (3, n) mm, pose numbers (n,) from 0, poses (P, 4, 4).

    first: number of the first pose in the recording.
    """
    columns = {
        "sample": np.arange(1.0, len(pose) + 1),
        "pose": pose + float(first),
        "ball": np.ones(len(pose)),
        **{name: values[pose] for name, values in flange_columns(flange).items()},
        **dict(zip(("x_mm", "y_mm", "z_mm"), points)),
    }
    return Recording("ball-surface", columns, {}, balls={1: (0.0, 0.0, 0.0, 20.0)}, name="profiles")
