"""Recordings of an arm that differs from its simulation in planted ways, made by MuJoCo's statics.

`make(seed, parameters, physics, noise)` draws an arm, how many parameters of its geometry differ, which effects the
simulation does not hold, and by which factor the noise is stated wrongly. `true_points` are those at other poses.
The truth is solved by `mujoco_arm`, which shares no code with the kinematics and statics of the workbench.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.makers import elastic_arm, elastic_arms, folder
from datasets.makers.mujoco_arm import (
    Arm,
    Gap,
    Harmonic,
    Slip,
    arm_from_robot,
    drive_errors,
    pose,
    reflector_points,
    static_equilibria,
)

ROBOTS = ("irb120", "small", "large")
SIGMA_MM = {"irb120": 0.02, "small": 0.02, "large": 0.05}
PHYSICS = ("joint-compliance", "backlash", "transmission-harmonic", "zero-shift")
_LENGTH_MM, _ANGLE_RAD = (0.2, 0.6), (6e-4, 1.5e-3)
_DRIVE_RAD = (3e-4, 7e-4)
_REFLECTOR = (60.0, -30.0, 110.0)
_TRACKER = ((2500.0, 900.0, 400.0), (150.0, 3.0, -2.0))
_RANGE = 0.65  # share of every joint's range that poses use, about its middle
_COLUMNS = {"theta": 0, "d": 1, "a": 2, "alpha": 3}
_GEOMETRY = (
    "joint-2.a2",
    "joint-3.a3",
    "joint-3.theta3",
    "joint-4.d4",
    "joint-4.alpha4",
    "joint-5.theta5",
)


@dataclass(frozen=True)
class Planted:
    """A recording with its truth.

    `made`: the recording, whose robot file is the nominal one; `arm` and the drive errors as built; `parameters` key ->
    difference (mm, rad); `physics` (effect, where) -> size; `factor`: true over stated noise.
    """

    made: folder.Made
    arm: Arm
    parameters: Mapping[str, float]
    physics: Mapping[tuple[str, str], float]
    drives: Mapping[str, tuple]
    factor: float

    def true_points(
        self, joints_deg: np.ndarray, approach: np.ndarray, payload: np.ndarray
    ) -> np.ndarray:
        """(n, 3) mm in the instrument's frame, noise-free, at poses after the recording."""
        drives = {"slips": tuple(replace(s, first=0) for s in self.drives["slips"])}
        return _points(self.arm, {**self.drives, **drives}, joints_deg, approach, payload)

    def unseen(self, count: int, seed: int = 1):
        """Joints (n, J) deg, approach (n, J) and payload (n,) kg of poses that the recording does not have."""
        rng = np.random.default_rng([97, seed])
        loads = np.unique(self.made.columns["payload_kg"])
        return _poses(rng, self.made.robot, count, loads)


def make(seed: int, parameters: int, physics: int, noise: bool, samples: int = 130) -> Planted:
    """The recording of an arm with some wrong parameters and effects; noise: whether its statement is wrong."""
    kind = ROBOTS[seed % len(ROBOTS)]
    rng = np.random.default_rng([41, seed])
    robot, joints, loads = _robot(kind)
    nominal = arm_from_robot(robot)
    wrong = _wrong_parameters(rng, parameters)
    names = rng.choice(PHYSICS, physics, replace=False) if physics else ()
    found = [_effect(rng, name, joints, samples) for name in names]
    arm = _built(nominal, wrong, found)
    drives = {
        key: tuple(d for _, _, kind, d in found if kind == key)
        for key in ("gaps", "harmonics", "slips")
    }
    factor = (
        float(np.exp(rng.choice([-1, 1]) * rng.uniform(np.log(1.4), np.log(3)))) if noise else 1.0
    )
    joints_deg, approach, payload = _poses(rng, robot, samples, loads)
    points = _points(arm, drives, joints_deg, approach, payload)
    stated = SIGMA_MM[kind]
    measured = points + rng.normal(0, stated * factor, points.shape)
    made = folder.Made(
        "external-point",
        f"{kind} arm {seed}",
        _columns(joints_deg, approach, payload, measured),
        robot,
        stated,
    )
    sizes = {
        (name, where): size for name, where, size in ((n, f[0], f[1]) for n, f in zip(names, found))
    }
    return Planted(made, arm, wrong, sizes, drives, factor)


def _robot(kind: str):
    """Nominal robot file, typical joint compliances and loads."""
    if kind == "small":
        return elastic_arm.robot(), elastic_arms._SMALL_JOINTS, (0.0, 1.0, 2.0)
    size = elastic_arms._SIZES[kind]
    return elastic_arms._robot(kind, size), size.joints, size.loads


def _wrong_parameters(rng, count: int) -> dict[str, float]:
    made = {}
    for key in rng.choice(_GEOMETRY, count, replace=False) if count else ():
        low, high = _LENGTH_MM if key[8] in "ad" and "alpha" not in key else _ANGLE_RAD
        made[str(key)] = float(rng.uniform(low, high) * rng.choice([-1, 1]))
    return made


def _effect(rng, name: str, joints, samples: int):
    """(where, size, kind of drive error or "", what it is) of an effect at a random place."""
    if name == "joint-compliance":
        k = int(rng.integers(2, 4))
        return f"joint-{k}", float(joints[k - 1] * rng.uniform(1.0, 2.5)), "", k
    k, size = int(rng.integers(1, 5)), float(rng.uniform(*_DRIVE_RAD))
    if name == "backlash":
        return f"joint-{k}", size, "gaps", Gap(k, size)
    if name == "zero-shift":
        first = int(rng.integers(samples // 3, 2 * samples // 3))
        return f"joint-{k}", size, "slips", Slip(k, first, size)
    phase = rng.uniform(0, 2 * np.pi)
    wave = Harmonic(k, int(rng.integers(1, 3)), size * np.cos(phase), size * np.sin(phase))
    return f"joint-{k}", size, "harmonics", wave


def _built(nominal: Arm, wrong: Mapping[str, float], found) -> Arm:
    """The nominal arm with wrong parameters and springs."""
    geometry = nominal.geometry.copy()
    for key, change in wrong.items():
        geometry[int(key[6]) - 1, _COLUMNS[key[8:-1]]] += change
    joint = np.zeros(nominal.joints)
    for _, size, kind, number in found:
        if not kind:
            joint[number - 1] = size
    return replace(nominal, geometry=geometry, joint_compliance=joint)


def _poses(rng, robot: Mapping, count: int, loads):
    limits = np.array([row["limits_deg"] for row in robot["joint"]], float)
    middle, half = limits.mean(1), _RANGE * np.ptp(limits, axis=1) / 2
    joints_deg = np.round(rng.uniform(middle - half, middle + half, (count, len(limits))), 4)
    approach = rng.choice([-1.0, 1.0], joints_deg.shape)
    return joints_deg, approach, rng.choice(np.asarray(loads, float), count)


def _points(arm: Arm, drives, joints_deg, approach, payload) -> np.ndarray:
    readings = np.deg2rad(joints_deg)
    errors = drive_errors(readings, **drives, approach=approach)
    flange = static_equilibria(arm, readings, errors, payload).flange
    return reflector_points(flange, _REFLECTOR, pose(*_TRACKER))


def _columns(joints_deg, approach, payload, points) -> dict[str, np.ndarray]:
    count = len(joints_deg)
    head = {"sample": np.arange(1.0, count + 1), "reflector": np.ones(count)}
    sides = {f"approach{k}": side for k, side in enumerate(approach.T, 1)}
    times = {"time_s": 10.0 * np.arange(count)}
    return (
        head
        | folder.joint_columns(joints_deg)
        | folder.point_columns(points)
        | {"payload_kg": payload}
        | sides
        | times
    )


__all__ = ["PHYSICS", "ROBOTS", "Planted", "make"]
