"""Poses in one file each: rotations and positions apart, folders with different numbers, profiles of a FileStorage."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources.clouds import is_profile, read_cloud
from target_scenes import target_scene
from workbench.jobs.sensor.hand_eye import calibrate
from workbench.recordings.importing import ImportOptions, import_recording


def _write(folder, name, numbers, arrays, **options):
    folder.mkdir(parents=True, exist_ok=True)
    for number, array in zip(numbers, arrays):
        np.savetxt(folder / f"{name}{number}.txt", array, fmt="%.9f", **options)


def _check(path, sensor, tmp_path, n):
    made = import_recording([path], tmp_path / "made", ImportOptions())
    assert made.recording.measures == "target-pose" and made.recording.n == n
    run = calibrate(made.recording, None, None, lambda text: None)
    error = np.linalg.norm(run.made.sensor[:3, 3] - sensor[:3, 3])
    assert error < 5 * np.sqrt(np.trace(run.made.covariance[:3, :3]))
    return made


def test_rotations_and_positions_in_folders_of_their_own(tmp_path):
    flange, seen, sensor = target_scene(21)
    numbers = range(1, len(flange) + 1)
    folder = tmp_path / "poses"
    comment = {"header": "rotation or position", "delimiter": ","}
    for name, poses, known in (
        ("g2b", flange, numbers),
        ("t2c", seen, [k for k in numbers if k != 6]),
    ):
        of_files = poses[[k - 1 for k in known]]
        _write(folder / f"R{name}", "array_", known, of_files[:, :3, :3], **comment)
        _write(folder / f"P{name}", "array_", known, of_files[:, :3, 3:] / 1000, **comment)
    made = _check(folder, sensor, tmp_path, len(flange) - 1)
    assert any("1 of 14 rows (array_6) have no row" in text for text in made.warnings)


@pytest.mark.parametrize("is_as_long", (False, True))
def test_two_folders_with_different_numbers_are_joined_by_these(tmp_path, is_as_long):
    flange, seen, sensor = target_scene(22)
    numbers = list(range(1, len(flange) + 1))
    of_marker = [k for k in numbers if k not in (3, 9)]
    of_robot = [k for k in numbers if k not in (5, 12)] if is_as_long else numbers
    for name, poses, known in (("robot", flange, of_robot), ("marker", seen, of_marker)):
        _write(tmp_path / "poses" / name, "", known, poses[[k - 1 for k in known]])
    common = len(set(of_robot) & set(of_marker))
    made = _check(tmp_path / "poses", sensor, tmp_path, common)
    assert any("(3, 9) have no row of the same name in marker" in text for text in made.warnings)


def test_numbers_from_different_starts_are_joined_by_their_order(tmp_path):
    flange, seen, sensor = target_scene(23)
    _write(tmp_path / "poses" / "robot", "", range(len(flange)), flange)
    _write(tmp_path / "poses" / "marker", "", range(1, len(seen) + 1), seen)
    _check(tmp_path / "poses", sensor, tmp_path, len(flange))


def _storage(path, values):
    cells = ", ".join("0." if value == 0 else f"{value:.12e}" for value in values)
    path.write_text(f"%YAML:1.0\n---\nprofile: [ {cells} ]\n", encoding="utf-8")


def _profiles_of_a_ball(folder, radius, rng):
    """Flange poses and profiles p1.yml, ... of a ball; the transform from the sensor to the flange."""
    sensor = np.eye(4)
    sensor[:3, :3] = Rotation.from_euler("xyz", [2, -1, 92], degrees=True).as_matrix()
    sensor[:3, 3] = 30, -60, 45
    folder.mkdir()
    poses = []
    for number in range(1, 13):
        turned = Rotation.from_rotvec(rng.normal(0, 0.35, 3)).as_matrix()
        offset = rng.uniform(-10, 10)
        centre = np.array([50 + rng.uniform(-8, 8), offset, rng.uniform(-10, 10)])
        scan = np.eye(4)
        scan[:3, :3] = turned @ np.diag([1.0, -1, -1])
        scan[:3, 3] = [700, 100, 200] - scan[:3, :3] @ centre
        poses.append(scan @ np.linalg.inv(sensor))
        section = np.sqrt(radius**2 - offset**2)
        x = np.arange(centre[0] - 0.9 * section, centre[0] + 0.9 * section, 0.2)
        z = centre[2] + np.sqrt(section**2 - (x - centre[0]) ** 2) + rng.normal(0, 0.01, len(x))
        _storage(folder / f"p{number}.yml", np.stack([x, 0 * x, z], axis=1).ravel())
    return np.array(poses), sensor


def test_profiles_in_files_of_a_file_storage(tmp_path):
    poses, sensor = _profiles_of_a_ball(tmp_path / "scans", 25.0, np.random.default_rng(1))
    turned = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    np.savetxt(
        tmp_path / "poses.csv",
        np.c_[np.arange(1, 13), poses[:, :3, 3], turned],
        delimiter=",",
        header="pose,x,y,z,qx,qy,qz,qw",
        comments="",
    )
    options = ImportOptions(ball_radius_mm=25.0)
    paths = [tmp_path / "scans", tmp_path / "poses.csv"]
    recording = import_recording(paths, tmp_path / "made", options).recording
    assert recording.measures == "ball-surface" and np.all(recording.columns["y_mm"] == 0)
    run = calibrate(recording, None, None, lambda text: None)
    np.testing.assert_allclose(run.made.sensor[:3, 3], sensor[:3, 3], atol=0.05)


def test_other_files_of_a_file_storage_are_no_profiles(tmp_path):
    path = tmp_path / "p1.yml"
    _storage(path, np.stack([np.arange(30), 0 * np.arange(30), 3 + np.arange(30)], axis=1).ravel())
    assert is_profile(path)
    np.testing.assert_allclose(read_cloud(path, 100)[:, 2], 3 + np.arange(30))
    for values in (np.arange(90.0) + 1, np.tile([1.0, 0, 2], 5)):  # y is not 0; too few points
        _storage(path, values)
        assert not is_profile(path)
