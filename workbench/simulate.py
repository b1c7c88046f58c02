"""From a scene to a recording: the model that calibrates, run forwards with noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.makers.poses import scanning
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.poses import pose_values
from robot_model.robot import Robot
from robot_model.system import bind
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.scene import Pose, Scene, read_scene


def simulate(path: Path) -> Recording:
    """The recording that the scene file `path` describes; raises InputError for a scene that cannot be."""
    scene = read_scene(path)
    robot = load_robot(scene.robot, f"robot of scene {path}")
    rng = np.random.default_rng(scene.seed)
    joints, target = _poses(scene, robot, rng, path)
    blank = _blank(scene, robot, joints, target, rng)
    model, parameters = _truth(scene, robot, blank, rng)
    residual = model.residual(parameters)
    noisy = residual + rng.normal(size=residual.shape) * model.sigma(parameters)
    return replace(blank, columns={**blank.columns, **model.chain.measurement.columns(noisy)})


def _truth(scene, robot, blank, rng):
    """The model of the scene with its true parameters."""
    values = [np.ravel(scene.reflectors)] if scene.measures == "external-point" else [_pose(scene.tool)]
    chain = bind(robot, blank, np.concatenate([_pose(scene.base), *values]))
    rows = [(cause.effect, cause.where, dict(cause.model_extra or {})) for cause in scene.effect]
    effects = make_effects(CATALOGUE, rows)
    model = Model(chain, effects)
    parameters = model.parameters.update(_true_values(scene, effects, model))
    return model, parameters.update(_geometry_errors(scene, robot, parameters, rng))


def _true_values(scene, effects, model) -> dict[str, float]:
    values = {}
    for cause, effect in zip(scene.effect, effects):
        keys = {p.key.rpartition(".")[2]: p.key for p in effect.parameters(model.chain)}
        for name, value in cause.values.items():
            if name not in keys:
                raise InputError(
                    f"scene, effect '{cause.effect}' at {cause.where}, key values: '{name}' is not one of its "
                    f"parameters, which are {', '.join(keys)}; rename it"
                )
            values[keys[name]] = value
    return values


def _geometry_errors(scene, robot, parameters, rng) -> dict[str, float]:
    sizes = {"mm": scene.errors.length_mm, "rad": np.deg2rad(scene.errors.angle_deg)}
    rows = [p for p in parameters.table if p.key.startswith("joint-") and p.key.count(".") == 1]
    return {p.key: p.null + rng.normal() * sizes[p.unit] for p in rows}


def _pose(pose: Pose) -> np.ndarray:
    turn = Rotation.from_euler("xyz", pose.rpy_deg, degrees=True)
    return pose_values(turn.as_matrix(), np.array(pose.xyz_mm))


def _limits(robot: Robot, share: float) -> np.ndarray:
    """(R, 2) reachable readings: a share of the limits about their middle, +-180 deg where unknown."""
    limits = np.where(np.isfinite(robot.limits), robot.limits, np.array([-np.pi, np.pi]))
    middle, half = limits.mean(1), np.ptp(limits, axis=1) / 2
    return np.stack([middle - share * half, middle + share * half], 1)


def _poses(scene: Scene, robot: Robot, rng, path) -> tuple[np.ndarray, np.ndarray]:
    """Joint readings (n, R) in rad or mm, and the number (n,) of the ball or reflector seen."""
    limits = _limits(robot, scene.share_of_limits)
    if scene.measures != "ball-centre":
        joints = rng.uniform(*limits.T, size=(scene.samples, len(limits)))
        return joints, np.arange(scene.samples) % max(len(scene.reflectors), 1) + 1
    if not scene.balls:
        raise InputError(
            f"scene {path}, key balls: a ball-centre scene needs at least one [x, y, z, radius], found none"
        )
    return _looking_at_balls(scene, robot, limits, rng)


def _looking_at_balls(scene, robot, limits, rng):
    """Configurations from which the sensor sees a ball, spread over the balls."""
    turn = Rotation.from_euler("xyz", scene.base.rpy_deg, degrees=True)
    balls = turn.inv().apply(np.array(scene.balls)[:, :3] - scene.base.xyz_mm)
    hand_eye = np.eye(4)
    hand_eye[:3, :3] = Rotation.from_euler("xyz", scene.tool.rpy_deg, degrees=True).as_matrix()
    hand_eye[:3, 3] = scene.tool.xyz_mm
    found = scanning(rng, robot.geometry, limits, balls, hand_eye, scene.samples, limits.mean(1))
    return found[0], found[1] + 1


def _blank(scene, robot, joints, target, rng) -> Recording:
    """The recording without its measurements, with covariates as the scene asks for."""
    n = len(joints)
    columns = {"sample": np.arange(n, dtype=float)}
    for k, row in enumerate(joints.T, 1):
        slides = robot.prismatic[k - 1]
        columns[f"q{k}_mm" if slides else f"q{k}_deg"] = row if slides else np.rad2deg(row)
    columns["ball" if scene.measures == "ball-centre" else "reflector"] = target.astype(float)
    columns["time_s"] = np.arange(n) * scene.seconds_per_sample
    if scene.payload_kg is not None:
        columns["payload_kg"] = rng.uniform(*scene.payload_kg, n)
    if scene.approach:
        columns |= {f"approach{k + 1}": rng.choice([-1.0, 1.0], n) for k in range(joints.shape[1])}
    columns |= dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(n))
    if scene.measures == "external-pose":
        columns |= dict.fromkeys(("qx", "qy", "qz"), np.zeros(n)) | {"qw": np.ones(n)}
    balls = {i: tuple(ball) for i, ball in enumerate(scene.balls, 1)}
    return Recording(scene.measures, columns, {"builtin": scene.robot}, scene.title, scene.sigma_mm, balls=balls)
