"""Lack of fit of stripes and asymmetry of the laser line: relevant where an effect is missing, silent for noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import datasets
from sensor_recordings import scanner_recording
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.residuals.line_dependence import LineDependence
from sensors.scanner.residuals.misfit import stripe_misfit
from sensors.scanner.residuals.rejected_points import RejectedPoints
from sensors.stripe.asymmetry import Profiles, asymmetry
from sensors.stripe.find import find_stripes
from workbench.fitting.verdicts.sensor_verdict import scanner_verdict, scanner_warnings
from workbench.jobs.sensor import scanner as scanners

NOISE = 0.04


def stripes(rng, grain=0.0, count=60, length=150):
    """Residual, stripe label and place of simulated stripes; `grain`: correlation length of the noise in rows."""
    noise = rng.normal(size=(count, length))
    if grain:
        noise = gaussian_filter1d(noise, grain, axis=1)
        noise /= noise.std()
    label = np.repeat(np.arange(count), length)
    along = np.tile(np.arange(length, dtype=float), count)
    return NOISE * noise.ravel(), label, along


def test_speckle_on_the_short_stripes_of_a_ball_is_no_lack_of_fit():
    """Grains of some rows: the polynomials take a large part of such noise, which counts as noise."""
    relevant = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        residual, label, along = stripes(rng, grain=1.5, count=8, length=40)
        relevant.append(stripe_misfit(residual, label, along).is_relevant)
    assert sum(relevant) <= 1


@pytest.mark.parametrize("grain", [0.0, 1.0, 2.0])
def test_noise_is_no_lack_of_fit(grain):
    """Independent noise and speckle of several rows: nothing is relevant in 20 recordings."""
    for seed in range(20):
        found = stripe_misfit(*stripes(np.random.default_rng(seed), grain))
        assert not found.is_relevant
        assert found.total_px < 0.5 * NOISE


@pytest.mark.parametrize("kind, degree", [("shift_px", 0), ("tilt_px", 1), ("bend_px", 2)])
def test_whole_stripes_that_are_displaced_are_lack_of_fit(kind, degree):
    """A shift, tilt or bend of each stripe by as much as the noise is found with its kind and size."""
    rng = np.random.default_rng(1)
    residual, label, along = stripes(rng)
    shape = np.polynomial.Legendre.basis(degree)(along / along.max() * 2 - 1)
    shape /= np.sqrt((shape**2).mean())
    size = 0.05 * rng.choice([-1.0, 1.0], label.max() + 1)
    found = stripe_misfit(residual + size[label] * shape, label, along)
    assert found.is_relevant
    assert getattr(found, kind) == pytest.approx(0.05, rel=0.1)
    assert found.noise_px == pytest.approx(NOISE, rel=0.05)
    assert found.as_json()["relevant"] is True


def test_too_few_stripes_are_not_tested():
    assert stripe_misfit(np.zeros(30), np.repeat([0, 1, 2], 10), np.arange(30.0)) is None


def images(second: float, seed: int = 0, frames: int = 20) -> np.ndarray:
    """Images (F, 80, 60) of a line of 1.2 px width, with a second one of height `second` at a distance of 2 px."""
    rng = np.random.default_rng(seed)
    u, v = np.arange(60.0), np.arange(80.0)
    centre = 28 + 0.03 * v[None, :, None] + rng.uniform(-2, 2, (frames, 1, 1))
    line = np.exp(-0.5 * ((u - centre) / 1.2) ** 2)
    line = line + second * np.exp(-0.5 * ((u - centre - 2.0) / 1.2) ** 2)
    grey = 10 + 150 * line
    return np.clip(grey + 2 * rng.normal(size=grey.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("along", ["rows", "columns"])
def test_a_second_line_makes_the_profile_asymmetric(along):
    """No residual shows a second line next to the first one in every image; the profile does."""
    for second, relevant in ((0.0, False), (0.015, True), (0.25, True)):
        stack = images(second)
        stack = stack.transpose(0, 2, 1).copy() if along == "columns" else stack
        found = asymmetry(Profiles.of(stack, find_stripes(stack, along)))
        assert found.is_relevant(NOISE) == relevant
        if not relevant:
            assert abs(found.ambiguity_px) < 0.25 * NOISE


def test_few_images_say_nothing_of_the_profile():
    stack = images(0.25, frames=4)
    assert asymmetry(Profiles.of(stack, find_stripes(stack))) is None


@pytest.fixture(scope="module")
def run():
    return scanners.calibrate(datasets.read(scanner_recording()[0]))


@pytest.fixture(scope="module")
def measured(run):
    """Stripes of the recording as they go into the calibration."""
    views = {view.placement: view for view in run.camera.calibration.views}
    groups: dict = {}
    for row in run.recording.images:
        if row["role"] == "board-laser":
            groups.setdefault(row["placement"], []).append(row)
    usable = [(views[name], rows) for name, rows in groups.items()]
    return scanners.board_stripes(
        run.recording, usable, run.camera.calibration.board, lambda _: None
    )


def calibrated(run, found):
    camera = run.camera.calibration
    return calibrate_scanner(
        camera.views, found, camera.board, camera.camera.size, camera=camera, check=False
    )


def test_a_clean_scanner_has_no_warning(run):
    assert scanner_warnings(run.calibration, run.misfit, run.asymmetry) == []
    assert scanner_verdict(run.calibration, (), run.misfit).passed is None
    assert scanners.as_json(run)["misfit"]["relevant"] is False
    assert scanners.as_json(run)["line_dependence"]["relevant"] is False


def test_what_displaces_the_line_where_no_residual_shows_it_is_said(run):
    clean = run.calibration
    blooming = replace(clean, dependence=LineDependence(0.2, 0.0, 0.1))
    (warning,) = scanner_warnings(blooming, run.misfit, run.asymmetry)
    assert "uncertainty is not trustworthy" in warning and "blooming" in warning
    left_out = RejectedPoints(0.2, "camera", ("u", "v"), 1e-9)
    scratched = replace(clean, rejected=left_out)
    (warning,) = scanner_warnings(scratched, run.misfit, run.asymmetry)
    assert "20 % of the points" in warning and "scratch" in warning


def test_a_doubtful_camera_does_not_hide_the_lack_of_fit_of_the_stripes(run):
    focal = replace(run.calibration.start.focal, share=0.01, shift_px=2.0, p_value=0.0)
    calibration = replace(run.calibration, start=replace(run.calibration.start, focal=focal))
    misfit = replace(run.misfit, shift_px=1.0, p_value=0.0)
    of_camera, of_stripes = scanner_warnings(calibration, misfit, run.asymmetry)
    assert "focal length differs" in of_camera and "stripes are shifted" in of_stripes


@pytest.mark.slow
def test_a_mirror_that_jitters_is_said(run, measured):
    """Each image displaced by a random shift of 0.1 px: no outlier, but the stated uncertainty is not trustworthy."""
    rng = np.random.default_rng(2)
    _, image = np.unique(
        np.stack([measured.placement, measured.step.astype(str)]), axis=1, return_inverse=True
    )
    shift = 0.1 * rng.normal(size=image.max() + 1)
    moved = replace(measured, pixels=measured.pixels + measured.scan * shift[image])
    made = calibrated(run, moved)
    misfit = scanners.misfit_of(made)
    warnings = scanner_warnings(made, misfit)
    assert any("uncertainty is not trustworthy" in sentence for sentence in warnings)
    assert "missing in the model" in warnings[0]
    assert misfit.shift_px == pytest.approx(0.1, rel=0.4)
    assert not any("uncertainty" in one for one in scanner_warnings(run.calibration, run.misfit))
