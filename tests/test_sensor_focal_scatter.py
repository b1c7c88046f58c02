"""A focal length that differs from board pose to board pose is said; a constant one and a poor lens model are not."""

from dataclasses import replace

import numpy as np
import pytest

import sensor_virtual
from sensors.boards.board import Board
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import Camera
from sensors.effects.optics import FocusBreathing, LensResidual
from simulated_images import simulated
from test_sensor_camera_doubts import seen_by
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.scanner.random_focal_length import find_random_focal_length
from workbench.diagnosis.search.select import find
from workbench.explanation.sensor_errors import (
    image_terms,
    random_focal_error,
    with_random_errors,
)
from workbench.explanation.sentences.statements import statement
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


@pytest.mark.parametrize("share", [5e-4, 2e-3])
def test_a_random_focal_length_is_a_finding_with_its_size(share):
    bench = zoomed(share)
    found = find_random_focal_length(bench)
    true = share * np.random.default_rng(6).normal(size=len(bench.chains.corners.poses)).std(ddof=1)
    assert found.finding.effect == "focus-breathing" and found.finding.where == "camera"
    assert found.probability > 0.99
    assert found.scatter.share == pytest.approx(true, abs=3 * found.scatter.share_std)
    assert found.scatter.share_std < 0.5 * found.scatter.share


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (FocusBreathing("camera", 125.0), {"camera.focus-breathing.slope": 2e-5}),
        (LensResidual("camera", 4), {"camera.lens-residual.z3c1r": 0.4}),
    ],
)
def test_a_law_of_the_camera_is_no_random_focal_length(effect, values):
    chains = simulated(sensor_virtual.chains(), (effect,), values, 7)
    assert find_random_focal_length(sensor.SensorBench(chains)) is None


def test_a_search_next_to_a_random_focal_length_accepts_no_law_for_it():
    bench, _ = with_random_errors(zoomed(2e-3), lambda bench: find(bench))
    problem = bench.problem(())
    plain = zoomed(2e-3).problem(())

    def lack_of_fit(problem):
        return float((problem.orthogonalise(problem.residual) ** 2).mean())

    assert lack_of_fit(plain) > 1.5
    assert lack_of_fit(problem) == pytest.approx(1.0, abs=0.15)
    [term] = image_terms(bench, (), problem)
    assert "differs at random from image to image by 0.2" in statement(term, "the ball", "px")
