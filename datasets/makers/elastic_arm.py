"""The bundled recording elastic-arm: `python -m datasets.makers.elastic_arm OUT`.

A small six-axis arm carries a scanner around four balls. The engine gives it
wrong link geometry, elastic joints, links and pedestal, masses that differ from
the nominal ones, a changing payload, and one undisclosed fault: a joint that
slipped at some instant, or one with backlash in its gear. Kind, place, instant
and size are drawn from SEED here. `make().truth` holds them; the files of the
recording do not.

The arm is like a FANUC LR Mate 200iD in its link lengths (data sheet; the same
nominal rows as Ye 2024 starts from). Masses and compliances are invented, of
the size that such an arm has.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from datasets.makers import folder, poses
from datasets.makers.mujoco_arm import (
    Arm,
    Gap,
    Slip,
    arm_from_robot,
    ball_points,
    drive_errors,
    pose,
    static_equilibria,
)

SEED = 20240416
SAMPLES = 300
SIGMA_MM = 0.02
BLOCK = 25  # samples between changes of payload

_ROWS = (  # theta_deg, d_mm, a_mm, alpha_deg, limits_deg, mass_kg, com_mm in frame k
    (0.0, 330.0, 50.0, -90.0, [-170, 170], 5.6, [-38.0, 95.0, -12.0]),
    (-90.0, 0.0, 330.0, 180.0, [-100, 145], 4.9, [-172.0, 6.0, -48.0]),
    (0.0, 0.0, 35.0, -90.0, [-110, 200], 4.2, [-20.0, 10.0, -40.0]),
    (0.0, -335.0, 0.0, 90.0, [-190, 190], 2.1, [0.0, 118.0, 4.0]),
    (180.0, 0.0, 0.0, 90.0, [-125, 125], 0.9, [0.0, -6.0, -22.0]),
    (0.0, -80.0, 0.0, 0.0, [-180, 180], 0.3, [0.0, 0.0, 12.0]),
)
_TOOL = {"mass_kg": 1.3, "com_mm": [22.0, 4.0, -95.0]}
_BALLS = {
    1: (212.146, 61.872, 38.215, 14.999),
    2: (157.308, -148.664, 92.407, 15.002),
    3: (-171.925, 118.340, 71.563, 15.001),
    4: (-196.411, -96.783, 20.188, 14.998),
}
_START = np.deg2rad([0, 10, -15, 0, -75, 0])
_HAND_EYE = ((6.0, 1.5, -188.0), (0.5, -24.0, 179.0))
_PLATE_IN_BASE = ((430.0, 15.0, 45.0), (12.0, 1.5, -2.0))


def robot() -> dict:
    """The nominal robot.toml as a mapping: what the manual would say."""
    keys = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "limits_deg", "mass_kg", "com_mm")
    rows = [dict(zip(keys, row)) for row in _ROWS]
    rows[1]["hayati"] = True  # axes 2 and 3 are parallel
    return {
        "name": "small six-axis arm, lengths of a FANUC LR Mate 200iD",
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "link lengths: FANUC LR Mate 200iD data sheet; q3 is the angle between links 2 and 3, "
        "not the controller's J3 = q3 - q2; masses: estimates, good to about 10 %",
        "payload": _TOOL,
        "joint": rows,
    }


def true_arm(rng: np.random.Generator) -> Arm:
    """The arm as built: lengths within 0.5 mm, angles within 0.3 deg, masses within 10 % of nominal."""
    nominal = arm_from_robot(robot())
    angle = np.deg2rad(0.3)
    deviation = rng.uniform(-1, 1, nominal.geometry.shape) * [angle, 0.5, 0.5, angle, angle]
    deviation[:, 4] *= np.arange(6) == 1  # only Hayati's row is off in beta
    return replace(
        nominal,
        geometry=nominal.geometry + deviation,
        mass=nominal.mass * rng.uniform(0.9, 1.1, 6),
        com=nominal.com * rng.uniform(0.95, 1.05, (6, 3)),
        tool_mass=nominal.tool_mass * rng.uniform(0.97, 1.03),
        joint_compliance=1e-6 * np.array([10, 14, 18, 45, 55, 80]) * rng.uniform(0.8, 1.2, 6),
        link_compliance=1e-6 * np.array([1.8, 3.2, 2.2, 4.8, 0.0, 0.0]) * rng.uniform(0.8, 1.2, 6),
        pedestal_compliance=tuple(1e-6 * rng.uniform(1.5, 3.0, 2)),
    )


def _fault(rng: np.random.Generator) -> Slip | Gap:
    """The undisclosed fault.

    Never at joint 1: its slip is equivalent to a rotation of the base about that axis.
    """
    joint = int(rng.integers(2, 5))
    size = float(rng.choice([-1, 1]) * rng.uniform(2.5e-4, 4e-4))
    first = int(rng.integers(SAMPLES // 3, 2 * SAMPLES // 3))
    return Slip(joint, first, size) if rng.random() < 0.5 else Gap(joint, abs(size) / 2)


def _covariates(rng: np.random.Generator, joints_deg: np.ndarray) -> dict[str, np.ndarray]:
    """Payload, time, temperature and approach; the temperature does nothing here."""
    n = len(joints_deg)
    time = np.round(np.cumsum(rng.uniform(14, 22, n)), 1)
    blocks = rng.permutation(np.resize([0.0, 1.0, 0.0, 2.0], -(-n // BLOCK)))
    warm = 21.4 + 1.1 * (1 - np.exp(-time / 2400)) + rng.normal(0, 0.03, n)
    moved = np.sign(np.diff(joints_deg, axis=0, prepend=0))
    columns = {
        "payload_kg": np.repeat(blocks, BLOCK)[:n],
        "time_s": time,
        "temperature_c": np.round(warm, 2),
    }
    return columns | {f"approach{k}": column for k, column in enumerate(moved.T, 1)}


def make(seed: int = SEED) -> folder.Made:
    """The recording and its truth."""
    rng = np.random.default_rng(seed)
    joints_deg, ball, plate = _visits(rng)
    columns = _covariates(rng, joints_deg)
    arm, fault = true_arm(rng), _fault(rng)
    hand_eye = _nudged(rng, pose(*_HAND_EYE), 0.5, 0.3)
    points = _measure(arm, fault, joints_deg, columns, ball, plate, hand_eye)
    points = points + rng.normal(0, SIGMA_MM, points.shape)
    head = {"sample": np.arange(1, SAMPLES + 1), "ball": ball, **folder.joint_columns(joints_deg)}
    return folder.Made(
        measures="ball-centre",
        title="Elastic arm, four balls, changing payload",
        columns=head | folder.point_columns(points) | columns,
        robot=robot(),
        sigma_mm=SIGMA_MM,
        balls=_BALLS,
        source="made with MuJoCo statics by python -m datasets.makers.elastic_arm",
        truth={
            "arm": arm,
            "concealed": fault,
            "hand_eye": hand_eye,
            "artefact_base": np.linalg.inv(plate),
        },
    )


def _visits(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings (n, 6) deg as a controller shows them, ball (n,) and the plate's pose in the base."""
    plate = _nudged(rng, pose(*_PLATE_IN_BASE), 8.0, 2.0)
    limits = np.deg2rad([row[4] for row in _ROWS])
    balls = np.array([_BALLS[k][:3] for k in sorted(_BALLS)]) @ plate[:3, :3].T + plate[:3, 3]
    geometry = arm_from_robot(robot()).geometry
    joints, ball = poses.scanning(rng, geometry, limits, balls, pose(*_HAND_EYE), SAMPLES, _START)
    return np.round(np.rad2deg(joints), 4), ball + 1, plate


def _nudged(rng, nominal: np.ndarray, mm: float, deg: float) -> np.ndarray:
    return nominal @ pose(rng.uniform(-mm, mm, 3), rng.uniform(-deg, deg, 3))


def _measure(arm, fault, joints_deg, columns, ball, plate, hand_eye) -> np.ndarray:
    """(n, 3) mm: ball centres in the sensor frame, without noise."""
    approach = np.column_stack([columns[f"approach{k}"] for k in range(1, 7)])
    readings = np.deg2rad(joints_deg)
    slips, gaps = ([fault], []) if isinstance(fault, Slip) else ([], [fault])
    errors = drive_errors(readings, slips=slips, gaps=gaps, approach=approach)
    equilibrium = static_equilibria(arm, readings, errors, columns["payload_kg"])
    centres = np.array([_BALLS[int(k)][:3] for k in ball])
    return ball_points(equilibrium.flange, centres, np.linalg.inv(plate), hand_eye)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m datasets.makers.elastic_arm OUT")
    folder.write(make(), sys.argv[1])
