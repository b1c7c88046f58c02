"""Simulated recordings whose flange orientations spread as little or as far as wanted."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from robot_model import builtin_robots, load_robot
from robot_model.chain import THETA, forward, geometry_rotations, geometry_rows

LENGTH_ERROR_MM, ANGLE_ERROR_RAD = 0.4, np.deg2rad(0.06)
NOISE_MM, NOISE_RAD = 0.05, np.deg2rad(0.02)
BALLS = {1: (0.0, 0.0, 0.0, 15.0), 2: (120.0, 5.0, -3.0, 15.0), 3: (10.0, 150.0, 4.0, 15.0)}
SPREADS_DEG = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 90.0, 180.0)


@dataclass(frozen=True)
class PoseScene:
    """A recording, its robot, and what it was made with: base and tool as (rotation, translation)."""

    recording: Recording
    robot: object
    base: tuple
    tool: tuple


def random_arm(rng) -> dict:
    """Keys of robot.toml: six revolute joints with random lengths, offsets and twists of a usual arm."""
    lengths, offsets = rng.uniform(20, 450, 6), rng.uniform(20, 400, 6)
    twists = rng.choice([-90, 90], 6) + rng.uniform(-20, 20, 6)
    joints = [
        {
            "theta_deg": float(rng.uniform(-90, 90)),
            "d_mm": float(d),
            "a_mm": float(a),
            "alpha_deg": float(alpha),
        }
        for d, a, alpha in zip(offsets, lengths, twists)
    ]
    joints[5] |= {"a_mm": 0.0, "alpha_deg": 0.0}
    return {"name": "random arm", "convention": "distal", "joint": joints}


def pose_scene(
    seed: int,
    spread_deg: float,
    poses: int = 40,
    region_mm: float = 250.0,
    measures="external-pose",
):
    """Poses within `region_mm` of a centre, orientations within `spread_deg` of one orientation.

    The arm errs from its data sheet as arms do, and the instrument has noise. At 180 deg the joints are random.
    """
    rng = np.random.default_rng(seed)
    names = [*builtin_robots(), None]
    name = names[seed % len(names)]
    arm = random_arm(rng) if name is None else {"builtin": name}
    robot = load_robot(arm)
    readings = _readings(rng, robot, spread_deg, poses, region_mm)
    frames = forward(robot, robot.mixing @ readings, robot.geometry + _errors(rng, robot))
    base = Rotation.random(random_state=seed), rng.uniform(-2000, 2000, 3)
    tool = Rotation.random(random_state=seed + 1), rng.uniform(-150, 150, 3)
    columns = {"sample": np.arange(1.0, poses + 1)}
    columns |= {f"q{k}_deg": np.rad2deg(q) for k, q in enumerate(readings, 1)}
    columns |= _measured(measures, rng, frames, base, tool)
    balls = BALLS if measures == "ball-centre" else {}
    recording = Recording(
        measures, columns, arm, sigma_mm=NOISE_MM, balls=balls, name=f"scene-{seed}"
    )
    return PoseScene(recording, robot, base, tool)


def _measured(measures, rng, frames, base, tool) -> dict:
    """Columns of what the instrument gives, with noise."""
    count = frames.end_origin.shape[1]
    turns = Rotation.from_matrix(np.stack(frames.end, -1).transpose(1, 0, 2))
    points = base[0].apply(frames.end_origin.T + turns.apply(tool[1])) + base[1]
    orientation = base[0] * turns * tool[0]
    labels = {}
    if measures == "ball-centre":
        labels["ball"] = np.resize(list(BALLS), count).astype(float)
        balls = np.array([BALLS[int(k)][:3] for k in labels["ball"]])
        points = orientation.inv().apply(balls - points)
    noisy = points + NOISE_MM * rng.standard_normal((count, 3))
    columns = labels | dict(zip(("x_mm", "y_mm", "z_mm"), noisy.T))
    measured = Rotation.from_rotvec(NOISE_RAD * rng.standard_normal((count, 3))) * orientation
    if measures == "external-pose":
        columns |= {f"q{c}": row for c, row in zip("xyzw", measured.as_quat().T)}
    if measures == "partial-pose":
        columns |= {f"n{c}": row for c, row in zip("xyz", measured.as_matrix()[:, :, 0].T)}
    return columns


def _errors(rng, robot) -> np.ndarray:
    """(J, 5) deviations from the nominal geometry, rad and mm."""
    size = np.array(
        [ANGLE_ERROR_RAD, LENGTH_ERROR_MM, LENGTH_ERROR_MM, ANGLE_ERROR_RAD, ANGLE_ERROR_RAD]
    )
    return size * rng.standard_normal(robot.geometry.shape)


def _readings(rng, robot, spread_deg, poses, region_mm) -> np.ndarray:
    """(R, poses) joint readings, rad, of poses that were reached by inverse kinematics."""
    if spread_deg >= 180:
        return rng.uniform(-1.7, 1.7, (robot.joints, poses))
    for _ in range(200):
        centre = rng.uniform(-1.7, 1.7, (robot.joints, 1))
        count = 4 * poses
        offset = region_mm * rng.uniform(-1, 1, (3, count))
        axis = rng.standard_normal((3, count))
        turn = (
            np.deg2rad(spread_deg) * rng.uniform(0, 1, count) * axis / np.linalg.norm(axis, axis=0)
        )
        found, reached = _inverse(robot, centre, offset, turn)
        if reached.sum() >= poses:
            return found[:, np.flatnonzero(reached)[:poses]]
        region_mm *= 0.98
    raise AssertionError("no region of the arm was found in which the poses can be reached")


def _inverse(robot, centre, offset, turn):
    """(J, n) joint angles that move the flange at `centre` by offsets (3, n) mm and turns (3, n) rad; and where."""
    start = forward(robot, centre)
    goal = start.end_origin + offset
    at = Rotation.from_matrix(np.stack(start.end, -1)[:, 0].T[None].transpose(0, 2, 1)[0])
    wanted = Rotation.from_rotvec(turn.T) * at
    joints = np.repeat(centre, offset.shape[1], 1)
    port_indices = 5 * np.arange(robot.joints) + THETA
    for _ in range(60):
        frames = forward(robot, joints)
        present = Rotation.from_matrix(np.stack(frames.end, -1).transpose(1, 0, 2))
        gap = np.concatenate(
            [goal - frames.end_origin, 500 * (wanted * present.inv()).as_rotvec().T]
        )
        rows = geometry_rows(robot, frames, frames.end_origin, port_indices)
        rows = np.concatenate([rows, 500 * geometry_rotations(frames, port_indices)], 1).transpose(
            2, 1, 0
        )
        normal = rows.transpose(0, 2, 1) @ rows + 10.0 * np.eye(robot.joints)
        step = np.linalg.solve(normal, np.einsum("nmj,mn->nj", rows, gap)[:, :, None])[:, :, 0].T
        joints = joints + np.clip(step, -0.2, 0.2)
    reached = (np.abs(gap).max(0) < 0.05) & (np.abs(joints).max(0) < np.pi)
    return joints, reached
