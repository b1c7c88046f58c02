"""One run of a rendered sensor: images of balls, reconstructed with the true or a calibrated scanner, and its
errors."""

import tempfile
from pathlib import Path

import numpy as np

import datasets
from sensors.rendering.recording import make_recording
from sensors.rendering.scene import Scene
from sensors.scanner.file import write_scanner
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError
from workbench.jobs.scan import Ball, Scans, scan
from workbench.study.robots import Row
from workbench.study.spec import Study, validated

BANDS_DEG = (0, 15, 30, 45, 60)
"""Angles between surface and line of sight between which the form error is told apart."""


def scene_of(study: Study, seed: int) -> Scene:
    """The scene of a run; without calibration no board is rendered. InputError where it cannot be."""
    scene = validated(Scene, study.scene | {"seed": seed}, "scene")
    if scene.arm or scene.mesh:
        raise InputError(
            "scene, key arm: expected balls before a scanner alone in a sensor study, found an arm or "
            "a mesh; take it out"
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
        images, clouds = Path(home) / "images", Path(home) / "clouds"
        images.mkdir()
        clouds.mkdir()
        made = make_recording(scene, images)
        file = None
        if "calibrate" not in study.do:
            file = Path(home) / "scanner.toml"
            write_scanner(true_scanner(scene), file)
        found = scan(datasets.read(images), file, clouds, lambda line: None)
        return errors_of(found, made.truth, scene) | (
            _calibration(found, scene) if file is None else {}
        )


def true_scanner(scene: Scene) -> Scanner:
    """The scanner that the images of a scene are made with, exactly known."""
    instrument = scene.instrument
    return Scanner(
        scene.sees,
        instrument.steps,
        instrument.nominal_planes(),
        instrument.mirror,
        instrument.angles,
    )


def errors_of(found: Scans, truth: dict, scene: Scene) -> Row:
    """Errors of all balls of all scans against where they truly were; mm, in the camera's frame.

    A ball counts that is found within its radius of a true one. `centre_x_mm` … are means over the balls,
    `centre_rms_mm` is the RMS of their 3-D distances, `sigma_mm` the RMS of what was stated for them.
    """
    pairs = [
        pair
        for one, told in zip(found.scans, truth["scans"])
        for pair in _pairs(one.balls, told["balls"])
    ]
    row: Row = {
        "balls": sum(len(told["balls"]) for told in truth["scans"]),
        "balls_found": len(pairs),
    }
    if not pairs:
        raise InputError(
            f"scans of {row['balls']} balls: expected some of them to be found, found none "
            f"({found.scans[0].outcome}); bring them into view"
        )
    away = np.array([ball.fit.centre - true for ball, true in pairs])
    row |= {f"centre_{axis}_mm": float(mean) for axis, mean in zip("xyz", away.mean(0))}
    row |= {
        "centre_rms_mm": float(np.sqrt((away**2).sum(1).mean())),
        "sigma_mm": float(np.sqrt(np.mean([_stated(found.scanner, ball) for ball, _ in pairs]))),
        "form_rms_mm": float(np.sqrt(np.mean([ball.fit.rms**2 for ball, _ in pairs]))),
        "form_d95_mm": float(np.mean([ball.fit.d95 for ball, _ in pairs])),
        "range_mean_mm": float(np.mean([np.linalg.norm(true) for _, true in pairs])),
        "points": float(np.mean([ball.fit.inliers.sum() for ball, _ in pairs])),
    }
    return row | _radii(pairs) | _by_incidence([ball for ball, _ in pairs])


def _stated(scanner: Scanner, ball: Ball) -> float:
    """mm^2, variance of a centre's 3-D place in the camera's frame, as far as it is stated."""
    frame = scanner.frame_covariance(ball.fit.centre[:, None])[..., 0]
    return float(np.trace(ball.fit.covariance[:3, :3] + frame))


def _pairs(balls, told):
    """Found balls with the true centre that each is nearest to."""
    centres = np.array([one["centre_mm"] for one in told]).reshape(-1, 3)
    for ball in balls:
        away = (
            np.linalg.norm(centres - ball.fit.centre, axis=1)
            if ball.fit and len(centres)
            else np.array([np.inf])
        )
        if away.min() < ball.fit.radius:
            yield ball, centres[away.argmin()]


def _radii(pairs) -> Row:
    """How much larger balls look than they are certified, mean over the balls, mm."""
    gaps = [
        ball.free.radius - ball.radius for ball, _ in pairs if ball.radius is not None and ball.free
    ]
    return {"radius_error_mm": float(np.mean(gaps))} if gaps else {}


def _by_incidence(balls: list[Ball]) -> Row:
    """RMS distance of points from their ball, by the angle between its surface and the line of sight."""
    angles, distances = [], []
    for ball in balls:
        used = ball.fit.inliers
        outward = ball.points[:, used] - ball.fit.centre[:, None]
        back = -ball.points[:, used]
        cosine = (
            (outward * back).sum(0) / np.linalg.norm(outward, axis=0) / np.linalg.norm(back, axis=0)
        )
        angles.append(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
        distances.append(ball.fit.residual[used])
    angle, distance = np.concatenate(angles), np.concatenate(distances)
    row: Row = {}
    for low, high in zip(BANDS_DEG, BANDS_DEG[1:]):
        band = distance[(angle >= low) & (angle < high)]
        row[f"form_{low}_{high}deg_mm"] = (
            float(np.sqrt((band**2).mean())) if band.size > 10 else None
        )
    return row


def _calibration(found: Scans, scene: Scene) -> Row:
    """What the calibration from the boards found: the camera's errors and the residuals of stripes on the boards."""
    camera, true = found.scanner.camera, scene.sees
    first, second = camera.values[:4], true.values[:4]
    row: Row = {
        f"{name}_error_px": float(a - b)
        for name, a, b in zip(("fx", "fy", "cx", "cy"), first, second)
    }
    return row | {"stripe_rms_px": found.calibration.calibration.sigma_stripe_px}
