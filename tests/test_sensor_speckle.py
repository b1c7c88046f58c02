"""Coarse speckle on rendered balls, scanned with the true scanner: centres and radii are not biased."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

import datasets
from sensors.rendering import Scene, make_recording
from sensors.scanner.file import write_scanner
from sensors.scanner.model import Scanner
from workbench.jobs.sensor.scan import scan

RADIUS = 20.0


def scene(grain_px: float, contrast: float, scans: int) -> Scene:
    """A scanner of 16 light planes before balls of 20 mm radius."""
    return Scene(
        seed=71,
        camera={
            "width_px": 480,
            "height_px": 360,
            "fx_px": 760.0,
            "fy_px": 761.0,
            "cx_px": 243.0,
            "cy_px": 176.0,
            "distortion": [-0.14, 0.11, 0.0004, -0.0006, 0.0],
        },
        lens={"blur_px": 0.65, "focus_mm": 210.0, "defocus_px": 3.0},
        laser={
            "width_mm": 0.18,
            "peak": 0.6,
            "speckle_contrast": contrast,
            "speckle_grain_px": grain_px,
        },
        mirror={
            "baseline_mm": 80.0,
            "aim_mm": 210.0,
            "steps": 16,
            "first_deg": -2.6,
            "last_deg": 2.6,
        },
        balls=[[0.0, 0.0, 0.0, RADIUS]],
        placements={"count": 1, "laser": 0},
        scans={"count": scans, "range_mm": (200.0, 225.0), "aside": 0.15, "tilt_deg": 8.0},
    )


def scanned(folder: Path, made: Scene):
    """Errors of centres over their stated uncertainty, errors of free radii (mm) and their stated uncertainty."""
    truth = make_recording(made, folder / "recording").truth
    instrument = made.instrument
    true = Scanner(
        instrument.camera,
        instrument.steps,
        instrument.nominal_planes(),
        instrument.mirror,
        instrument.angles,
        sigma_px=0.01,
    )
    write_scanner(true, folder / "scanner.toml")
    (folder / "out").mkdir()
    found = scan(
        datasets.read(folder / "recording"),
        folder / "scanner.toml",
        folder / "out",
        lambda text: None,
    )
    balls = [one.balls[0] for one in found.scans]
    centres = [one["balls"][0]["centre_mm"] for one in truth["scans"]]
    away = np.array([ball.fit.centre for ball in balls]) - np.array(centres)
    whitened = [
        np.linalg.solve(np.linalg.cholesky(ball.fit.covariance[:3, :3]), error)
        for ball, error in zip(balls, away)
    ]
    radii = np.array([ball.free.radius for ball in balls]) - RADIUS
    std = np.array([ball.free.std[-1] for ball in balls])
    return np.array(whitened), away, radii, std


@pytest.mark.parametrize("grain_px", [pytest.param(0.6, marks=pytest.mark.slow), 1.5])
def test_coarse_speckle_moves_balls_neither_outwards_nor_all_one_way(tmp_path, grain_px):
    whitened, away, radii, std = scanned(tmp_path, scene(grain_px, 0.25, 10))
    assert len(whitened) == 10
    mean_radius = np.average(radii, weights=std**-2)
    assert abs(mean_radius) < 3 / np.sqrt((std**-2).sum())
    assert np.abs(whitened.mean(0) * np.sqrt(10)).max() < 3.3
    assert 0.5 < (whitened**2).mean() < 1.8


def test_without_speckle_the_radius_is_right_to_a_micrometre(tmp_path):
    _, _, radii, _ = scanned(tmp_path, scene(0.6, 0.0, 6))
    assert abs(radii.mean()) < 2e-3
