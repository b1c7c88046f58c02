"""Effects outside the vocabulary: a diagnosis must report them as unexplained, at their place."""

import numpy as np

from datasets.makers import poses
from datasets.makers.blind.effects.joints import on_joint
from datasets.makers.blind.effects.planted import PlantedEffect
from datasets.makers.blind.world import Perturbation

_MOST_RAD = 6e-3
_SMALLEST_NM = 1e-3


def _named(k: int, *kinds: str) -> tuple[str, ...]:
    return tuple(f"{kind}{k + 1}" for kind in kinds)


def hose_on_the_wrist(rng, world):
    """A hose from forearm to flange pulls when it is taut; one wrist joint deflects under its torque."""
    k = int(rng.choice([3, 4]))
    start = rng.uniform([-120, -120, -20], [120, 120, 80])
    end = rng.uniform([-90, -90, 0], [90, 90, 40])

    def length(turned):
        angles = world.angles + on_joint(world, k, np.full(world.n, turned))
        first = poses.forward_kinematics(world.arm.geometry[:3], angles[:, :3])
        last = np.linalg.inv(first) @ poses.forward_kinematics(world.arm.geometry, angles)
        return np.linalg.norm(last[:, :3, :3] @ end + last[:, :3, 3] - start, axis=1)

    slack = np.quantile(length(0.0), rng.uniform(0.2, 0.6))
    energy = [np.maximum(length(h) - slack, 0) ** 2 for h in (-1e-4, 1e-4)]
    torque = (energy[0] - energy[1]) / 2e-4
    pull = torque / max(np.abs(torque).max(), 1e-9)
    wrist = ("q4_deg", "q5_deg", "q6_deg", "q4", "q5", "q6")
    return PlantedEffect(
        "unknown",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * pull)),
        2e-4,
        _MOST_RAD,
        "rad",
        {"cause": "hose torque on the wrist"},
        depends_on=wrist,
    )


def loose_bolt(rng, world):
    """A link flange with clearance that tips to the side of the load, across the link."""
    swing = [
        (np.abs(m).max(), (m > 0).mean())
        for m in world.moment.transpose(1, 2, 0).reshape(-1, world.n)
    ]
    able = [
        i
        for i, (largest, share) in enumerate(swing)
        if largest > 0.5 and 0.15 < share < 0.85 and i < 2 * 5
    ]
    if not able:
        return None
    k, axis = divmod(int(rng.choice(able)), 2)
    bend = np.zeros((world.n, world.joints, 2))
    bend[:, k, axis] = np.sign(world.moment[:, k, axis])
    places = (f"link-{k + 1}", f"joint-{k + 1}", f"joint-{k + 2}")
    moved = tuple(
        name for j in range(1, world.joints) for name in _named(j, "q", "torque", "moment")
    )
    return PlantedEffect(
        "unknown",
        f"link-{k + 1}",
        lambda s: Perturbation(bend=s * bend),
        1e-4,
        _MOST_RAD,
        "rad",
        {"cause": "loose bolt"},
        places=places,
        depends_on=moved,
    )


def stick_slip(rng, world):
    """A joint that friction stops early: the stopping error grows with the load."""
    k = int(rng.choice([1, 2, 4]))
    torque = np.abs(world.torque[:, k])
    if torque.max() < 0.5 or np.std(torque) < 0.35 * torque.mean():
        return None
    stuck = -world.covariates[f"approach{k + 1}"] * torque**1.5 / torque.max() ** 1.5
    return PlantedEffect(
        "unknown",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * stuck)),
        2e-4,
        _MOST_RAD,
        "rad",
        {"cause": "stick-slip"},
        depends_on=_named(k, "approach", "torque", "q"),
    )


def neighbours_cycle(rng, world):
    """A floor that moves with the cycle of a nearby machine, several times in the recording."""
    time = world.covariates["time_s"]
    turns = rng.uniform(4, 12)
    phase = 2 * np.pi * turns * time / time[-1] + rng.uniform(0, 6)
    course = np.tanh(3 * np.sin(phase)) if rng.random() < 0.5 else np.sin(phase)
    twist = course[:, None] * rng.normal(0, 1, 6) * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
    return PlantedEffect(
        "unknown",
        "base",
        lambda s: Perturbation(base=s * twist),
        0.05,
        1.5,
        "mm and mrad",
        {"cause": "floor moved by a neighbour"},
        depends_on=("time", "time_s"),
    )


def worn_patch(rng, world):
    """A locally worn gear: a transmission error at one angle only."""
    k = int(rng.integers(world.joints))
    angle = world.angles[:, k]
    wide = rng.uniform(0.06, 0.14) * np.ptp(angle)
    centre = rng.choice(angle)
    bump = np.exp(-(((angle - centre) / wide) ** 2))
    return PlantedEffect(
        "unknown",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * bump)),
        2e-4,
        _MOST_RAD,
        "rad",
        {"cause": "worn patch of a gear"},
        accept=(("joint-curve", f"joint-{k + 1}"),),  # any function of the joint's own angle
        depends_on=_named(k, "q"),
    )


CAUSES = {
    "hose": (hose_on_the_wrist, frozenset()),
    "bolt": (loose_bolt, frozenset()),
    "stick-slip": (stick_slip, frozenset({"approach"})),
    "floor": (neighbours_cycle, frozenset({"time"})),
    "worn": (worn_patch, frozenset()),
}
"""Cause -> its law, and the kinds of covariates that must be recorded."""


def local_basis(world, base: np.ndarray, effect: PlantedEffect) -> np.ndarray:
    """(3 n, R): basis of the baseline and of the named effects at the same or an equivalent place.

    The size of a case is that of the part orthogonal to this basis, which no named effect explains.
    """
    pushes = [
        push
        for where in dict.fromkeys((effect.where, *effect.places))
        for push in _named_at(world, where)
    ]
    columns = [(world.measured(push) - world.clean).ravel() for push in pushes]
    remaining = np.column_stack([column - base @ (base.T @ column) for column in columns])
    size = np.linalg.norm(remaining, axis=0)
    scaled = remaining[:, size > 1e-9] / size[size > 1e-9]
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.column_stack([base, u[:, s > 1e-6 * s[0]]])


def _named_at(world, where: str) -> list[Perturbation]:
    """Small pushes of the named effects at a place."""
    kind, _, number = where.rpartition("-")
    k = int(number) - 1 if kind else 0
    small = 1e-4
    if where == "base":
        share = world.covariates["time_s"] / world.covariates["time_s"][-1]
        scale = np.array([0.1, 0.1, 0.1, small, small, small])
        return [
            Perturbation(base=share[:, None] ** n * unit * scale)
            for n in (1, 2, 3)
            for unit in np.eye(6)
        ]
    if kind == "link":
        bends = np.zeros((2, world.n, world.joints, 2))
        for axis in (0, 1):
            moment = world.moment[:, k, axis]
            bends[axis, :, k, axis] = small * moment / max(np.abs(moment).max(), _SMALLEST_NM)
        return [Perturbation(bend=bend) for bend in bends]
    angle = world.angles[:, k]
    torque = world.torque[:, k] / max(np.abs(world.torque[:, k]).max(), _SMALLEST_NM)
    waves = [wave(n * angle) for n in (1, 2) for wave in (np.cos, np.sin)]
    loads = [torque, np.tanh(10 * torque), np.sign(torque)]
    sides = [world.covariates[f"approach{k + 1}"]] if f"approach{k + 1}" in world.covariates else []
    return [Perturbation(joint=on_joint(world, k, small * row)) for row in (*waves, *loads, *sides)]
