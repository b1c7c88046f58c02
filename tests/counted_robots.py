"""Robots whose files count the joints in another way than their controllers, and programs of these controllers."""

from importlib.resources import files

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model.chain import forward
from robot_model.files.robot_file import read_robot_keys, robot_from_keys
from robot_model.postures.configuration import configuration_signs
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import nominal_poses

ROBOTS = {"KUKA": "kuka_kr10_r1100", "ABB": "abb_irb120", "FANUC": "fanuc_lr_mate_200id"}
FILES = {"KUKA": "job.dat", "ABB": "job.mod", "FANUC": "job.ls"}


def counted(maker, signs=(1,) * 6, zeros=(0.0,) * 6):
    """The robot of a maker whose readings are signs * (those of the controller) + zeros, in deg."""
    keys = read_robot_keys(files("robot_model") / "robots" / f"{ROBOTS[maker]}.toml")
    for joint, sign, zero in zip(keys["joint"], signs, zeros):
        joint["sign"] = joint.get("sign", 1) * sign
        joint["theta_deg"] -= joint["sign"] * zero
        limits = joint.get("limits_deg", [-80.0, 210.0])
        joint["limits_deg"] = sorted(sign * end + zero for end in limits)
        joint.pop("coupled", None)
    return robot_from_keys(keys, "robot.toml")


def drawn(maker, n, seed=5):
    """(n, 6) deg: readings of the controller away from singular postures and borders of the data."""
    robot = counted(maker)
    rng = np.random.default_rng(seed)
    low, high = np.rad2deg(robot.limits).T
    found = rng.uniform(0.8 * low, 0.8 * high, (60 * n, 6))
    found[:, 5] = rng.uniform(-170, 170, len(found))
    found[:, 3] = np.clip(found[:, 3], -172, 172)
    clear = (np.abs((found + 45) % 90 - 45) > 8).all(1)
    far = np.abs(side_sines(maker, found)).min(1) > 0.05
    return found[clear & far][:n]


def side_sines(maker, readings):
    """(n, 3): positive where the wrist centre is behind axis 1, axis 3 beyond the stretched arm, axis 5 negative; from
    places in the plane of the arm."""
    robot = counted(maker)
    points = forward(robot, robot.mixing @ np.deg2rad(readings).T).z_origin
    turn = np.deg2rad(readings[:, 0]) * (-1 if maker == "KUKA" else 1)
    ahead = np.cos(turn) * points[:, 0] + np.sin(turn) * points[:, 1]
    plane = np.stack([ahead, points[:, 2]], 1)
    upper, fore = plane[2] - plane[1], plane[4] - plane[2]
    bend = upper[0] * fore[1] - upper[1] * fore[0]
    lengths = np.linalg.norm(upper, axis=0) * np.linalg.norm(fore, axis=0)
    reach = np.linalg.norm(upper, axis=0) + np.linalg.norm(fore, axis=0)
    beyond = bend / lengths * (1 if maker == "FANUC" else -1)
    return np.stack([-ahead[4] / reach, beyond, -np.sin(np.deg2rad(readings[:, 4]))], 1)


def sides_of(maker, readings):
    """(n, 3) bool of `side_sines`."""
    return side_sines(maker, readings) > 0


def program(maker, readings):
    """The text of a program with poses at readings (n, 6) deg of the controller, and their configuration data."""
    poses = nominal_poses(counted(maker), np.deg2rad(readings))
    sides = sides_of(maker, readings)
    rows = [_ROWS[maker](k, *row) for k, row in enumerate(zip(poses, readings, sides), 1)]
    head = {
        "KUKA": "$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\n",
        "ABB": "MODULE job\n",
        "FANUC": "/POS\n",
    }
    return head[maker] + "\n".join(rows) + "\n"


def _krl(k, pose, q, sides):
    x, y, z = pose[:3, 3]
    a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
    status = sum(1 << j for j in range(3) if sides[j])
    turn = sum(1 << j for j in range(6) if q[j] < 0)
    place = f"X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f}"
    return f"DECL E6POS XP{k}={{{place},S {status},T {turn}}}"


def _rapid(k, pose, q, sides):
    place = ",".join(f"{v:.6f}" for v in pose[:3, 3])
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    cf = ",".join(str(int(np.floor(q[j] / 90))) for j in (0, 3, 5))
    cfx = 4 * int(sides[0]) + 2 * int(not sides[1]) + int(sides[2])
    quaternion = ",".join(f"{v:.9f}" for v in turn)
    target = f"[[{place}],[{quaternion}],[{cf},{cfx}],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    return f"CONST robtarget p{k}:={target};\nMoveL p{k}, v100, fine, tool0;"


def _fanuc(k, pose, q, sides):
    x, y, z = pose[:3, 3]
    w, p, r = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
    letters = f"{'FN'[int(sides[2])]} {'UD'[int(sides[1])]} {'TB'[int(sides[0])]}"
    turns = ", ".join(str(int(np.floor((q[j] + 180) / 360))) for j in (0, 3, 5))
    place = f"X = {x:.6f} mm, Y = {y:.6f} mm, Z = {z:.6f} mm,\n W = {w:.6f} deg, P = {p:.6f} deg, R = {r:.6f} deg"
    return f"P[{k}]{{\n GP1:\n UF : 0, UT : 0, CONFIG : '{letters}, {turns}',\n {place}\n}};"


_ROWS = {"KUKA": _krl, "ABB": _rapid, "FANUC": _fanuc}


def arm(robot, recorded=None):
    """A calibrated arm; recorded: (n, 6) deg of its recording in the counting of the robot, None: an old file."""
    none = np.zeros((0, 0)), np.zeros(3), 0.0, True, "", {}
    if recorded is None:
        return CalibratedArm(robot, (), {}, (), *none)
    ranges = {
        f"q{k}_deg": (low, high)
        for k, (low, high) in enumerate(zip(recorded.min(0), recorded.max(0)), 1)
    }
    signs = np.unique(configuration_signs(robot, np.deg2rad(recorded)), axis=0)
    return CalibratedArm(robot, (), {}, (), *none, fitted_range=ranges, configurations=signs)
