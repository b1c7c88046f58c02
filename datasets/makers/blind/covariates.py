"""Recorded covariates: time, temperature, payload, direction of approach of each joint, speeds."""

import numpy as np

KINDS = ("time", "temperature", "payload", "approach", "speed")
_OFTEN = {"time": 0.8, "temperature": 0.5, "payload": 0.5, "approach": 0.5, "speed": 0.2}
_KELVIN = 0.25  # what the thermometer shows


def draw(
    rng: np.random.Generator, joints_deg: np.ndarray, need: frozenset, part: np.ndarray, split: str
) -> dict:
    """Columns in file units: the needed kinds, and others at random.

    joints_deg: (n, J), one row per pose. part: (n,) True where an absorbed effect shows;
    split: with "payload" or "temperature", this covariate differs there.
    """
    n = len(joints_deg)
    kinds = {kind for kind in KINDS if kind in need or rng.random() < _OFTEN[kind]} | {split} & set(
        KINDS
    )
    time = np.round(np.cumsum(rng.uniform(8, 25, n)), 1)
    columns = {}
    if "time" in kinds:
        columns["time_s"] = time
    if "temperature" in kinds:
        columns["temperature_c"] = _temperature(rng, time, part, split)
    if "payload" in kinds:
        columns["payload_kg"] = _payload(rng, part, split)
    if "approach" in kinds:
        columns |= _approach(rng, joints_deg)
    if "speed" in kinds:
        speed = np.round(rng.normal(0, rng.uniform(5, 30), joints_deg.shape), 3)
        columns |= {f"qdot{k}_deg_s": column for k, column in enumerate(speed.T, 1)}
    return columns


def _temperature(rng, time, part, split):
    """Warm-up of the machine and daily variation; with split "temperature" only the part is warm."""
    span = time[-1]
    rise = rng.uniform(6, 14) * (1 - np.exp(-time / (span * rng.uniform(0.15, 0.6))))
    day = rng.uniform(0.5, 2) * np.sin(
        2 * np.pi * (time / span * rng.uniform(0.3, 1.5) + rng.random())
    )
    kelvin = (
        rng.uniform(19, 22) + (0.15 * rise + 10 * part if split == "temperature" else rise) + day
    )
    return np.round(kelvin / _KELVIN) * _KELVIN


def _payload(rng, part, split):
    """kg, changed every few poses; with split "payload" only the part is loaded."""
    if split == "payload":
        return np.where(part, round(rng.uniform(2.0, 4.0), 2), 0.0)
    n, block = len(part), int(rng.integers(8, 26))
    loads = np.round(rng.uniform(0.5, 4.0) * np.array([0.0, 0.5, 1.0]), 2)
    return np.repeat(rng.choice(loads, -(-n // block)), block)[:n]


def _approach(rng, joints_deg):
    """Sign of every joint's last motion: from the pose before, or from a side chosen for each pose."""
    sign = np.sign(np.diff(joints_deg, axis=0, prepend=0))
    if rng.random() < 0.5:
        sign = rng.choice([-1.0, 1.0], joints_deg.shape)
    return {f"approach{k}": column for k, column in enumerate(sign.T, 1)}
