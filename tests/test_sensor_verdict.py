"""A sensor result that is far above its noise is said not to be trustworthy, whether or not a tolerance is given."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from sensor_recordings import scanner_recording
from sensors.boards.detection import detect_all
from sensors.camera.calibration import calibrate_camera
from workbench.fitting.verdicts import sensor_verdict
from workbench.jobs.sensor.scanner import as_json, calibrate


def mispaired(recording):
    """The recording with the laser images of each board pose said to be of another one."""
    names = sorted({row["placement"] for row in recording.images if row["role"] == "board-laser"})
    other = dict(zip(names, names[1:] + names[:1]))
    images = tuple(
        {**row, "placement": other[row["placement"]]} if row["role"] == "board-laser" else row
        for row in recording.images
    )
    return replace(recording, images=images)


@pytest.mark.slow
def test_light_planes_from_mispaired_images_are_not_trustworthy():
    """Laser line and board pose do not belong together: the planes miss the line by many px, the verdict is no."""
    made = calibrate(mispaired(datasets.read(scanner_recording()[0])))
    found = as_json(made)
    assert found["verdict"]["pass"] is False
    assert "not trustworthy" in found["verdict"]["sentence"]
    assert any("not trustworthy" in sentence for sentence in found["warnings"])
    assert max(part["residual_over_noise"] for part in found["verdict"]["checks"]) > 5


def test_images_of_two_zooms_make_no_trustworthy_camera():
    """Every second image enlarged by 1.8: one camera cannot explain them; the same images alone are near their noise."""
    found = detect_all(datasets.read(scanner_recording()[0]))
    right = calibrate_camera(found.views, found.board, found.size, folds=0)
    assert sensor_verdict.camera_warnings(right) == []
    middle = np.array(found.size)[:, None] / 2
    mixed = [
        replace(view, pixels=middle + 1.8 * (view.pixels - middle)) if k % 2 else view
        for k, view in enumerate(found.views)
    ]
    wrong = calibrate_camera(mixed, found.board, found.size, folds=0)
    assert "not trustworthy" in " ".join(sensor_verdict.camera_warnings(wrong))
    assert sensor_verdict.camera_verdict(wrong).passed is False


@pytest.mark.parametrize("shift", [0.0, 0.3], ids=["independent", "shared"])
def test_only_errors_that_images_share_are_a_part_that_the_model_leaves_out(shift):
    """Corners err by more than their images tell: independently of one another, or by the same in all images."""
    found = detect_all(datasets.read(scanner_recording()[0]))
    random = np.random.default_rng(4)
    displaced = shift * random.normal(size=(2, found.board.points.shape[1]))
    views = [
        replace(
            view,
            pixels=view.pixels
            + random.normal(0, 0.1, view.pixels.shape)
            + displaced[:, view.index],
        )
        for view in found.views
    ]
    made = calibrate_camera(views, found.board, found.size, folds=0)
    sentence = sensor_verdict.camera_verdict(made).sentence
    assert ("corners err independently" in sentence) == (shift == 0)
    assert ("the model leaves out a part" in sentence) == (shift != 0)
