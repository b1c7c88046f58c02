"""A focal length that differs from board pose to board pose is said; a constant one and a poor lens model are not."""

from dataclasses import replace

import numpy as np
import pytest

import sensor_virtual
from sensors.boards.board import Board
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import Camera
from test_sensor_camera_doubts import seen_by
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.scanner.sensor_simulate import simulated
from workbench.explanation.sensor_errors import random_focal_error
from workbench.fitting.verdicts.sensor_verdict import camera_warnings
from workbench.jobs.sensor.camera import focal_json

BOARD = Board("chessboard", 11, 8, 5.0)
TRUE = Camera(1500.0, 1499.0, 640.0, 512.0, (-0.1, 0.06, 0.0, 0.0, 0.0), (1280, 1024))


def calibrated(share: float, seed: int):
    """A camera whose focal length changes by a random `share` (1 sigma) from board pose to board pose."""
    rng = np.random.default_rng(seed)

    def project(points):
        zoom = 1 + share * rng.normal()
        middle = np.array([[TRUE.cx], [TRUE.cy]])
        return middle + zoom * (TRUE.project(points) - middle)

    views = seen_by(project, rng, BOARD, count=16, near=(110, 170), across=(20, 15))
    return calibrate_camera(views, BOARD, TRUE.size, folds=0)


@pytest.mark.parametrize("seed", [11, 12])
def test_a_focal_length_that_changes_is_said_with_its_size(seed):
    made = calibrated(2e-3, seed)
    assert made.focal.significant
    assert made.focal.share == pytest.approx(2e-3, rel=0.5)
    assert any("differs from board pose to board pose" in one for one in made.remarks)
    assert any("uncertainty is not trustworthy" in one for one in camera_warnings(made))
    assert focal_json(made.focal)["significant"] is True


def test_a_constant_focal_length_is_silent():
    p_values = []
    for seed in range(20):
        made = calibrated(0.0, 100 + seed)
        assert not made.focal.significant and camera_warnings(made) == []
        p_values.append(made.focal.p_value)
    assert min(p_values) > 1e-3 and max(p_values) > 0.5


def test_three_board_poses_are_not_tested():
    rng = np.random.default_rng(3)
    views = seen_by(TRUE.project, rng, BOARD, count=3, near=(110, 170), across=(20, 15))
    assert calibrate_camera(views, BOARD, TRUE.size, folds=0).focal is None


def zoomed(share: float) -> sensor.SensorBench:
    """A bench of a scanner whose corners are seen with a focal length of their own in each board pose."""
    chains = simulated(sensor_virtual.chains(), (), {}, 5)
    corners = chains.corners
    zoom = 1 + share * np.random.default_rng(6).normal(size=len(corners.poses))
    middle = np.array([[corners.camera.cx], [corners.camera.cy]])
    pixels = middle + zoom[corners.labels["placement"]] * (corners.pixels - middle)
    return sensor.SensorBench(replace(chains, corners=replace(corners, pixels=pixels)))


def test_the_diagnosis_of_a_scanner_says_it():
    assert "differs from board pose to board pose" in random_focal_error(zoomed(2e-3), ())
    assert random_focal_error(zoomed(0.0), ()) == ""
