"""Example recordings of scanners that people have: rendered images, or simulated profiles and clouds.

Every example comes with its truth, so that tests can compare ball centres and hand-eye transforms with it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.formats.recording1 import read_recording
from datasets.formats.recording1_writer import write_csv
from datasets.recording import Recording
from sensors.rendering.places import board_poses
from sensors.rendering.recording import Stations, make_recording
from sensors.rendering.scene import Scene
from workbench.core.rigid import inverse, rotation_matrix, transform

KINDS = ("fixed-plane", "galvanometer", "turntable", "profiler", "3d-camera")
_FLANGE = tuple(f"flange_{name}" for name in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"))
_AIM_MM, _BASELINE_MM = 125.0, 69.0
_BALLS = ((0.0, 0.0, 0.0, 10.0), (42.0, 4.0, -2.0, 10.0), (20.0, 32.0, 6.0, 10.0))
_TABLE_BALLS = ((21.0, 0.0, 8.0, 7.0), (-8.0, 16.0, 8.0, 7.0), (-13.0, -12.0, 9.0, 7.0))
_POSE_SIGMA_MM = 0.02
_WIDTH_MM = 0.08


def _rotation(*degrees: float) -> np.ndarray:
    return Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()


HAND_EYE = transform(_rotation(3.0, -6.0, 75.0), np.array([40.0, -25.0, 95.0]))
"""T_flange_sensor of the examples, mm."""
_BOARD = transform(_rotation(178.0, 2.0, 15.0), np.array([560.0, 40.0, 60.0]))
_ARTEFACT = transform(_rotation(0.0, 0.0, 8.0), np.array([540.0, -60.0, 80.0]))
_TABLE = transform(_rotation(-128.0, 4.0, 0.0), np.array([1.0, 6.0, 128.0]))
"""T_camera_table at angle zero; z is the axis."""


@dataclass(frozen=True)
class Example:
    """A recording and its truth: `balls` number -> (3,) mm in the frame of its scans, `hand_eye` (4, 4) or None."""

    recording: Recording
    balls: Mapping[int, np.ndarray]
    hand_eye: np.ndarray | None


def example(kind: str, folder: Path, progress: Callable[[str], None], seed: int = 1) -> Example:
    """The example of one of `KINDS`, written into the new folder `folder`."""
    return {
        "fixed-plane": _fixed_plane,
        "galvanometer": _galvanometer,
        "turntable": _turntable,
        "profiler": _profiler,
        "3d-camera": _camera_3d,
    }[kind](folder, progress, seed)


def _scene(seed: int, **options) -> Scene:
    """The instrument of all examples with images: 480 x 384 px at 125 mm."""
    keys = {
        "title": "example",
        "seed": seed,
        "camera": {
            **{"width_px": 480, "height_px": 384, "fx_px": 750.0, "fy_px": 749.3},
            **{"cx_px": 241.4, "cy_px": 188.2, "distortion": [-0.15, 0.1, 0.0004, -0.0006, 0.0]},
        },
        "lens": {"blur_px": 0.6, "focus_mm": _AIM_MM, "defocus_px": 0.0},
        "laser": {"width_mm": _WIDTH_MM, "peak": 0.7, "speckle_contrast": 0.1},
        "board": {"columns": 9, "rows": 6, "square_mm": 5.0, "dark": 0.2},
    }
    return Scene(**(keys | options))


def _fixed_laser() -> dict:
    """A light plane through the middle of the field, from a laser next to the camera."""
    normal = np.array([_AIM_MM, 0.0, _BASELINE_MM]) / np.hypot(_AIM_MM, _BASELINE_MM)
    plane = {"normal": normal.tolist(), "offset_mm": float(-normal[2] * _AIM_MM)}
    laser = {"width_mm": _WIDTH_MM, "peak": 0.7, "speckle_contrast": 0.1}
    return {"plane": [plane], "laser": {**laser, "source_mm": [_BASELINE_MM, 0.0, 0.0]}}


def _on_robot(scene: Scene, sensor: np.ndarray, scans: list[int], folder, progress) -> Recording:
    """Boards and scans of a sensor that a robot carries.

    sensor (n, 4, 4): T_base_sensor of each station of the scans, scans (n): which scan it belongs to. Robot poses are
    recorded with a small random error of their position.
    """
    rng = np.random.default_rng((scene.seed, 9))
    boards = board_poses(scene.placements, scene.board.pattern, scene.sees, rng)
    rotation = rotation_matrix(boards[:, 3:])
    boards = transform(rotation, boards[:, :3])
    flange = np.concatenate([_BOARD @ inverse(boards), sensor]) @ inverse(HAND_EYE)
    columns = {"sample": np.arange(1.0, len(flange) + 1), **flange_columns(flange, rng)}
    count = len(boards)
    rows = tuple({"scan": scan, "sample": count + k + 1} for k, scan in enumerate(scans))
    stations = Stations(
        inverse(_ARTEFACT) @ sensor,
        columns,
        boards=boards,
        rows=rows,
        board_rows=tuple({"sample": k + 1} for k in range(count)),
    )
    make_recording(
        scene, folder, lambda done, total: progress(f"image {done} of {total}"), stations
    )
    return read_recording(folder)


def flange_columns(flange: np.ndarray, rng, sigma_mm: float = _POSE_SIGMA_MM) -> dict:
    """Columns of samples.csv of flange poses (n, 4, 4) with a random error of their position."""
    places = flange[:, :3, 3] + sigma_mm * rng.normal(size=(len(flange), 3))
    rotations = Rotation.from_matrix(flange[:, :3, :3]).as_quat(canonical=True)
    return dict(zip(_FLANGE, (*places.T.round(4), *rotations.T[[3, 0, 1, 2]].round(8))))


def _in_base() -> dict[int, np.ndarray]:
    centres = np.array(_BALLS)[:, :3] @ _ARTEFACT[:3, :3].T + _ARTEFACT[:3, 3]
    return dict(enumerate(centres, 1))


def _looking_at(middle: np.ndarray, *degrees: float) -> np.ndarray:
    """(4, 4) T_base_sensor of a sensor above a point (3,) of the artefact, tilted by angles about x, y, z."""
    rotation = _rotation(180.0, 0.0, 0.0) @ _rotation(*degrees)
    target = _ARTEFACT[:3, :3] @ middle + _ARTEFACT[:3, 3]
    translation = target - rotation @ np.array([0.0, 0.0, _AIM_MM])
    return transform(rotation, translation)


def _fixed_plane(folder: Path, progress, seed: int) -> Example:
    """A fixed light plane: the robot sweeps it over three balls, in two orientations."""
    placements = {"count": 14, "laser": 8, "range_mm": [110.0, 145.0], "tilt_deg": 35.0}
    scene = _scene(
        seed, **_fixed_laser(), placements=placements, balls=[list(ball) for ball in _BALLS]
    )
    poses, scans = [], []
    for scan, tilt in enumerate(((4.0, -3.0, 5.0), (-8.0, 6.0, -12.0)), 1):
        for x in np.arange(-13.0, 56.0, 1.5):
            poses.append(_looking_at(np.array([x, 16.0, 2.0]), *tilt))
            scans.append(scan)
    recording = _on_robot(scene, np.array(poses), scans, folder, progress)
    return Example(recording, _in_base(), HAND_EYE)


def _galvanometer(folder: Path, progress, seed: int) -> Example:
    """A galvanometer mirror, whose axis lies in its face, on a robot that stands still in each of four scans."""
    mirror = {"baseline_mm": _BASELINE_MM, "aim_mm": _AIM_MM, "offset_mm": 0.0}
    mirror |= {"tilt_deg": [0.2, -0.3], "steps": 28, "first_deg": -7.0, "last_deg": 7.0}
    placements = {"count": 14, "laser": 8, "range_mm": [110.0, 145.0], "tilt_deg": 35.0}
    scene = _scene(
        seed, mirror=mirror, placements=placements, balls=[list(ball) for ball in _BALLS]
    )
    tilts = ((4.0, -3.0, 5.0), (-8.0, 6.0, -12.0), (6.0, 9.0, 20.0), (-5.0, -9.0, 40.0))
    poses = [_looking_at(np.array([20.0, 14.0, 1.0]), *tilt) for tilt in tilts]
    recording = _on_robot(scene, np.array(poses), [1, 2, 3, 4], folder, progress)
    return Example(recording, _in_base(), HAND_EYE)


def _turntable(folder: Path, progress, seed: int) -> Example:
    """A fixed light plane before a turntable whose angle errs once a revolution, and at random."""
    step_error, jitter = 0.06, 0.004
    rng = np.random.default_rng((seed, 5))
    free = {"count": 10, "laser": 10, "range_mm": [98.0, 158.0], "tilt_deg": 35.0}
    scene = _scene(
        seed,
        **_fixed_laser(),
        placements=free,
        balls=[list(ball) for ball in _TABLE_BALLS],
    )
    poses = board_poses(scene.placements, scene.board.pattern, scene.sees, rng)
    rotation = rotation_matrix(poses[:, 3:])
    poses = transform(rotation, poses[:, :3])
    of_boards = np.arange(0.0, 360.0, 15.0)
    of_scan = np.arange(0.0, 360.0, 5.0)

    def table_poses(commanded: np.ndarray) -> np.ndarray:
        errors = step_error * np.sin(np.deg2rad(commanded) + 0.7)
        angle = np.deg2rad(commanded + errors + jitter * rng.normal(size=len(commanded)))
        return _TABLE @ transform(
            rotation_matrix(angle[:, None] * [0.0, 0.0, 1.0]), np.zeros((len(angle), 3))
        )

    middle = scene.board.pattern.middle
    lying = transform(
        _rotation(180.0, 0.0, 0.0), np.array([-middle[0] + 2.0, middle[1] - 1.0, 0.0])
    )
    boards = np.concatenate([poses, table_poses(of_boards) @ lying])
    stations = Stations(
        inverse(table_poses(of_scan)),
        {},
        boards=boards,
        rows=tuple({"scan": 1, "table_deg": float(angle)} for angle in of_scan),
        board_rows=({},) * len(poses) + tuple({"table_deg": float(angle)} for angle in of_boards),
    )
    make_recording(
        scene, folder, lambda done, total: progress(f"image {done} of {total}"), stations
    )
    start = _TABLE @ transform(
        rotation_matrix(np.deg2rad(step_error * np.sin(0.7)) * np.array([0.0, 0.0, 1.0])),
        np.zeros(3),
    )
    centres = np.array(_TABLE_BALLS)[:, :3] @ start[:3, :3].T + start[:3, 3]
    return Example(read_recording(folder), dict(enumerate(centres, 1)), None)


_RADIUS = 15.0
_SPHERE = np.array([620.0, -40.0, 210.0])


def _views_of_ball(count: int, rng, distance: float) -> np.ndarray:
    """(count, 4, 4) T_base_sensor that look at the ball from many sides."""
    tilts = Rotation.from_euler("xyz", rng.uniform(-35, 35, (count, 3)), degrees=True).as_matrix()
    rotations = _rotation(180.0, 0.0, 0.0) @ tilts
    offsets = np.stack([rng.uniform(-12, 12, count), np.zeros(count), rng.uniform(-8, 8, count)], 1)
    centres = offsets + [0.0, 0.0, distance]
    translation = _SPHERE - np.einsum("nij,nj->ni", rotations, centres)
    return transform(rotations, translation)


def _surface_recording(folder: Path, sensor, points, title: str, rng) -> Recording:
    """A ball-surface recording; points: list of (3, k) mm in the sensor frame, one a pose."""
    flange = flange_columns(sensor @ inverse(HAND_EYE), rng)
    number = np.array([part.shape[1] for part in points])
    columns = {"sample": np.arange(1.0, number.sum() + 1)}
    columns["pose"] = np.repeat(np.arange(1.0, len(points) + 1), number)
    columns["ball"] = np.ones(number.sum())
    columns |= {name: np.repeat(cells, number) for name, cells in flange.items()}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), np.concatenate(points, 1).round(5)))
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "samples.csv", columns)
    write_csv(
        folder / "artefact.csv",
        {"ball": [1], "x_mm": [0.0], "y_mm": [0.0], "z_mm": [0.0], "radius_mm": [_RADIUS]},
    )
    lines = ['format = "recording/1"', 'measures = "ball-surface"', f'title = "{title}"']
    lines += ["[samples]", 'file = "samples.csv"', "[artefact]", 'file = "artefact.csv"']
    (folder / "recording.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_recording(folder)


def _profiler(folder: Path, progress, seed: int) -> Example:
    """A laser profiler with a calibration of its own: profiles (x, z) of one ball from 24 poses."""
    rng = np.random.default_rng((seed, 6))
    sensor = _views_of_ball(24, rng, 150.0)
    offset = rng.uniform(2.0, 9.0, len(sensor)) * rng.choice([-1, 1], len(sensor))
    axes = sensor[:, :3, :3].transpose(0, 2, 1)
    sensor[:, :3, 3] += offset[:, None] * axes[:, 1]
    points = []
    for pose in sensor:
        centre = pose[:3, :3].T @ (_SPHERE - pose[:3, 3])
        circle = np.sqrt(_RADIUS**2 - centre[1] ** 2)
        angle = np.deg2rad(np.linspace(-62, 62, 180))
        radius = circle + 0.006 * rng.normal(size=len(angle))
        profile = centre[:, None] + radius * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)])
        points.append(profile * np.array([[1.0], [0.0], [1.0]]))
    recording = _surface_recording(folder, sensor, points, "laser profiler, one ball", rng)
    return Example(recording, {1: _SPHERE}, HAND_EYE)


def _camera_3d(folder: Path, progress, seed: int) -> Example:
    """A 3-D camera: clouds of one ball from 20 poses, with noise along the line of sight."""
    rng = np.random.default_rng((seed, 7))
    sensor = _views_of_ball(20, rng, 400.0)
    points = []
    for pose in sensor:
        centre = pose[:3, :3].T @ (_SPHERE - pose[:3, 3])
        tilt = np.arccos(rng.uniform(0.5, 1.0, 300))
        azimuth = rng.uniform(0, 2 * np.pi, 300)
        side = np.stack([np.cos(azimuth), np.sin(azimuth)]) * np.sin(tilt)
        cap = centre[:, None] + _RADIUS * np.stack([*side, -np.cos(tilt)])
        sight = cap / np.linalg.norm(cap, axis=0)
        points.append(cap + sight * 0.03 * rng.normal(size=len(tilt)))
    recording = _surface_recording(folder, sensor, points, "3-D camera, one ball", rng)
    return Example(recording, {1: _SPHERE}, HAND_EYE)
