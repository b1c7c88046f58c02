"""Blind image recordings: a complete recording of a scanner from an independent ray tracer, and its truth.

`make` draws a scanner, boards and balls from a seed, plants one effect (or none) in the light, the
mirror, the lens, the board or the balls, writes the folder of a recording and returns the truth,
which is not written to the folder. No module of the workbench's physics is used.
"""

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.makers.blind_images_render import (
    Balls,
    Board,
    Camera,
    Scene,
    blurred,
    developed,
    laser,
)
from datasets.makers.blind_images_scanner import HEIGHT, WIDTH, Lens, Light, lens_of, light_of

EFFECTS = {
    "plane-bow": "laser",
    "mirror-wobble": "mirror",
    "mirror-encoder-harmonic": "mirror",
    "board-bow": "artefact",
    "lens-residual": "camera",
    "subsurface-scatter": "sensor",
    "frame-sync": "time",
}
"""Effects that can be planted, and their places."""
COLUMNS, ROWS, SQUARE = 11, 8, 8.0
_SWEEP = np.deg2rad(12.0)
_TRIES = 400
_BALLS = np.array([[0.0, 36.0, -38.0], [0.0, 6.0, -8.0], [0.0, -4.0, 5.0]])
_RADII = np.array([10.0, 13.0, 16.0])


@dataclass(frozen=True)
class World:
    """The true scanner, and what is wrong with what stands before it: `bow` (bend, across, along) of the board,
    `depth` mm that light goes into the balls."""

    lens: Lens
    light: Light
    bow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth: float = 0.0


@dataclass(frozen=True)
class Counts:
    """Numbers of board poses, scans of the balls and mirror steps."""

    boards: int = 14
    scans: int = 8
    steps: int = 20


@dataclass(frozen=True)
class Chance:
    """Chance of two kinds: of places and speeds, the same for every planted effect, and of the noise of images."""

    places: np.random.Generator
    noise: np.random.Generator


def make(
    seed: int, folder: Path, effect: str | None = None, size: float = 1.0, counts: Counts = Counts()
) -> dict:
    """Render a recording of kind scan-images into `folder`, and return its truth.

    effect: a word of `EFFECTS`, None for a flawless scanner; size: 1 is what a poor instrument might have, one that
    the images show some times over. Raises KeyError for an unknown effect.
    """
    rng = np.random.default_rng([seed, 77])
    world, detail = World(lens_of(rng), light_of(rng)), {}
    flaw = np.random.default_rng([seed, 78])
    if effect is not None:
        world, detail = _FLAWS[effect](world, flaw, size)
    rows = _images(world, Chance(rng, np.random.default_rng([seed, 79])), folder, counts)
    _write(folder, rows)
    found = (
        [] if effect is None else [{"effect": effect, "where": EFFECTS[effect], "detail": detail}]
    )
    return {
        "suite": "sensor",
        "seed": seed,
        "measures": "scan-images",
        "size": size,
        "effects": found,
    }


# ------------------------------------------------------------------- flaws


def _cone(world, rng, size):
    angle = size * rng.choice([-1, 1]) * rng.uniform(1.5e-3, 4e-3)
    return replace(world, light=replace(world.light, cone=angle)), {"cone_rad": float(angle)}


def _wobble(world, rng, size):
    """Wobble of two cycles per revolution (oval bearing); one cycle is confounded with the pose of the mirror."""
    lean, step = (
        size * rng.choice([-1, 1]) * rng.uniform(12e-3, 20e-3),
        size * rng.uniform(0.0, 0.2),
    )
    phase = rng.uniform(
        0.15, 0.85
    )  # near the other phases it is a turn of the beam and nothing else
    made = (lean, step, 2.0, phase)
    return replace(world, light=replace(world.light, wobble=made)), {
        "nod": [float(x) for x in made]
    }


def _encoder(world, rng, size):
    order = int(rng.integers(4, 25))
    amplitude = size * rng.uniform(2e-4, 4e-4) * max(1.0, (10 / order) ** 2)
    made = (amplitude, order, rng.uniform(0, 2 * np.pi))
    return replace(world, light=replace(world.light, encoder=made)), {
        "amplitude_rad": float(amplitude),
        "order": order,
    }


def _bowed(world, rng, size):
    height, half = (
        size * rng.uniform(0.03, 0.1) * rng.choice([-1, 1]),
        0.5 * SQUARE * np.hypot(COLUMNS - 1, ROWS - 1),
    )
    bend = 2 * height / half**2
    made = (bend, bend * rng.uniform(-0.5, 1.0), rng.uniform(0, np.pi))
    return replace(world, bow=made), {"height_mm": float(height), "along_rad": float(made[2])}


def _glass(world, rng, size):
    glass = rng.normal(size=6)
    glass *= size * rng.uniform(0.1, 0.25) / np.linalg.norm(glass)
    return replace(world, lens=replace(world.lens, glass=glass)), {"glass_px": glass.tolist()}


def _translucent(world, rng, size):
    depth = size * rng.uniform(0.04, 0.08)
    return replace(world, depth=depth), {"depth_mm": float(depth)}


def _late(world, rng, size):
    delay = size * rng.choice([-1, 1]) * rng.uniform(4e-4, 1.5e-3)
    return replace(world, light=replace(world.light, late=delay)), {"delay_s": float(delay)}


_FLAWS = {
    "plane-bow": _cone,
    "mirror-wobble": _wobble,
    "mirror-encoder-harmonic": _encoder,
    "board-bow": _bowed,
    "lens-residual": _glass,
    "subsurface-scatter": _translucent,
    "frame-sync": _late,
}


# ---------------------------------------------------------------- images


def _images(world: World, chance: Chance, folder: Path, counts: Counts) -> list[dict]:
    """Everything in the order in which it was taken; rows of images.csv."""
    (folder / "images").mkdir(parents=True)
    camera, rows, clock = Camera(world.lens), [], 0.0
    for k in range(1, counts.boards + 1):
        scene = Scene.of(camera, _board(world, chance.places))
        lamp = blurred(scene.lamp())
        _save(folder / f"images/board-{k:02d}.png", developed(0.7 * lamp, chance.noise))
        rows.append(
            {
                "image": f"images/board-{k:02d}.png",
                "role": "board",
                "placement": k,
                "time_s": round(clock, 3),
            }
        )
        taken, clock = _swept(
            world,
            scene,
            0.01 * lamp,
            chance,
            folder / f"images/stripe-{k:02d}",
            counts.steps,
            clock,
        )
        rows += [{"role": "board-laser", "placement": k} | row for row in taken]
    for k in range(1, counts.scans + 1):
        scene = Scene.of(camera, _balls(world, chance.places))
        lamp = blurred(scene.lamp())
        taken, clock = _swept(
            world, scene, 0.01 * lamp, chance, folder / f"images/scan-{k:02d}", counts.steps, clock
        )
        rows += [{"role": "scan", "scan": k} | row for row in taken]
    return rows


def _swept(world, scene, lamp, chance: Chance, start: Path, steps: int, clock: float):
    """Images of one sweep of the mirror, their names beginning with `start`: rows, and the clock after it."""
    way, speed = float(chance.places.choice([-1, 1])), chance.places.uniform(2.0, 8.0)
    rows, angles = [], np.linspace(-_SWEEP, _SWEEP, steps)
    interval, clock = 2 * np.rad2deg(_SWEEP) / (steps - 1) / speed, clock + 2.0
    for step, commanded in enumerate(angles):
        angle = world.light.truly(commanded, way * np.deg2rad(speed))
        stripe = 0.7 * laser(scene.stripe(world.light, angle), chance.noise)
        image = start.with_name(f"{start.name}-{step:02d}.png")
        _save(image, developed(lamp + stripe, chance.noise))
        since = step if way > 0 else steps - 1 - step
        row = {
            "mirror_deg": round(float(np.rad2deg(commanded)), 9),
            "mirror_speed_deg_s": round(way * speed, 6),
        }
        row |= {
            "image": f"images/{image.name}",
            "step": step,
            "sweep": way,
            "time_s": round(clock + interval * since, 4),
        }
        rows.append(row)
    return rows, clock + interval * steps


def _board(world: World, rng) -> Board:
    """A board somewhere in the field, all of its corners in the image."""
    middle = np.array([(COLUMNS - 1) * SQUARE / 2, (ROWS - 1) * SQUARE / 2, 0.0])
    corners = (
        np.array([[0, 0, 0], [COLUMNS - 1, 0, 0], [0, ROWS - 1, 0], [COLUMNS - 1, ROWS - 1, 0]]).T
        * SQUARE
    )
    for _ in range(_TRIES):
        rotation, place = _random_rotation(rng, 35.0), _somewhere(world, rng, 100, 155, 0.35)
        place = place - rotation @ middle
        seen = rotation @ corners + place[:, None]
        pixels = world.lens.project(seen[:2] / seen[2])
        if (pixels > 8).all() and (pixels < np.array([[WIDTH - 9], [HEIGHT - 9]])).all():
            bend, second_bend, bend_axis = world.bow
            return Board(COLUMNS, ROWS, SQUARE, rotation, place, bend, second_bend, bend_axis)
    raise ValueError("no board fits into the image")


def _balls(world: World, rng) -> Balls:
    rotation = _random_rotation(rng, 25.0)
    middle = _somewhere(world, rng, 112, 140, 0.25) - rotation @ _BALLS[:, rng.integers(3)]
    return Balls(rotation @ _BALLS + middle[:, None], _RADII, world.depth)


def _somewhere(world, rng, nearest, farthest, share) -> np.ndarray:
    pixel = np.array([WIDTH, HEIGHT]) / 2 * (1 + share * rng.uniform(-1, 1, 2))
    flat = (pixel - np.array(world.lens.centre)) / np.array(world.lens.focal)
    return np.array([*flat, 1.0]) * rng.uniform(nearest, farthest)


def _random_rotation(rng, tilt_deg) -> np.ndarray:
    """(3, 3) a roll of up to 15 degrees, then a tilt any way."""
    from scipy.spatial.transform import Rotation

    way, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(tilt_deg) * np.sqrt(rng.uniform())
    first = Rotation.from_rotvec([0, 0, np.deg2rad(rng.uniform(-15, 15))])
    return (Rotation.from_rotvec([tilt * np.cos(way), tilt * np.sin(way), 0.0]) * first).as_matrix()


# ----------------------------------------------------------------- writing


def _save(path: Path, image: np.ndarray) -> None:
    import cv2

    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


def _write(folder: Path, rows: list[Mapping]) -> None:
    """recording.toml, images.csv and artefact.csv; they do not reveal the planted effect."""
    text = [
        'format = "recording/1"',
        'title = "A scanner before boards and balls"',
        'measures = "scan-images"',
        "",
        "[images]",
        'file = "images.csv"',
        "",
        "[artefact]",
        'file = "artefact.csv"',
        "",
        "[board]",
        'kind = "chessboard"',
        f"columns = {COLUMNS}",
        f"rows = {ROWS}",
        f"square_mm = {SQUARE}",
    ]
    names = (
        "image",
        "role",
        "placement",
        "scan",
        "step",
        "mirror_deg",
        "sweep",
        "mirror_speed_deg_s",
        "time_s",
    )
    balls = [
        dict(zip(("ball", "x_mm", "y_mm", "z_mm", "radius_mm"), (k + 1, *place, radius)))
        for k, (place, radius) in enumerate(zip(_BALLS.T.tolist(), _RADII.tolist()))
    ]
    files = {
        "images.csv": _table(names, rows),
        "artefact.csv": _table(tuple(balls[0]), balls),
        "recording.toml": "\n".join(text) + "\n",
    }
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8", newline="\n")


def _table(names, rows) -> str:
    out = io.StringIO()
    writer = csv.DictWriter(out, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()
