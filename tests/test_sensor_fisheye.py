"""Fisheye cameras: the model of Kannala and Brandt against OpenCV, its exact inverse, calibration and files."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import Camera, camera_from_keys, camera_keys
from sensors.hand_eye.start import board_poses
from workbench.core.errors import InputError
from workbench.files.exports.camera import CAMERA_FORMATS
from workbench.jobs.sensor.chains import within_lens

BOARD = Board("chessboard", 11, 8, 10.0)
TRUE = Camera(420.0, 421.0, 640.0, 480.0, (0.03, -0.012, 0.004, -0.0008), (1280, 960))


def points_in_view(count=200):
    """(3, n) mm, up to 80 degrees from the axis."""
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (3, count))
    points[2] = rng.uniform(0.3, 2, count)
    return np.concatenate([points, [[0.0], [0.0], [1.0]]], axis=1)


def fisheye_views(seed, count=20, sigma=0.05):
    """Images of a board up to 75 degrees from the axis, with noise of the corners (px)."""
    rng = np.random.default_rng(seed)
    views = []
    while len(views) < count:
        angle, azimuth = np.deg2rad(rng.uniform(0, 55)), rng.uniform(0, 2 * np.pi)
        axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        facing = Rotation.from_rotvec(angle * axis) * Rotation.from_rotvec(rng.normal(0, 0.4, 3))
        direction = Rotation.from_rotvec(angle * axis).apply([0, 0, 1.0])
        local = facing.as_matrix() @ (BOARD.points - BOARD.middle[:, None])
        points = local + (rng.uniform(60, 160) * direction)[:, None]
        if (np.hypot(*points[:2]) > 4 * points[2]).any():
            continue
        pixels = TRUE.project(points)
        inside = (pixels > 0).all(0) & (pixels < np.array([[1279], [959]])).all(0)
        index = np.flatnonzero(inside)
        if len(index) < 30:
            continue
        noisy = pixels[:, index] + rng.normal(0, sigma, (2, len(index)))
        name = f"{len(views)}.png"
        views.append(View(name, name, index, noisy, TRUE.size, np.full(len(index), sigma)))
    return views


def test_the_model_is_that_of_opencv():
    points = points_in_view()
    zero = np.zeros(3)
    lens = TRUE.matrix, np.array(TRUE.distortion)
    expected = cv2.fisheye.projectPoints(points.T[:, None].copy(), zero, zero, *lens)[0]
    assert np.abs(TRUE.project(points) - expected[:, 0].T).max() < 1e-9


def test_the_derivatives_are_those_of_differences():
    points, step = points_in_view(), 1e-6
    _, by_point, by_value = TRUE.project_rows(points)
    for k in range(3):
        move = step * np.eye(3)[:, [k]]
        found = (TRUE.project(points + move) - TRUE.project(points - move)) / (2 * step)
        assert np.abs(found - by_point[k]).max() < 1e-6 * np.abs(by_point[k]).max()
    for k, change in enumerate(step * np.eye(8)):
        more, less = (Camera.of(TRUE.values + s * change, TRUE.size) for s in (1, -1))
        found = (more.project(points) - less.project(points)) / (2 * step)
        assert np.abs(found - by_value[k]).max() < 1e-6 * np.abs(by_value[k]).max()


def test_the_inverse_is_exact():
    points = points_in_view()
    flat = points[:2] / points[2]
    pixels = TRUE.project(points)
    assert np.abs(TRUE.normalised(pixels) - flat).max() < 1e-10
    out = np.empty(flat.shape)
    TRUE.workspace().normalised(pixels, out)
    assert np.array_equal(out, TRUE.normalised(pixels))


def test_pixels_beyond_the_hemisphere_have_no_ray():
    beyond = np.array([[640.0 + 420 * 1.7], [480.0]])
    assert np.isnan(TRUE.normalised(beyond)).all()


def test_the_truth_lies_within_the_stated_uncertainty():
    errors = []
    for seed in range(4):
        made = calibrate_camera(fisheye_views(seed), BOARD, TRUE.size, "fisheye", folds=0)
        std = np.sqrt(np.diag(made.covariance))[:8]
        errors.append((made.camera.values - TRUE.values) / std)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_held_out_error_is_the_noise_and_not_that_of_the_brown_model():
    views = fisheye_views(1)
    made = calibrate_camera(views, BOARD, TRUE.size, "fisheye")
    assert made.held_out.rms_px < 1.1 * np.sqrt(2) * 0.05
    brown = calibrate_camera(views, BOARD, TRUE.size, "brown", folds=0)
    assert brown.rms_px > 5 * made.rms_px


def test_the_board_pose_of_one_image_is_found():
    view = fisheye_views(2, 1, 0.0)[0]
    corners = BOARD.points[:, view.index]
    pose = board_poses(corners, view.pixels, np.zeros(len(view.index), int), TRUE)[0]
    placed = pose[:3, :3] @ corners + pose[:3, 3:]
    assert np.abs(TRUE.project(placed) - view.pixels).max() < 1e-3


def test_the_file_states_the_model():
    keys = camera_keys(TRUE)
    assert keys["model"] == "fisheye"
    assert camera_from_keys(keys, "camera.toml") == TRUE
    del keys["model"]
    with pytest.raises(InputError, match='4 with model = "fisheye"'):
        camera_from_keys(keys, "camera.toml")


@pytest.mark.parametrize("name", ["ros", "kalibr"])
def test_exports_name_the_equidistant_model(name):
    import yaml

    write, read = CAMERA_FORMATS[name]
    text = write(TRUE)
    assert "equidistant" in text
    assert np.allclose(read(yaml.safe_load(text)).values, TRUE.values)


def test_pixels_beyond_a_distortion_that_turns_back_are_left_out_of_a_diagnosis():
    """A polynomial that corners in the image's middle determine turns back farther out: no ray reaches beyond."""
    distortion = [0.03, -2.0, 0.0, 0.0]
    camera = Camera.of(np.array([600.0, 600.0, 320.0, 240.0, *distortion]), (640, 480))
    radii = np.arange(0.0, 320.0, 4.0)
    pixels = np.stack([320.0 + radii, np.full_like(radii, 240.0)])
    is_reached = within_lens(camera, pixels)
    has_ray = np.isfinite(camera.rays(pixels)).all(0)
    assert is_reached[radii < 100].all()
    assert not has_ray.all()
    assert not is_reached[~has_ray].any()
    last = np.flatnonzero(is_reached)[-1]
    moved = replace(camera, fx=camera.fx / 1.01, fy=camera.fy / 1.01)
    assert np.isfinite(moved.rays(pixels[:, : last + 1])).all()
