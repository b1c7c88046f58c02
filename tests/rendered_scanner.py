"""Rendered scanner after Ye: images of a scene, the complete chain on them, and the errors against the truth.

Distances of planes and balls are stated twice: in the camera's frame as it was found, and after the
rigid motion that lays the found scanner over the true one (`laid_over`). Where a camera's own frame
stands is known only to its principal point, some micrometres, and a hand-eye calibration takes it up.
"""

import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

import datasets
from sensors.boards.detection import detect_all
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import NAMES
from sensors.effects import CATALOGUE
from sensors.light.board_stripes import BoardStripes
from sensors.light.planes import tilt_directions
from sensors.rendering import Scene, make_recording, read_scene
from sensors.scanner.calibration import ScannerCalibration, calibrate_scanner
from sensors.scanner.errors import cut, laid_over
from workbench.core.rigid import nearest_rotation
from workbench.jobs.sensor import scan, scanner

SCENES = Path(__file__).resolve().parents[1] / "docs" / "scenes"
BOW = {"effect": "board-bow", "where": "artefact", "values": {"xx": 0.04, "yy": 0.02, "xy": -0.01}}
HALF_LENS = dict(width_px=640, height_px=512, fx_px=1711.5, fy_px=1710.5, cx_px=302.4, cy_px=290.0)


def ye_scene(seed: int = 2559, **changes) -> Scene:
    """Ye's instrument; changes: tables of the scene, each merged into its own."""
    return _changed(read_scene(SCENES / "ye-scanner.toml"), {"seed": seed, **changes})


def small_scene(seed: int = 1, **changes) -> Scene:
    """The same instrument with half the pixels and 24 of the planes; wider light, so that it spans as many pixels."""
    half = {
        "camera": HALF_LENS,
        "lens": {"defocus_px": 4.0},
        "mirror": {"steps": 24, "first_deg": -3.5, "last_deg": 3.5},
        "placements": {"count": 12, "laser": 8},
        "scans": {"count": 2},
    }
    return _changed(ye_scene(seed), {**half, **changes})


def _changed(scene: Scene, changes: dict) -> Scene:
    keys = scene.model_dump()
    for name, value in changes.items():
        keys[name] = {**keys[name], **value} if isinstance(value, dict) and keys[name] else value
    return Scene(**keys)


@dataclass(frozen=True)
class RenderedScanner:
    """A scene, the `run` of its calibration, its `scans`, and the truth that the images were made from."""

    scene: Scene
    truth: dict
    run: scanner.ScannerRun
    scans: scan.Scans | None

    @property
    def found(self) -> ScannerCalibration:
        return self.run.calibration

    @property
    def planes(self) -> np.ndarray:
        """(4, S) as they truly are without effects, of the steps that were calibrated."""
        return self.scene.instrument.nominal_planes()[:, self.found.scanner.steps]

    def camera_errors(self, joint: bool = False) -> dict[str, tuple[float, float]]:
        """Found less true, and the stated sigma, of each of the camera's values."""
        made = self.found if joint else self.found.start
        errors = made.camera.values - self.scene.sees.values
        return {
            name: (float(error), made.std[f"camera.{name}"]) for name, error in zip(NAMES, errors)
        }

    def plane_errors(self, free: bool = False) -> tuple[float, float]:
        """RMS mm over the working volume, of planes and of reconstructed points, laid over the truth."""
        made = self.found.free if free else self.found.made
        *_, distance, error = laid_over(
            self.scene.sees, self.planes, made.camera, made.board_stripes.planes, self.found.volume
        )
        return float(np.sqrt((distance**2).mean())), float(np.sqrt((error**2).sum(0).mean()))

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Turn (3, 3) and shift (3,) that lay the found scanner over the true one."""
        found = self.found
        points, column, _, error = laid_over(
            self.scene.sees, self.planes, found.camera, found.scanner.planes, found.volume
        )
        pixels = self.scene.sees.project(points)
        there, here = (
            cut(found.camera.normalised(pixels), found.scanner.planes[:, column]),
            points + error,
        )
        turn = nearest_rotation((here - here.mean(1)[:, None]) @ (there - there.mean(1)[:, None]).T)
        return turn, here.mean(1) - turn @ there.mean(1)

    def ball_errors(self) -> list["BallError"]:
        """Of every ball that was found, the nearest true one."""
        turn, shift = self.motion
        made = []
        for one, true in zip(self.scans.scans, self.truth["scans"]):
            for ball in one.balls:
                centres = np.array([b["centre_mm"] for b in true["balls"]])
                centre = centres[np.linalg.norm(centres - ball.fit.centre, axis=1).argmin()]
                made.append(
                    BallError(
                        ball, ball.fit.centre - centre, turn @ ball.fit.centre + shift - centre
                    )
                )
        return made

    @cached_property
    def stripes(self) -> BoardStripes:
        """The stripe points of the calibration, as `calibrate_scanner` takes them."""
        found, angles = self.found.stripes, self.scene.instrument.angles
        step = self.found.scanner.steps[found.labels["step"]]
        names = np.array(self.found.placements)[found.labels["placement"]]
        sigma = np.broadcast_to(found.sigma, (1, found.n))[0]
        return BoardStripes(
            found.pixels, names, step, sigma, mirror=angles[step], covariates=found.covariates
        )

    def again(self, rows: list[tuple[str, str, dict]]) -> ScannerCalibration:
        """Calibrated once more with effects (name, where, options) in the model; those of camera and board there first."""
        effects = [CATALOGUE[name](where, **options) for name, where, options in rows]
        start = self.found.start
        of_camera = [effect for effect in effects if effect.port in ("pixel", "ray")]
        if of_camera:
            start = calibrate_camera(
                start.views, start.board, start.camera.size, effects=of_camera, folds=0
            )
        rest = [effect for effect in effects if effect not in of_camera]
        return calibrate_scanner(
            start.views,
            self.stripes,
            start.board,
            start.camera.size,
            camera=start,
            effects=rest,
            check=False,
        )


@dataclass(frozen=True)
class BallError:
    """A ball with its centre's error (3,) mm in the camera's frame as found, and `laid` over the true one."""

    ball: scan.Ball
    raw: np.ndarray
    laid: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """(3,) independent numbers of variance one where the covariance is right."""
        values, vectors = np.linalg.eigh(self.ball.fit.covariance[:3, :3])
        return vectors.T @ self.laid / np.sqrt(values)


def render_scanner(scene: Scene, scans: bool = True) -> RenderedScanner:
    """Render a scene and run the whole chain on its images, which are gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        recording, out = Path(folder) / "recording", Path(folder) / "run"
        out.mkdir()
        truth = make_recording(scene, recording).truth
        run = scanner.calibrate(datasets.read(recording))
        scanner.save(run, out)
        made = (
            scan.scan(run.recording, out / scanner.FILE, out, lambda text: None)
            if scans and truth["scans"]
            else None
        )
    return RenderedScanner(scene, truth, run, made)


def plane_whitened(made: RenderedScanner, free: bool = False) -> np.ndarray:
    """Errors of camera and planes together, as independent numbers of variance one where the covariance is right."""
    adjustment, real = made.found.free if free else made.found.made, made.planes
    found = adjustment.board_stripes.planes
    real = real * np.sign((real[:3] * found[:3]).sum(0))
    tilts = np.einsum("kis,is->ks", tilt_directions(found), found[:3] - real[:3])
    error = np.r_[
        adjustment.camera.values - made.scene.sees.values,
        np.vstack([tilts, found[3] - real[3]]).T.ravel(),
    ]
    factor = adjustment.joint()
    size = np.sqrt((factor**2).sum(1))
    values, vectors = np.linalg.eigh((factor @ factor.T) / np.outer(size, size))
    known = values > 1e-9 * values[-1]
    return vectors[:, known].T @ (error / size) / np.sqrt(values[known])


def camera_whitened(scene: Scene) -> np.ndarray:
    """(9,) errors of a camera from images of boards alone, as independent numbers of variance one."""
    with tempfile.TemporaryDirectory() as folder:
        make_recording(scene, Path(folder))
        found = detect_all(datasets.read(Path(folder)))
    made = calibrate_camera(found.views, found.board, found.size, folds=0)
    error = made.camera.values - scene.sees.values
    place = [made.fit.table.index[f"camera.{name}"] for name in NAMES[: len(error)]]
    covariance = made.covariance[np.ix_(place, place)]
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return vectors.T @ (error / size) / np.sqrt(values)


def without_bow(made: RenderedScanner):
    """The camera of the same corners with a board that is taken to be flat."""
    start = made.found.start
    return calibrate_camera(start.views, start.board, start.camera.size, bow=False, folds=0)


def rms(values) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
