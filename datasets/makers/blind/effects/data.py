"""Effects on the data: outliers, heteroscedastic noise, mistaken units and frames."""

import numpy as np

from datasets.makers.blind.effects.planted import PlantedEffect
from datasets.makers.blind.world import Perturbation


def outliers(rng, world):
    """Outliers: a few samples off by 8 to 25 sigma in random directions, as from an interrupted beam."""
    count = int(rng.integers(2, max(3, world.n // 50) + 1))
    rows = rng.choice(world.n, count, replace=False)
    way = rng.normal(0, 1, (count, 3))
    displacement = np.zeros((world.n, 3))
    displacement[rows] = (
        way
        / np.linalg.norm(way, axis=1, keepdims=True)
        * rng.uniform(8, 25, (count, 1))
        * world.sigma
    )
    detail = {"samples": sorted(int(r) + 1 for r in rows)}
    return PlantedEffect(
        "outliers",
        "samples",
        lambda s: Perturbation(sensed=s * displacement),
        1.0,
        1.0,
        "1",
        detail,
        fixed=True,
    )


def noise_heteroscedastic(rng, world):
    """Noise whose standard deviation grows with a recorded covariate."""
    able = [
        name
        for name in ("temperature_c", "payload_kg", "time_s")
        if np.ptp(world.covariates.get(name, 0.0)) > 0
    ]
    if not able:
        return None
    name = str(rng.choice(able))
    by = world.covariates[name]
    by = (by - by.mean()) / by.std()
    size = rng.uniform(0.35, 0.9)
    return PlantedEffect(
        "noise-heteroscedastic",
        "noise",
        lambda s: Perturbation(spread=s * by),
        size,
        size,
        "1",
        {"covariate": name},
        fixed=True,
    )


def unit_or_frame(rng, world):
    """A mistake of units or frames in the file; `garbled` applies it."""
    kind = str(rng.choice(["axis-flipped", "joints-permuted", "joint-sign", "rows-shifted"]))
    joint = int(rng.integers(1, world.joints - 1))
    detail = {"kind": kind, "axis": str(rng.choice(["x_mm", "y_mm", "z_mm"])), "joint": joint + 1}
    return PlantedEffect(
        "unit-or-frame", "samples", lambda s: Perturbation(), 1.0, 1.0, "1", detail, fixed=True
    )


def garbled(columns: dict, detail) -> dict:
    """The columns of samples.csv with the mistake of `unit_or_frame` in them."""
    out, k = dict(columns), detail["joint"]
    if detail["kind"] == "axis-flipped":
        out[detail["axis"]] = -out[detail["axis"]]
    elif detail["kind"] == "joints-permuted":
        out[f"q{k}_deg"], out[f"q{k + 1}_deg"] = out[f"q{k + 1}_deg"], out[f"q{k}_deg"]
    elif detail["kind"] == "joint-sign":
        out[f"q{k}_deg"] = -out[f"q{k}_deg"]
    else:
        for name in ("x_mm", "y_mm", "z_mm"):
            out[name] = np.roll(out[name], 3)
    return out
