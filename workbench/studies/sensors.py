"""One run of a rendered sensor: images of balls, reconstructed with the true or a calibrated scanner; errors."""

import tempfile
from pathlib import Path

import numpy as np

import datasets
from sensors.rendering.recording import make_recording
from sensors.rendering.scene import Scene
from sensors.scanner.file import write_scanner
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError
from workbench.jobs.sensor.scan import Ball, Scans, scan
from workbench.studies.robots import Row
from workbench.studies.spec import Study, validated

BANDS_DEG = (0, 15, 30, 45, 60)
"""Limits of the bands of incidence angle (between surface and line of sight) of the form error."""


def scene_of(study: Study, seed: int) -> Scene:
    """The scene of a run; without calibration no board is rendered. Raises InputError if it is invalid."""
    scene = validated(Scene, study.scene | {"seed": seed}, "scene")
    if scene.arm or scene.mesh:
        raise InputError(
            "scene, key arm: expected only balls and a scanner in a sensor study, found an arm or a mesh; "
            "remove it"
        )
    if not scene.balls or not (scene.scans.count or scene.scans.places):
        raise InputError(
            "scene, key scans: expected scans of balls, found none; add balls and scans.count"
        )
    if "calibrate" not in study.do:
        none = scene.placements.model_copy(update={"count": 0, "places": [], "laser": 0})
        return scene.model_copy(update={"placements": none})
    return scene


def figures(study: Study, seed: int) -> Row:
    """Errors of the balls of one run. Raises InputError."""
    scene = scene_of(study, seed)
    with tempfile.TemporaryDirectory(prefix="workbench-study-") as home:
        images = Path(home) / "images"
        clouds = Path(home) / "clouds"
        images.mkdir()
        clouds.mkdir()
        recording = make_recording(scene, images)
        file = None
        if "calibrate" not in study.do:
            file = Path(home) / "scanner.toml"
            write_scanner(true_scanner(scene), file)
        found = scan(datasets.read(images), file, clouds, lambda line: None)
        return errors_of(found, recording.truth) | (
            _calibration(found, scene) if file is None else {}
        )


def true_scanner(scene: Scene) -> Scanner:
    """The true scanner of a scene."""
    instrument = scene.instrument
    return Scanner(
        scene.sees,
        instrument.steps,
        instrument.nominal_planes(),
        instrument.mirror,
        instrument.angles,
    )


def errors_of(found: Scans, truth: dict) -> Row:
    """Errors of all balls of all scans against their true centres; mm, in the camera frame.

    A ball counts as found within its radius of a true centre. `centre_x_mm` … are means over the balls,
    `centre_rms_mm` is the RMS of their 3-D distances, `sigma_mm` the RMS of their stated standard deviations.
    """
    pairs = []
    for measured_scan, true_scan in zip(found.scans, truth["scans"]):
        pairs += _pairs(measured_scan.balls, true_scan["balls"])
    row: Row = {
        "balls": sum(len(true_scan["balls"]) for true_scan in truth["scans"]),
        "balls_found": len(pairs),
    }
    if not pairs:
        raise InputError(
            f"scans of {row['balls']} balls: no ball was found ({found.scans[0].outcome}). "
            "Move the balls into the field of view"
        )
    deviations = np.array([ball.fit.centre - true for ball, true in pairs])
    row |= {f"centre_{axis}_mm": float(mean) for axis, mean in zip("xyz", deviations.mean(0))}
    row |= {
        "centre_rms_mm": float(np.sqrt((deviations**2).sum(1).mean())),
        "sigma_mm": float(np.sqrt(np.mean([_stated(found.scanner, ball) for ball, _ in pairs]))),
        "form_rms_mm": float(np.sqrt(np.mean([ball.fit.rms**2 for ball, _ in pairs]))),
        "form_d95_mm": float(np.mean([ball.fit.d95 for ball, _ in pairs])),
        "range_mean_mm": float(np.mean([np.linalg.norm(true) for _, true in pairs])),
        "points": float(np.mean([ball.fit.inliers.sum() for ball, _ in pairs])),
    }
    return row | _radii(pairs) | _by_incidence([ball for ball, _ in pairs])


def _stated(scanner: Scanner, ball: Ball) -> float:
    """mm^2: stated variance (trace) of a centre in the camera frame."""
    frame = scanner.frame_covariance(ball.fit.centre[:, None])[..., 0]
    return float(np.trace(ball.fit.covariance[:3, :3] + frame))


def _pairs(balls, true_balls):
    """Found balls, each with the nearest true centre."""
    centres = np.array([true_ball["centre_mm"] for true_ball in true_balls]).reshape(-1, 3)
    for ball in balls:
        if ball.fit and len(centres):
            distances = np.linalg.norm(centres - ball.fit.centre, axis=1)
        else:
            distances = np.array([np.inf])
        if distances.min() < ball.fit.radius:
            yield ball, centres[distances.argmin()]


def _radii(pairs) -> Row:
    """Estimated minus certified radius, mean over the balls, mm."""
    gaps = [
        ball.free.radius - ball.radius for ball, _ in pairs if ball.radius is not None and ball.free
    ]
    return {"radius_error_mm": float(np.mean(gaps))} if gaps else {}


def _by_incidence(balls: list[Ball]) -> Row:
    """RMS distance of points from the sphere, by incidence angle."""
    angles, distances = [], []
    for ball in balls:
        used = ball.fit.inliers
        outward = ball.points[:, used] - ball.fit.centre[:, None]
        to_sensor = -ball.points[:, used]
        cosine = (
            (outward * to_sensor).sum(0)
            / np.linalg.norm(outward, axis=0)
            / np.linalg.norm(to_sensor, axis=0)
        )
        angles.append(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
        distances.append(ball.fit.residual[used])
    angle = np.concatenate(angles)
    distance = np.concatenate(distances)
    row: Row = {}
    for low, high in zip(BANDS_DEG, BANDS_DEG[1:]):
        band = distance[(angle >= low) & (angle < high)]
        if band.size > 10:
            row[f"form_{low}_{high}deg_mm"] = float(np.sqrt((band**2).mean()))
        else:
            row[f"form_{low}_{high}deg_mm"] = None
    return row


def _calibration(found: Scans, scene: Scene) -> Row:
    """Results of the calibration from the boards: errors of the camera and residuals of the stripes."""
    camera, true = found.scanner.camera, scene.sees
    first = camera.values[:4]
    second = true.values[:4]
    row: Row = {
        f"{name}_error_px": float(a - b)
        for name, a, b in zip(("fx", "fy", "cx", "cy"), first, second)
    }
    return row | {"stripe_rms_px": found.calibration.calibration.sigma_stripe_px}
