"""Recordings of profiles of a ball by a profiler on the flange, of an arm with an error that its readings do not show."""

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.rigid import transform

RADIUS = 20.0
BALL = np.array([420.0, 160.0, 310.0])
HAND_EYE = transform(
    Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), np.array([40.0, -25.0, 70.0])
)
ARM = "ur5"
_LOW = np.radians([-60, -130, -130, -180, -150, -180])
_HIGH = np.radians([60, -20, 130, 180, 150, 180])


def ball_in_sensor(robot, joints, ball=BALL):
    """(n, 3) mm of the ball as the arm holds the profiler at joints (n, J) rad; ball (3,) or (n, 3)."""
    frames = forward(robot, robot.mixing @ joints.T)
    flange = transform(np.stack(frames.end, -1).transpose(1, 0, 2), frames.end_origin.T)
    sensor = flange @ HAND_EYE
    return np.einsum("nji,nj->ni", sensor[:, :3, :3], ball - sensor[:, :3, 3])


def posed_joints(robot, n, rng):
    """(n, J) rad: joints that bring the ball to random places in the profiler's field, by Gauss-Newton for all poses."""
    found = np.empty((0, robot.joints))
    while len(found) < n:
        count = 3 * n
        aim = rng.uniform([-20, -0.7 * RADIUS, 120], [20, 0.7 * RADIUS, 250], (count, 3))
        joints = rng.uniform(_LOW, _HIGH, (count, robot.joints))
        for _ in range(25):
            away = ball_in_sensor(robot, joints) - aim
            change = 1e-6 * np.eye(robot.joints)
            moved = [ball_in_sensor(robot, joints + step) - aim - away for step in change]
            slope = np.stack(moved, axis=2) / 1e-6
            step = np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=1e-3), away)
            joints = joints - np.clip(step, -0.4, 0.4)
        near = np.abs(ball_in_sensor(robot, joints) - aim).max(1) < 1e-3
        inside = (np.abs(joints) < 5).all(1)
        found = np.concatenate([found, joints[near & inside]])
    return found[:n].round(6)


def profile_recording(n=30, each=60, seed=0, sigma=0.02, error=None, moved=None):
    """A recording of n profiles of one ball.

    error: of joints (n, J) rad, what the arm has in addition to its readings (n, J) rad; moved (n, 3) mm of the ball.
    """
    robot = load_robot(ARM)
    rng = np.random.default_rng(seed)
    joints = posed_joints(robot, n, rng)
    true = joints if error is None else joints + error(joints)
    ball = BALL if moved is None else BALL + moved
    points, number = [], []
    for k, (x, y, z) in enumerate(ball_in_sensor(robot, true, np.broadcast_to(ball, (n, 3)))):
        radius = np.sqrt(RADIUS**2 - y**2)
        angle = np.linspace(-0.45, 0.45, each + k % 7) * np.pi
        profile = np.stack([x + radius * np.sin(angle), z - radius * np.cos(angle)])
        points.append(profile + rng.normal(0, sigma, profile.shape))
        number.append(len(angle))
    x, z = np.concatenate(points, axis=1)
    columns = {
        "sample": np.arange(1.0, len(x) + 1),
        "pose": np.repeat(np.arange(1.0, n + 1), number),
    }
    columns |= {
        f"q{j + 1}_deg": np.repeat(row, number) for j, row in enumerate(np.rad2deg(joints).T)
    }
    columns |= {"ball": np.ones(len(x)), "x_mm": x, "y_mm": np.zeros(len(x)), "z_mm": z}
    balls = {1: (0.0, 0.0, 0.0, RADIUS)}
    return Recording("ball-surface", columns, {"builtin": ARM}, balls=balls, name="profiles")
