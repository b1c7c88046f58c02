"""Writes docs/gallery/rendered-scanner.md with its image: the complete chain on rendered images with known truth.

`python tools/gallery.py rendered-scanner` keeps the figures of each part as JSON and makes the missing
ones: some ten minutes in all on two cores.
"""

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from rendered_scanner import (  # noqa: E402
    BOW,
    plane_whitened,
    render_scanner,
    rms,
    small_scene,
    without_bow,
    ye_scene,
)

SEEDS = range(101, 111)
SWEPT = {"both_ways": True, "speed_deg_s": (2.0, 10.0)}
# effect, place, options, values, what else the scene needs
EFFECTS = (
    ("plane-bow", "laser", {}, {"curvature": 5e-5}, {}),
    ("mirror-wobble", "mirror", {}, {"tilt_sin1": 1e-3, "shift_cos2": 0.05}, {}),
    ("mirror-encoder-harmonic", "mirror", {"order": 60}, {"cos60": 3e-4, "sin60": 2e-4}, {}),
    ("mirror-hysteresis", "mirror", {}, {"half_gap": 3e-4}, {"mirror": SWEPT}),
    ("frame-sync", "time", {}, {"delay": 2e-3}, {"mirror": SWEPT}),
    ("subsurface-scatter", "sensor", {}, {"depth": 0.02, "shrink": 0.01}, {}),
    ("incidence-bias", "sensor", {}, {"shift": 0.02}, {}),
    ("window-refraction", "camera", {}, {"thickness": 3.0}, {}),
    ("lens-residual", "camera", {}, {"z3c0r": 0.3}, {}),
    (
        "camera-thermal-drift",
        "camera",
        {},
        {"focal": 2e-5, "x": 0.03, "y": -0.02},
        {"temperature_c": (20.0, 30.0)},
    ),
    ("board-bow", "artefact", {}, BOW["values"], {}),
    ("range-scale", "sensor", {"z0": 125.0}, {"scale": 2e-3}, {}),
)
MIRROR = {"steps": 24, "first_deg": -3.5, "last_deg": 3.5}


def whole() -> dict:
    """The scanner of Ye at full size."""
    made = render_scanner(ye_scene())
    balls, flat, start = made.ball_errors(), without_bow(made), made.found.start
    plain = {key: list(value) for key, value in made.camera_errors().items()}
    return {
        "camera": plain,
        "joint": {key: list(value) for key, value in made.camera_errors(joint=True).items()},
        "corner_px": start.rms_coordinate_px,
        "stripe_px": made.found.sigma_stripe_px,
        "bow_mm": [start.bow.parameters, start.bow.std],
        "planes_mm": made.plane_errors(),
        "free_mm": made.plane_errors(free=True),
        "stated_mm": [
            made.found.best_frame.point_mm,
            made.found.free.best_frame(made.found.volume).point_mm,
        ],
        "mirror": [bool(made.found.mirror.supported), made.found.mirror.probability],
        "raw_mm": [ball.raw.tolist() for ball in balls],
        "laid_mm": [ball.laid.tolist() for ball in balls],
        "std_mm": [ball.ball.fit.std.tolist() for ball in balls],
        "form_mm": [ball.ball.fit.rms for ball in balls],
        "d95_mm": [ball.ball.fit.d95 for ball in balls],
        "used": [int(ball.ball.fit.inliers.sum()) for ball in balls],
        "radius_mm": [ball.ball.free.radius - 14.999 for ball in balls],
        "flat": {
            "fx": flat.camera.fx - made.scene.sees.fx,
            "std": flat.std["camera.fx"],
            "px": flat.rms_coordinate_px,
        },
    }


def seed(number: int) -> dict:
    """A small rendered scanner of another seed: standardised errors."""
    made = render_scanner(small_scene(number, scans={"count": 4}))
    balls = made.ball_errors()
    return {
        "camera": [e / s for e, s in made.camera_errors().values()],
        "planes": plane_whitened(made).tolist(),
        "free": plane_whitened(made, free=True).tolist(),
        "balls": [ball.z.tolist() for ball in balls],
        "laid_mm": [ball.laid.tolist() for ball in balls],
        "planes_mm": made.plane_errors(),
    }


def effect(name: str) -> dict:
    """A small rendered scanner with one effect, without and with it in the model."""
    _, where, options, values, more = next(row for row in EFFECTS if row[0] == name)
    cause = {"effect": name, "where": where, "values": values, **options}
    causes = [cause] if name == "board-bow" else [BOW, cause]
    more = {key: {**MIRROR, **value} if key == "mirror" else value for key, value in more.items()}
    made = render_scanner(small_scene(5, effect=causes, **more))
    row = figures(made) | {"recovered": None}
    if name not in ("board-bow", "subsurface-scatter"):
        row |= recovered(made.again([(name, where, options)]), f"{where}.{name}.", values, made)
    return row


def figures(made) -> dict:
    """What shows of an effect that is not in the model."""
    balls = made.ball_errors()
    return {
        "corner_px": made.found.start.rms_coordinate_px,
        "stripe_px": made.found.sigma_stripe_px,
        "fx": made.camera_errors()["fx"],
        "points_mm": made.plane_errors()[1],
        "mirror": [bool(made.found.mirror.supported), made.found.mirror.probability],
        "ball_mm": rms([ball.laid for ball in balls]) if balls else None,
        "form_mm": rms([ball.ball.fit.rms for ball in balls]) if balls else None,
        "radius_mm": float(np.mean([ball.ball.free.radius - 14.999 for ball in balls]))
        if balls
        else None,
    }


def recovered(found, start: str, values: dict, made) -> dict:
    """Parameters with the effect in the model: found, sigma, true."""
    from sensors.scanner.errors import laid_over

    mine = [key for key in found.made.parameters.keys if key.startswith(start)]
    short = [key.removeprefix(start) for key in mine]
    known = {
        name: [float(found.made.parameters[key]), found.std.get(key), values.get(name, 0.0)]
        for name, key in zip(short, mine)
    }
    *_, error = laid_over(
        made.scene.sees, made.planes, found.camera, found.scanner.planes, found.volume
    )
    return {
        "recovered": known,
        "with_points_mm": float(np.sqrt((error**2).sum(0).mean())),
        "with_stripe_px": found.sigma_stripe_px,
        "with_corner_px": found.start.rms_coordinate_px,
        "sentences": list(found.sentences),
    }


def parts() -> dict:
    """What is to be made, by its name."""
    made = {"whole": whole, "none": lambda: figures(render_scanner(small_scene(5)))}
    made |= {f"seed-{k}": lambda k=k: seed(k) for k in SEEDS}
    return made | {row[0]: lambda name=row[0]: effect(name) for row in EFFECTS}


def collect(folder: Path) -> dict[str, dict]:
    """Figures by part; a part that `folder` already holds is read, not computed again."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, make in parts().items():
        path = folder / f"{name}.json"
        if not path.exists():
            print(name, flush=True)
            path.write_text(json.dumps(make()), encoding="utf-8")
        found[name] = json.loads(path.read_text(encoding="utf-8"))
    return found
