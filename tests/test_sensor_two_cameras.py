"""Images of two cameras, and mirrored images among others, are named; a random focal length is not taken for them."""

from dataclasses import replace

import numpy as np
import pytest

from sensors.boards.board import Board
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import Camera
from test_sensor_camera_doubts import seen_by
from workbench.fitting.verdicts.sensor_verdict import camera_warnings

BOARD = Board("chessboard", 11, 8, 5.0)
SIZE = (1280, 1024)
FIRST = Camera(1500.0, 1499.0, 605.0, 515.0, (-0.1, 0.06, 0.001, -0.0005, 0.0), SIZE)
SECOND = Camera(1560.0, 1558.0, 655.0, 500.0, (-0.12, 0.08, 0.0, 0.0, 0.0), SIZE)


def mirrored(points):
    """Images of the first camera, exchanged left and right, of a board that is mirrored, too."""
    reflection = np.array([[-1.0], [1.0], [1.0]])
    pixels = FIRST.project(points * reflection)
    return np.stack([SIZE[0] - 1 - pixels[0], pixels[1]])


def calibrated(other, seed: int, others=(3, 7, 8, 12)):
    """A camera of 16 images, some of which `other` projects."""
    rng = np.random.default_rng(seed)
    count = iter(range(100))

    def project(points):
        return other(points) if next(count) in others else FIRST.project(points)

    views = seen_by(project, rng, BOARD, count=16, near=(110, 170), across=(20, 15))
    views = [replace(view, image=f"{k}.png") for k, view in enumerate(views)]
    return calibrate_camera(views, BOARD, SIZE, folds=0)


@pytest.mark.parametrize("seed", [1, 2])
def test_images_of_another_camera_are_named(seed):
    found = calibrated(SECOND.project, seed)
    two = found.two_cameras
    assert two.images == ("3.png", "7.png", "8.png", "12.png")
    assert two.cameras[1].fx == pytest.approx(1560.0, abs=3) and not two.are_mirrored
    (warning,) = camera_warnings(found)
    assert "not of one camera" in warning and "3.png" in warning and "breathes" not in warning


@pytest.mark.parametrize("seed", [3, 4])
def test_mirrored_images_are_named(seed):
    two = calibrated(mirrored, seed).two_cameras
    assert two.images == ("3.png", "7.png", "8.png", "12.png") and two.are_mirrored
    assert "mirror images" in two.sentence


@pytest.mark.parametrize("seed", range(6))
def test_a_focal_length_that_changes_at_random_is_no_second_camera(seed):
    rng = np.random.default_rng(50 + seed)

    def zoomed(points):
        middle = np.array([[FIRST.cx], [FIRST.cy]])
        return middle + (1 + 2e-3 * rng.normal()) * (FIRST.project(points) - middle)

    found = calibrated(zoomed, seed, others=range(16))
    assert found.focal.significant and found.two_cameras is None


def test_boards_in_the_middle_of_the_image_leave_the_lens_undetermined_outside():
    rng = np.random.default_rng(5)
    views = seen_by(FIRST.project, rng, BOARD, count=16, near=(330, 400), across=(5, 5))
    found = calibrate_camera(views, BOARD, SIZE, folds=0)
    (note,) = [one for one in found.notes if "extrapolated" in one]
    worst = np.nanmax(found.uncertainty.value)
    assert worst > 1 and f"{worst:.2g} px at its worst place" in note
