"""Effects between joint reading and joint angle, and thermal effects: one independent law per function.

Each takes a random generator and a world and returns a `PlantedEffect`, or None if it is not possible there.
"""

import numpy as np

from datasets.makers.blind.effects.planted import PlantedEffect
from datasets.makers.blind.world import Perturbation, World

_MOST_RAD = 4e-3


def pick(rng: np.random.Generator, world: World) -> int:
    """A joint, from 0."""
    return int(rng.integers(world.joints))


def on_joint(world: World, k: int, angle: np.ndarray) -> np.ndarray:
    """(n, J) rad with `angle` (n,) on joint k, from 0."""
    out = np.zeros((world.n, world.joints))
    out[:, k] = angle
    return out


def transmission_harmonic(rng, world, order: int | None = None, joint: int | None = None):
    """Transmission error with n cycles per revolution; if gear ratios are stated, n may be that of a gear."""
    k = pick(rng, world) if joint is None else joint
    gear = world.robot["joint"][k].get("gear_ratio", 2)
    n = int(
        order
        or rng.choice([1, 2, 3, 4, 6, gear, 2 * gear], p=[0.3, 0.3, 0.1, 0.1, 0.06, 0.08, 0.06])
    )
    wave = np.cos(n * world.angles[:, k] + rng.uniform(-np.pi, np.pi))
    detail = {"order": n}
    return PlantedEffect(
        "transmission-harmonic",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * wave)),
        1e-4,
        _MOST_RAD,
        "rad",
        detail,
    )


def backlash(rng, world, joint: int | None = None):
    """Backlash: the joint stops short of its reading, on the side of its approach, by half the gap."""
    k = pick(rng, world) if joint is None else joint
    side = world.covariates[f"approach{k + 1}"]
    return PlantedEffect(
        "backlash",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * side)),
        1e-4,
        _MOST_RAD,
        "rad",
        {"seat": "approach"},
    )


def backlash_by_gravity(rng, world):
    """Backlash closed by gravity: the sign of the torque determines the side."""
    k = pick(rng, world)
    torque = world.torque[:, k]
    soft = rng.uniform(0.01, 0.1) * np.abs(torque).max()
    if (torque > 0).mean() < 0.1 or (torque < 0).mean() < 0.1 or np.abs(torque).max() < 0.3:
        return None
    side = np.tanh(torque / soft)
    return PlantedEffect(
        "backlash",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * side)),
        1e-4,
        _MOST_RAD,
        "rad",
        {"seat": "gravity", "width": float(soft)},
    )


def joint_coupling(rng, world):
    """A joint that rotates by a share of another joint's motion."""
    k, other = (int(x) for x in rng.choice(world.joints, 2, replace=False))
    swing = world.angles[:, other]
    return PlantedEffect(
        "joint-coupling",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * swing)),
        1e-4,
        _MOST_RAD,
        "rad/rad",
        {"joint": other + 1},
    )


def zero_shift(rng, world):
    """A belt that slips once, between a fifth and four fifths of the recording."""
    k = pick(rng, world)
    first = int(world.n * rng.uniform(0.2, 0.8))
    count = len(world.targets) if world.measures == "external-point" else 1
    first -= first % count
    after = (np.arange(world.n) >= first).astype(float)
    clock = world.covariates.get("time_s", np.arange(world.n, dtype=float))
    detail = {"after": float((clock[first - 1] + clock[first]) / 2), "row": first}
    return PlantedEffect(
        "zero-shift",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * after)),
        1e-4,
        _MOST_RAD,
        "rad",
        detail,
    )


def encoder_quantisation(rng, world):
    """Encoder quantisation: the drive stops at the nearest count instead of the reading."""
    k = pick(rng, world)
    reading = world.readings[:, k]
    return PlantedEffect(
        "encoder-quantisation",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * np.round(reading / s) - reading)),
        3e-4,
        2e-3,
        "rad a count",
    )


def time_offset(rng, world):
    """Readings and measurement have a time offset while the arm moves."""
    speed = np.deg2rad(
        np.column_stack([world.covariates[f"qdot{k}_deg_s"] for k in range(1, world.joints + 1)])
    )
    speed = speed @ world.arm.mixing.T
    return PlantedEffect(
        "time-offset", "time", lambda s: Perturbation(joint=s * speed), 1e-3, 0.1, "s"
    )


def reading_lag(rng, world):
    """The readings are taken a moment before a move ends: trapezoids of speed, all joints as slow as the slowest.

    Each joint has its own strongest braking and highest speed; the joint that needs longest sets the time of all.
    """
    change = np.diff(world.angles, axis=0, prepend=world.angles[:1])
    first = np.maximum.accumulate(
        np.where(np.abs(change).any(1), np.arange(world.n), 0)
    )  # reflectors share a stand
    way = change[first]
    braking, speed = (
        rng.uniform(6, 14, world.joints),
        rng.uniform(2.5, 6, world.joints),
    )  # rad/s^2, rad/s
    travel = np.abs(way)
    ramp = np.minimum(
        np.sqrt(travel * braking), speed
    )  # the highest speed that each would reach by itself
    time = np.where(travel > 0, travel / np.maximum(ramp, 1e-9) + ramp / braking, 0)
    slowest = np.argmax(time, axis=1)
    share = (
        0.5 * braking[slowest] / np.maximum(travel[np.arange(world.n), slowest], 1e-9)
    )  # of the way, at t^2 = 1
    left = way * np.where(time.max(1) > 0, share, 0)[:, None] / 5.0
    return PlantedEffect(
        "reading-lag", "time", lambda s: Perturbation(joint=s * left), 1e-4, _MOST_RAD, "rad"
    )


def joint_thermal_drift(rng, world):
    """An encoder's zero that moves with temperature."""
    k = pick(rng, world)
    warm = world.covariates["temperature_c"] - 20.0
    return PlantedEffect(
        "joint-thermal-drift",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * warm)),
        1e-5,
        4e-4,
        "rad/K",
    )


def link_thermal_growth(rng, world):
    """A link that expands with temperature; the arm model is rebuilt at every temperature."""
    lengths = np.abs(world.arm.geometry[:, 1:3]).max(axis=1)
    k = int(rng.choice(np.flatnonzero(lengths > 50)))
    warm = world.covariates["temperature_c"] - 20.0
    # steel grows by 1.2e-5 a kelvin, aluminium by 2.3e-5; a link that is warmer than the air shows more
    return PlantedEffect(
        "link-thermal-growth",
        f"link-{k + 1}",
        lambda s: Perturbation(growth=on_joint(world, k, s * warm)),
        2e-5,
        8e-5,
        "1/K",
    )
