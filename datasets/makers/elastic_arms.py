"""Random elastic arms for the calibration of the diagnosis's probabilities, realised with MuJoCo statics.

`make(seed)` draws an arm (a small arm with a sensor and balls, the same with a tracker, an ABB IRB 120 or a large
arm with a tracker), true lengths and masses that differ from the nominal file, and compliances of every joint, of the
links and of the pedestal at once. The diagnosis never sees the engine: statics are solved by `mujoco_arm`.

Sizes are drawn, not fitted: the compliance of a joint scales with the size of the robot, and a link has 1/50 to 1/5 of
the compliance of the joint that carries it, as identified for industrial arms (Dumas, Caro, Garnier & Furet, Robot.
Comput.-Integr. Manuf. 27 (2011) 881; Abele, Weigold & Rothenbücher, CIRP Ann. 56 (2007) 387; Klimchik et al., Mech.
Mach. Theory 107 (2017)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datasets.makers import elastic_arm, folder
from datasets.makers.mujoco_arm import (
    Arm,
    arm_from_robot,
    pose,
    reflector_points,
    static_equilibria,
)

KINDS = ("small-sensor", "small-tracker", "irb120", "large")
SIGMA_MM = 0.03
_REFLECTORS = ((60.0, 0.0, 40.0), (-40.0, 55.0, 60.0), (-30.0, -50.0, 120.0))
_TRACKER = ((2500.0, 900.0, 400.0), (150.0, 3.0, -2.0))
_JOINT_RANGE = 0.65  # share of every joint's range that poses use, about its middle
_IRB120 = (  # theta_deg, d_mm, a_mm, alpha_deg, limits_deg, mass_kg, com_mm of the data sheet and ROS-Industrial
    (0.0, 290.0, 0.0, -90.0, [-165, 165], 3.067, [0.1, 51.6, -0.1]),
    (-90.0, 0.0, 270.0, 0.0, [-110, 110], 3.909, [-168.8, 0.8, -2.1]),
    (0.0, 0.0, 70.0, -90.0, [-110, 70], 2.944, [-12.1, -1.1, 22.8]),
    (0.0, 302.0, 0.0, 90.0, [-160, 160], 1.328, [0.4, -77.3, 0.2]),
    (0.0, 0.0, 0.0, -90.0, [-120, 120], 0.546, [0.1, 0.0, -1.1]),
    (180.0, 72.0, 0.0, 0.0, [-400, 400], 0.137, [0.0, -0.2, -7.1]),
)
_LARGE = (  # an arm of 2.7 m reach and 210 kg payload; lengths as of a KUKA KR 210, masses estimated
    (0.0, 675.0, 350.0, -90.0, [-185, 185], 350.0, [-170.0, 180.0, -30.0]),
    (-90.0, 0.0, 1150.0, 0.0, [-90, 60], 200.0, [-560.0, 20.0, 90.0]),
    (0.0, 0.0, -41.0, -90.0, [-120, 90], 190.0, [20.0, 30.0, 120.0]),
    (0.0, 1200.0, 0.0, 90.0, [-300, 300], 90.0, [0.0, -420.0, 10.0]),
    (0.0, 0.0, 0.0, -90.0, [-125, 125], 40.0, [0.0, -15.0, 40.0]),
    (180.0, 215.0, 0.0, 0.0, [-300, 300], 15.0, [0.0, 0.0, -40.0]),
)


@dataclass(frozen=True)
class _Size:
    """Typical values of a robot: joint compliances (J,) rad/(N m), tool (kg, mm), alternating loads (kg)."""

    rows: tuple
    joints: tuple[float, ...]
    tool: dict
    loads: tuple[float, ...]


_SIZES = {
    "irb120": _Size(
        _IRB120,
        (15e-6, 20e-6, 25e-6, 80e-6, 90e-6, 150e-6),
        {"mass_kg": 0.6, "com_mm": [10.0, -8.0, 45.0]},
        (0.0, 1.0, 2.5),
    ),
    "large": _Size(
        _LARGE,
        (0.25e-6, 0.3e-6, 0.4e-6, 2.5e-6, 3e-6, 4e-6),
        {"mass_kg": 12.0, "com_mm": [15.0, 10.0, 90.0]},
        (0.0, 90.0, 180.0),
    ),
}
_SMALL_JOINTS = (10e-6, 14e-6, 18e-6, 45e-6, 55e-6, 80e-6)


def make(seed: int, mass_share: float = 0.05, samples: int = 300) -> folder.Made:
    """The recording of a random elastic arm; `truth` holds {(effect, where): compliance in rad/(N m)}.

    mass_share: 1 sigma of the relative error of every mass and, likewise, of every centre of mass.
    """
    kind = KINDS[seed % len(KINDS)]
    rng = np.random.default_rng([73, seed])
    if kind == "small-sensor":
        return _with_sensor(rng, seed, mass_share)
    return _with_tracker(rng, kind, mass_share, samples)


def _with_sensor(rng, seed: int, mass_share: float) -> folder.Made:
    """The bundled recording's workplace with another arm and no further fault."""
    joints_deg, ball, plate = elastic_arm._visits(rng)
    columns = elastic_arm._covariates(rng, joints_deg)
    arm = _true_arm(rng, arm_from_robot(elastic_arm.robot()), _SMALL_JOINTS, mass_share)
    hand_eye = elastic_arm._nudged(rng, pose(*elastic_arm._HAND_EYE), 0.5, 0.3)
    nothing = elastic_arm.Slip(2, 0, 0.0)
    points = elastic_arm._measure(arm, nothing, joints_deg, columns, ball, plate, hand_eye)
    points = points + rng.normal(0, SIGMA_MM, points.shape)
    head = {"sample": np.arange(1, len(ball) + 1), "ball": ball, **folder.joint_columns(joints_deg)}
    return folder.Made(
        "ball-centre",
        f"elastic arm {seed}",
        head | folder.point_columns(points) | columns,
        elastic_arm.robot(),
        SIGMA_MM,
        elastic_arm._BALLS,
        truth=_truth(arm),
    )


def _with_tracker(rng, kind: str, mass_share: float, samples: int) -> folder.Made:
    """Poses over most of the joint ranges, three reflectors, loads that change in blocks."""
    size = _SIZES.get(kind)
    robot = _robot(kind, size) if size else elastic_arm.robot()
    joints, loads = (size.joints, size.loads) if size else (_SMALL_JOINTS, (0.0, 1.0, 2.0))
    limits = np.array([row["limits_deg"] for row in robot["joint"]], float)
    middle, half = limits.mean(1), _JOINT_RANGE * np.ptp(limits, axis=1) / 2
    joints_deg = np.round(rng.uniform(middle - half, middle + half, (samples, len(limits))), 4)
    payload = np.repeat(rng.permutation(np.resize(loads, -(-samples // 25))), 25)[:samples]
    arm = _true_arm(rng, arm_from_robot(robot), joints, mass_share)
    reflector = rng.integers(0, len(_REFLECTORS), samples)
    flange = static_equilibria(arm, np.deg2rad(joints_deg), 0.0, payload).flange
    points = np.empty((samples, 3))
    for k, place in enumerate(_REFLECTORS):
        points[reflector == k] = reflector_points(flange[reflector == k], place, pose(*_TRACKER))
    points = points + rng.normal(0, SIGMA_MM, points.shape)
    head = {
        "sample": np.arange(1, samples + 1),
        "reflector": reflector + 1,
        **folder.joint_columns(joints_deg),
    }
    columns = head | folder.point_columns(points) | {"payload_kg": payload}
    return folder.Made(
        "external-point", f"elastic arm, {kind}", columns, robot, SIGMA_MM, truth=_truth(arm)
    )


def _robot(kind: str, size: _Size) -> dict:
    keys = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "limits_deg", "mass_kg", "com_mm")
    rows = [dict(zip(keys, row)) for row in size.rows]
    rows[1]["hayati"] = True  # axes 2 and 3 are parallel
    return {
        "name": kind,
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "data sheet and estimates",
        "payload": size.tool,
        "joint": rows,
    }


def _true_arm(rng, nominal: Arm, joints, mass_share: float) -> Arm:
    """Lengths, masses, centres and compliances as built."""
    count = nominal.joints
    angle = np.deg2rad(0.2)
    deviation = rng.uniform(-1, 1, nominal.geometry.shape) * [angle, 0.5, 0.5, angle, angle]
    deviation[:, 4] *= np.arange(count) == 1
    joint = np.array(joints) * rng.lognormal(0.0, 0.4, count)
    link = joint / np.exp(rng.uniform(np.log(5), np.log(50), count))
    link[4:] = 0.0  # the wrist has no links of a length
    pedestal = joint[0] / np.exp(rng.uniform(np.log(4), np.log(20), 2)) * (rng.random() < 0.7)
    return replace(
        nominal,
        geometry=nominal.geometry + deviation,
        mass=nominal.mass * (1 + mass_share * rng.normal(size=count)),
        com=nominal.com * (1 + mass_share * rng.normal(size=(count, 3))),
        tool_mass=nominal.tool_mass * (1 + 0.5 * mass_share * rng.normal()),
        joint_compliance=joint,
        link_compliance=link,
        pedestal_compliance=tuple(pedestal),
    )


def _truth(arm: Arm) -> dict:
    """{(effect, where): compliance}, rad/(N m), of all compliant elements."""
    truth = {("joint-compliance", f"joint-{k}"): c for k, c in enumerate(arm.joint_compliance, 1)}
    length = np.hypot(arm.geometry[:, 1], arm.geometry[:, 2])
    links = enumerate(zip(arm.link_compliance, length), 1)
    truth |= {
        ("link-compliance", f"link-{k}"): c for k, (c, long) in links if c > 0 and long > 1e-6
    }
    if any(arm.pedestal_compliance):
        truth["pedestal-compliance", "base"] = float(np.max(arm.pedestal_compliance))
    return {name: float(c) for name, c in truth.items()}


__all__ = ["KINDS", "make"]
