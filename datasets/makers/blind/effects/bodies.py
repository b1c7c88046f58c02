"""Effects of weight, of a moving base, of the sensor and of the artefact: independent laws for the benchmark.

Each takes a random generator and a world and returns a `PlantedEffect`, or None if it is not possible there.
"""

import numpy as np

from datasets.makers.blind import statics
from datasets.makers.blind.effects.joints import on_joint, pick
from datasets.makers.blind.effects.planted import PlantedEffect
from datasets.makers.blind.world import Perturbation, World

_MOST_RAD = 2e-3
_UNLOADED_NM = 0.2


def joint_compliance(rng, world, joint: int | None = None):
    """A joint that deflects under the total torque of links and load."""
    k = _loaded(rng, np.ptp(world.torque, axis=0)) if joint is None else joint
    if k is None:
        return None
    largest = _MOST_RAD / np.abs(world.torque[:, k]).max()
    same = (
        ()
        if np.any(world.payload) or world.arm.tool_mass
        else (("link-self-weight", f"joint-{k + 1}"),)
    )
    return PlantedEffect(
        "joint-compliance",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint_compliance=s * np.eye(world.joints)[k]),
        largest / 10,
        largest,
        "rad/(N m)",
        accept=same,
    )


def link_self_weight(rng, world):
    """A joint that deflects under the weight of the links only, for example with a balanced load."""
    import dataclasses

    bare = dataclasses.replace(world.arm, tool_mass=0.0)
    torque = statics.torques(bare, world.angles, np.zeros(world.n))[0]
    k = _loaded(rng, np.ptp(torque, axis=0))
    if k is None:
        return None
    largest = _MOST_RAD / np.abs(torque[:, k]).max()
    return PlantedEffect(
        "link-self-weight",
        f"joint-{k + 1}",
        lambda s: Perturbation(joint=on_joint(world, k, s * torque[:, k])),
        largest / 10,
        largest,
        "rad/(N m)",
    )


def link_compliance(rng, world):
    """A link that bends under its load."""
    k = _loaded(rng, np.ptp(world.moment, axis=0).max(axis=1) * _long(world))
    if k is None:
        return None
    largest = _MOST_RAD / np.abs(world.moment[:, k]).max()
    return PlantedEffect(
        "link-compliance",
        f"link-{k + 1}",
        lambda s: Perturbation(link_compliance=s * np.eye(world.joints)[k]),
        largest / 10,
        largest,
        "rad/(N m)",
    )


def pedestal_compliance(rng, world):
    """A pedestal that tilts under the arm, somewhat more one way than the other."""
    axes = rng.uniform(0.6, 1.0, 2)
    return PlantedEffect(
        "pedestal-compliance",
        "base",
        lambda s: Perturbation(pedestal=s * axes),
        2e-6,
        5e-5,
        "rad/(N m)",
    )


def mount_tilt(rng, world):
    """Gravity is not along -z of the base, and the joints deflect accordingly."""
    side = rng.uniform(-np.pi, np.pi)
    tilt = np.array([np.cos(side), np.sin(side), 0.0])
    return PlantedEffect(
        "mount-tilt", "base", lambda s: Perturbation(gravity=s * tilt), 5e-3, 0.09, "rad"
    )


def tool_deflection(rng, world):
    """A tool that sags under its own weight, differently along its three axes."""
    soft = np.diag(rng.permutation([1.0, rng.uniform(0.3, 0.7), rng.uniform(0.0, 0.3)]))

    def act(s):
        rotation = world.flange(Perturbation())[:, :3, :3]
        return Perturbation(tip=s * np.einsum("nji,j->ni", rotation, [0.0, 0.0, -1.0]) @ soft)

    return PlantedEffect("tool-deflection", "tool", act, 0.05, 1.5, "mm")


def axis_run_out(rng, world):
    """Run-out of a joint axis: a radial displacement once per revolution, from an eccentric bearing seat."""
    k = pick(rng, world)
    waves = np.stack([np.cos(world.angles[:, k]), np.sin(world.angles[:, k])])
    displacement = np.zeros((world.n, world.joints, 3))
    displacement[:, k, :2] = waves.T @ rng.normal(0, 1, (2, 2))
    return PlantedEffect(
        "axis-run-out",
        f"joint-{k + 1}",
        lambda s: Perturbation(run_out=s * displacement),
        0.02,
        0.4,
        "mm",
    )


def base_drift(rng, world):
    """A base, or an instrument, that drifts: in one direction during warm-up and in one at a constant rate."""
    time = world.covariates.get("time_s", np.arange(world.n, dtype=float))
    share = time / time[-1]
    size = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
    courses = np.stack([1 - np.exp(-share / rng.uniform(0.2, 0.6)), share * rng.uniform(-1, 1)])
    twist = courses.T @ (rng.normal(0, 1, (2, 6)) * size)
    detail = {"start": float(time[0]), "end": float(time[-1])}
    return PlantedEffect(
        "base-drift",
        "base",
        lambda s: Perturbation(base=s * twist),
        0.05,
        1.0,
        "mm and mrad",
        detail,
        accept=(("warm-up", "base"),),  # the larger of the two courses is one
    )


def range_scale(rng, world):
    """A sensor with a range error proportional to the distance."""
    distance = world.clean[:, 2]
    sensed = np.zeros((world.n, 3))
    sensed[:, 2] = distance - 130.0
    return PlantedEffect(
        "range-scale", "sensor", lambda s: Perturbation(sensed=s * sensed), 3e-3, 0.04, "mm/mm"
    )


def field_bias(rng, world):
    """A sensor with a range error that is a polynomial of the field position, mostly a bowl or a saddle."""
    x, y = world.clean[:, :2].T / 35.0
    terms = np.stack([x, y, x * x, x * y, y * y])
    sensed = np.zeros((world.n, 3))
    sensed[:, 2] = (rng.normal(0, 1, 5) * [0.3, 0.3, 1, 1, 1]) @ terms
    return PlantedEffect(
        "field-bias", "sensor", lambda s: Perturbation(sensed=s * sensed), 0.05, 0.6, "mm"
    )


def ball_position(rng, world):
    """One ball's coordinate on the certificate is wrong."""
    k = int(rng.integers(len(world.targets)))
    way = rng.normal(0, 1, 3)
    displacement = np.where((world.index == k)[:, None], way / np.linalg.norm(way), 0.0)
    return PlantedEffect(
        "ball-position",
        f"ball-{k + 1}",
        lambda s: Perturbation(ball=s * displacement),
        0.1,
        1.5,
        "mm",
    )


def artefact_expansion(rng, world):
    """A plate that grows with temperature."""
    warm = world.covariates["temperature_c"] - 20.0
    grown = world.targets[world.index] * warm[:, None]
    return PlantedEffect(
        "artefact-expansion", "artefact", lambda s: Perturbation(ball=s * grown), 2e-5, 8e-5, "1/K"
    )


def _loaded(rng, swing) -> int | None:
    """A random joint or link with a varying load, numbered from 0."""
    able = np.flatnonzero(swing > _UNLOADED_NM)
    return int(rng.choice(able)) if able.size else None


def _long(world: World) -> np.ndarray:
    """(J,) whether a link has a length to bend along."""
    return (np.abs(world.arm.geometry[:, 1:3]).max(axis=1) > 30).astype(float)
