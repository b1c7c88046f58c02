"""A mirror step that no board saw gets its light plane from the mirror that fits all others."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from sensor_recordings import scanner_recording
from sensors.scanner.unseen_steps import with_unseen_steps
from workbench.jobs.sensor import scanner as scanners

UNSEEN = 4


@pytest.fixture(scope="module")
def run():
    """A calibration without the laser images of one step on any board; the scans still use it."""
    recording = datasets.read(scanner_recording()[0])
    kept = tuple(
        row
        for row in recording.images
        if not (row["role"] == "board-laser" and int(row["step"]) == UNSEEN)
    )
    return scanners.calibrate(replace(recording, images=kept))


def test_the_plane_of_an_unseen_step_is_the_true_one(run):
    assert UNSEEN not in run.calibration.scanner.steps
    assert UNSEEN in run.scanner.steps
    whole = scanners.calibrate(datasets.read(scanner_recording()[0])).scanner
    points = np.stack([np.linspace(-20, 20, 9), np.linspace(-15, 15, 9), np.linspace(115, 138, 9)])
    found = run.scanner.planes[:, run.scanner.places(np.array([UNSEEN]))[0]]
    expected = whole.planes[:, whole.places(np.array([UNSEEN]))[0]]
    difference = (found[:3] - expected[:3]) @ points + found[3] - expected[3]
    assert np.abs(difference).max() < 0.03


def test_the_sentence_names_the_step_and_the_covariance_covers_it(run):
    said = " ".join(scanners.as_json(run)["sentences"])
    assert f"no board saw have the planes that the mirror gives them: {UNSEEN}" in said
    count = 3 * len(run.scanner.steps)
    assert run.scanner.covariance.shape == (count, count)
    assert (np.diag(run.scanner.covariance) > 0).all()


def test_steps_far_beyond_the_sweep_have_no_plane(run):
    angles = run.calibration.scanner.angles
    far = float(angles.max() + np.ptp(angles))
    scanner, added = with_unseen_steps(run.calibration, {99: far})
    assert added == () and scanner is run.calibration.scanner
