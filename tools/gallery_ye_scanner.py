"""Figures of the scanner of Ye et al., Sensors 24, 2559, from rendered images: part of the gallery page `unified`.

A scanner is calibrated from images of boards, and measures each of the paper's four balls in 50 scans from 50 random
directions and places of its working volume. The scanner has half of the paper's pixels in each direction and 24
of its 120 light planes (`small_scene`): 5,000 images. Parts are kept as JSON, and a run goes on where an earlier one
stopped: three minutes on one core.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import datasets  # noqa: E402
from rendered_scanner import RenderedScanner, render_scanner, small_scene  # noqa: E402
from sensors.rendering import make_recording  # noqa: E402
from workbench.jobs.sensor import scan, scanner  # noqa: E402

RADII = {1: 14.999, 2: 15.002, 3: 15.001, 4: 14.998}
BLOCKS, SCANS = 5, 10  # of each ball
EDGES_UM = np.linspace(-25, 25, 51)
_CALIBRATION, _SCANNER, _ALIGNMENT = "ye-scanner", "ye-scanner.toml", "alignment"


def collect(folder: Path) -> dict:
    """`scanner`: figures of its calibration; `balls`: number -> figures of 50 scans, a list a figure."""
    folder.mkdir(parents=True, exist_ok=True)
    calibrated = _kept(folder, _CALIBRATION, lambda: _calibrate(folder))
    balls = {}
    for ball in RADII:
        blocks = [_block(folder, calibrated, ball, block) for block in range(1, BLOCKS + 1)]
        balls[ball] = {key: sum((block[key] for block in blocks), []) for key in blocks[0]}
    return {"scanner": calibrated, "balls": balls}


def _block(folder: Path, calibrated: dict, ball: int, block: int) -> dict:
    name = f"ye-ball-{ball}-{block}"
    return _kept(folder, name, lambda: _measure(folder, calibrated, ball, block))


def _kept(folder: Path, name: str, make) -> dict:
    """A part that the folder holds, or a new one, which it holds then."""
    path = folder / f"{name}.json"
    if not path.exists():
        print(name, flush=True)
        path.write_text(json.dumps(make()), encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def _calibrate(folder: Path) -> dict:
    made: RenderedScanner = render_scanner(small_scene(2559, scans={"count": 0}), scans=False)
    with tempfile.TemporaryDirectory() as name:
        scanner.save(made.run, Path(name))
        text = (Path(name) / scanner.FILE).read_text(encoding="utf-8")
    (folder / _SCANNER).write_text(text, encoding="utf-8")
    rotation, shift = made.motion
    planes, points = made.plane_errors()
    return {
        "corner_px": made.found.start.rms_coordinate_px,
        "stripe_px": made.found.sigma_stripe_px,
        "planes_mm": planes,
        "points_mm": points,
        _ALIGNMENT: [rotation.tolist(), shift.tolist()],
    }


def _measure(folder: Path, calibrated: dict, ball: int, block: int) -> dict:
    """Ten scans of a ball: errors of its centre after alignment of the scanner (mm), their std, and its form."""
    radius = RADII[ball]
    scene = small_scene(
        10 * ball + block,
        balls=[[0.0, 0.0, 0.0, radius]],
        scans={"count": SCANS},
        placements={"count": 1, "laser": 0},
    )
    with tempfile.TemporaryDirectory() as name:
        recording, out = Path(name) / "recording", Path(name) / "run"
        out.mkdir()
        truth = make_recording(scene, recording).truth
        scans = scan.scan(datasets.read(recording), folder / _SCANNER, out, lambda text: None)
        found = [one.balls for one in scans.scans]
    if [len(balls) for balls in found] != [1] * SCANS:
        raise ValueError(f"ball {ball}, block {block}: expected one ball in each of {SCANS} scans")
    rotation, shift = (np.array(part) for part in calibrated[_ALIGNMENT])
    true = [one["balls"][0]["centre_mm"] for one in truth["scans"]]
    fits = [balls[0].fit for balls in found]
    laid = [rotation @ fit.centre + shift - centre for fit, centre in zip(fits, true)]
    distances = [fit.residual[fit.inliers] for fit in fits]
    return {
        "error_mm": [error.tolist() for error in laid],
        "centre_mm": true,
        "std_mm": [fit.std[:3].tolist() for fit in fits],
        "form_mm": [float(fit.rms) for fit in fits],
        "mean_mm": [float(one.mean()) for one in distances],
        "histogram": [np.histogram(1e3 * one, EDGES_UM)[0].tolist() for one in distances],
    }


def deviations(balls: dict) -> np.ndarray:
    """(4, 4) um, a ball a row: standard deviation of its centre in x, y, z and in space (root sum of squares)."""
    errors = np.array([rows["error_mm"] for rows in balls.values()])
    axes = 1e3 * errors.std(1, ddof=1)
    return np.column_stack([axes, np.sqrt((axes**2).sum(1))])
