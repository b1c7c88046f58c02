"""Example recordings without images, one function per kind: simulated with geometry errors and noise."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from datasets.samples.columns import FLANGE, POINT, QUATERNION
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform
from workbench.jobs.robot.simulate import simulate
from workbench.recordings.templates.contact import (
    TrueArm,
    beam_through,
    touching_plane,
    touching_point,
)

_SEED = 1
_SIGMA_MM, _EXACT_MM = 0.02, 1e-6
_SIGMA_RAD = 1e-3
_EXTERNAL = """
robot = "robot.toml"
measures = "{measures}"
title = "example"
samples = {samples}
seed = 1
sigma_mm = 0.02
reflectors = [[0.0, 40.0, 120.0], [60.0, -20.0, 130.0], [-60.0, -20.0, 125.0]]
share_of_limits = 0.5
[base]
xyz_mm = [2400.0, 300.0, -500.0]
rpy_deg = [0.5, -0.3, 150.0]
[tool]
xyz_mm = [10.0, 20.0, 120.0]
rpy_deg = [10.0, -20.0, 30.0]
[errors]
length_mm = 0.3
angle_deg = 0.05
"""
_BALLS = """
robot = "robot.toml"
measures = "ball-centre"
title = "example"
samples = {samples}
seed = 1
sigma_mm = {sigma}
balls = [[0.0, 0.0, 0.0, 15.0], [120.0, 0.0, 0.0, 15.0], [40.0, 110.0, 20.0, 15.0]]
[base]
xyz_mm = [{x}, 0.0, -150.0]
[tool]
xyz_mm = [10.0, -5.0, 60.0]
rpy_deg = [2.0, -1.0, 30.0]
[errors]
length_mm = 0.3
angle_deg = 0.05
"""
_DISTANCES = (0.42, 0.5, 0.35, 0.3, 0.6)
"""Shares of the reach at which the balls may stand before the base."""


def external_point(robot: Mapping) -> Recording:
    """36 poses with one of three reflectors each."""
    return _simulated(robot, _EXTERNAL.format(measures="external-point", samples=36))


def external_pose(robot: Mapping) -> Recording:
    """24 poses of a target that gives six degrees of freedom."""
    recording = _simulated(robot, _EXTERNAL.format(measures="external-pose", samples=24))
    return _drop_columns(recording, "reflector")


def partial_pose(robot: Mapping) -> Recording:
    """30 poses of a target of which a point and one axis are measured."""
    recording = _simulated(robot, _EXTERNAL.format(measures="external-pose", samples=30))
    rotations = Rotation.from_quat(np.stack([recording.columns[f"q{c}"] for c in "xyzw"], axis=1))
    axis = rotations.as_matrix()[:, :, 0]
    recording = _drop_columns(recording, "reflector", "qw", "qx", "qy", "qz")
    columns = {**recording.columns, **dict(zip(("nx", "ny", "nz"), axis.T))}
    return replace(recording, measures="partial-pose", columns=columns)


def distance(robot: Mapping) -> Recording:
    """60 lengths between the places of one reflector in two poses."""
    scene = _EXTERNAL.format(measures="external-point", samples=120)
    scene = scene.replace(
        "[[0.0, 40.0, 120.0], [60.0, -20.0, 130.0], [-60.0, -20.0, 125.0]]", "[[0, 40, 120]]"
    )
    recording = _simulated(robot, scene)
    ends = recording.points.reshape(-1, 2, 3)
    length = np.repeat(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), 2)
    recording = _drop_columns(recording, "reflector", "x_mm", "y_mm", "z_mm")
    pairs = np.repeat(np.arange(1.0, len(ends) + 1), 2)
    columns = {**recording.columns, "pair": pairs, "length_mm": length}
    return replace(recording, measures="distance", columns=columns)


def ball_centre(robot: Mapping) -> Recording:
    """36 views of three balls."""
    return _seeing_balls(robot, 36)


def ball_surface(robot: Mapping) -> Recording:
    """Twelve points on the surface of the ball in each of 30 views."""
    recording = _seeing_balls(robot, 30, _EXACT_MM)
    rng = np.random.default_rng(_SEED)
    count = 12
    centres = np.repeat(recording.points, count, axis=0)
    toward = -centres / np.linalg.norm(centres, axis=1, keepdims=True)
    sideways = rng.normal(size=centres.shape)
    normals = toward + 0.6 * sideways / np.linalg.norm(sideways, axis=1, keepdims=True)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = centres + 15.0 * normals + _SIGMA_MM * rng.normal(size=centres.shape)
    columns = {name: np.repeat(cells, count) for name, cells in recording.columns.items()}
    columns = {name: cells for name, cells in columns.items() if name not in ("range_mm", "time_s")}
    columns |= {"pose": columns["sample"] + 1, "sample": np.arange(1.0, len(points) + 1)}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    return replace(recording, measures="ball-surface", columns=columns, sigma_mm=_SIGMA_MM)


def target_pose(robot: Mapping) -> Recording:
    """20 poses of a marker that stands still, in the frame of a camera on the flange; no robot is needed."""
    rng = np.random.default_rng(_SEED)
    count = 20
    views = Rotation.from_rotvec(rng.normal(0.0, 0.35, (count, 3)))
    distance = np.stack([*rng.normal(0.0, 40.0, (2, count)), rng.uniform(300.0, 600.0, count)], 1)
    seen = transform(views.as_matrix(), distance)
    looking_down = Rotation.from_euler("x", 180.0, degrees=True).as_matrix()
    marker = transform(looking_down, np.array([700.0, 100.0, 50.0]))
    on_flange = Rotation.from_euler("xyz", [5.0, -4.0, 30.0], degrees=True).as_matrix()
    camera = transform(on_flange, np.array([30.0, -20.0, 60.0]))
    flange = marker @ inverse(seen) @ inverse(camera)
    noise = Rotation.from_rotvec(rng.normal(0.0, _SIGMA_RAD, (count, 3))).as_matrix()
    measured = transform(noise @ seen[:, :3, :3], seen[:, :3, 3] + rng.normal(0.0, 0.1, (count, 3)))
    columns = {"sample": np.arange(1.0, count + 1)}
    columns |= _columns_of(FLANGE, flange) | _columns_of((*POINT, *QUATERNION), measured)
    columns["fixed_to"] = np.full(count, "base")
    return Recording("target-pose", columns, {}, "example")


def _columns_of(names, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Position and unit quaternion of poses (n, 4, 4) under their seven names."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    cells = np.column_stack([poses[:, :3, 3], np.roll(quaternions, 1, axis=1)])
    return {name: _rounded(name[-2:], column) for name, column in zip(names, cells.T)}


def touch_point(robot: Mapping) -> Recording:
    """Four fixed points, each touched in 14 orientations."""
    arm = _arm(robot)
    rng = np.random.default_rng(_SEED)
    tip = np.array([15.0, 0.0, 140.0])
    contacts = []
    for number, point in enumerate(_points_in_reach(arm, rng, 4), 1):
        readings = arm.poses_with(14, rng, touching_point(tip, point), _SIGMA_MM)
        contacts.append((readings, {"point": number}))
    return _contacts(robot, arm, "touch-point", contacts)


def plane_touch(robot: Mapping) -> Recording:
    """Three planes, each touched at 35 places."""
    arm = _arm(robot)
    rng = np.random.default_rng(_SEED)
    tip = np.array([15.0, 0.0, 140.0])
    normals = np.array([[0.0, 0.0, 1.0], [0.96, 0.0, 0.28], [0.0, 0.96, 0.28]])
    contacts = []
    for number, (normal, point) in enumerate(zip(normals, _points_in_reach(arm, rng, 3)), 1):
        readings = arm.poses_with(
            35, rng, touching_plane(tip, normal, float(normal @ point)), _SIGMA_MM
        )
        contacts.append((readings, {"plane": number}))
    return _contacts(robot, arm, "plane-touch", contacts)


def laser_spot(robot: Mapping) -> Recording:
    """Ten points on one sphere, the beam through each in ten poses."""
    arm = _arm(robot)
    rng = np.random.default_rng(_SEED)
    axes = Rotation.from_euler("xyz", [12.0, -8.0, 0.0], degrees=True).as_matrix()
    beam = np.array([20.0, 10.0, 60.0]), axes
    centre = _points_in_reach(arm, rng, 1)[0]
    directions = rng.normal(size=(10, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    contacts = []
    for number, direction in enumerate(directions, 1):
        readings = arm.poses_with(
            10, rng, beam_through(beam, centre + 120.0 * direction), _SIGMA_MM
        )
        contacts.append((readings, {"point": number, "sphere": 1}))
    return _contacts(robot, arm, "laser-spot", contacts)


def _arm(robot: Mapping) -> TrueArm:
    return TrueArm.of(load_robot(robot, "robot of the template"), np.random.default_rng(_SEED))


def _points_in_reach(arm: TrueArm, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) mm of the base frame: places of the flange in moderate poses."""
    limits = arm.limits() / 2
    readings = rng.uniform(*limits.T, size=(count, len(limits)))
    return arm.flange(readings)[1]


def _contacts(robot: Mapping, arm: TrueArm, measures: str, contacts) -> Recording:
    """The recording of readings (n, R) with their groups; readings are rounded as a controller shows them."""
    readings = np.concatenate([part for part, _ in contacts])
    columns: dict[str, np.ndarray] = {"sample": np.arange(1.0, len(readings) + 1)}
    for name in contacts[0][1]:
        columns[name] = np.concatenate(
            [np.full(len(part), float(keys[name])) for part, keys in contacts]
        )
    for joint, cells in enumerate(readings.T, 1):
        slides = arm.robot.prismatic[joint - 1]
        columns[f"q{joint}_{'mm' if slides else 'deg'}"] = np.round(
            cells if slides else np.rad2deg(cells), 5
        )
    return Recording(measures, columns, robot, "example", _SIGMA_MM)


def _seeing_balls(robot: Mapping, samples: int, sigma_mm: float = _SIGMA_MM) -> Recording:
    """Views of three balls at the first distance from the base at which the arm can look at them."""
    loaded = load_robot(robot, "robot of the template")
    reach = float(np.abs(loaded.geometry[:, 1:3]).sum())
    for share in _DISTANCES:
        try:
            scene = _BALLS.format(samples=samples, x=-share * reach, sigma=sigma_mm)
            return _simulated(robot, scene)
        except InputError as problem:
            failure = problem
    raise failure


def _simulated(robot: Mapping, scene: str) -> Recording:
    import tomli_w

    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        if "builtin" in robot:
            scene = scene.replace('"robot.toml"', f'"{robot["builtin"]}"')
        else:
            (path.parent / "robot.toml").write_text(tomli_w.dumps(dict(robot)), encoding="utf-8")
        path.write_text(scene, encoding="utf-8")
        recording = simulate(path)
    columns = {name: _rounded(name, cells) for name, cells in recording.columns.items()}
    columns["sample"] = columns["sample"] + 1
    return replace(recording, columns=columns, robot=robot)


def _rounded(name: str, cells: np.ndarray) -> np.ndarray:
    return np.round(cells, 9 if name in ("qw", "qx", "qy", "qz") else 5)


def _drop_columns(recording: Recording, *names: str) -> Recording:
    columns = {name: cells for name, cells in recording.columns.items() if name not in names}
    return replace(recording, columns=columns)


EXAMPLES = {
    "ball-centre": ball_centre,
    "external-point": external_point,
    "external-pose": external_pose,
    "partial-pose": partial_pose,
    "target-pose": target_pose,
    "touch-point": touch_point,
    "laser-spot": laser_spot,
    "distance": distance,
    "plane-touch": plane_touch,
    "ball-surface": ball_surface,
}
"""Kind -> function of the robot's keys."""
