"""Calibrated arms for tests of exports, their readings, and the description of a cell in URDF."""

from dataclasses import replace

import numpy as np

from robot_model import load_robot
from robot_model.chain import forward
from robot_model.effects import CATALOGUE
from robot_model.measurements.closure import flange_matrices
from workbench.core.rigid import transform
from workbench.files.exports.python import python_module
from workbench.files.solution_file import CalibratedArm

GEOMETRY = ("theta", "d", "a", "alpha", "beta")


SIZES = np.array([5e-4, 0.1, 0.1, 5e-4, 5e-4])


CURVE = {"port": "joint", "names": ["q2"], "spans": [[-1.5, 1.5]], "unit": "rad", "sizes": [3e-4]}


def arm_with(spec, rows, seed=0, values=None):
    """An arm with small errors in every length and angle, and effects of typical size or of given `values`."""
    robot = spec if hasattr(spec, "geometry") else load_robot(spec)
    rng = np.random.default_rng(seed)
    moved = robot.geometry + rng.normal(size=robot.geometry.shape) * SIZES
    known = {
        f"joint-{k + 1}.{name}{k + 1}": moved[k, c]
        for k in range(robot.joints)
        for c, name in enumerate(GEOMETRY)
    }
    effects = tuple(CATALOGUE[name](where, **options) for name, where, options in rows)
    keys = {} if hasattr(spec, "geometry") else {"robot": spec}
    arm = CalibratedArm(
        robot,
        effects,
        known,
        (),
        np.zeros((0, 0)),
        np.array([10.0, -20, 60]),
        0.05,
        True,
        "",
        keys,
    )
    chain = chain_of(robot)
    for effect in effects:
        for parameter in effect.parameters(chain):
            known[parameter.key] = parameter.typical * rng.uniform(0.5, 1.5)
    return replace(arm, values=known | (values or {}))


def chain_of(robot):
    """Just enough of a chain for an effect to say its parameters."""
    from robot_model.state import State
    from robot_model.system import RobotChain
    from workbench.files.exports.python.runtime import Flange

    zero = np.zeros((robot.joints, 1))
    blank = np.zeros((3, 1))
    columns = {"row": np.zeros(1), "temperature_c": np.full(1, 20.0)}
    state = State(
        robot,
        zero,
        columns,
        robot.gravity,
        np.ones(1),
        np.zeros(3),
        blank,
        np.ones(1, int),
        blank,
    )
    return RobotChain(robot, Flange(), zero, np.ones((1, 1)), state, np.zeros(0), np.ones((1, 1)))


def readings_of(robot, n=12, seed=1):
    """(n, R) rad, mm."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (n, robot.mixing.shape[1])) * np.where(robot.prismatic, 60, 1)


def covariates_of(n):
    rng = np.random.default_rng(2)
    sides = {f"approach{k}": rng.choice([-1.0, 1.0], n) for k in range(1, 7)}
    return sides | {
        "payload_kg": np.linspace(0, 3, n),
        "temperature_c": np.linspace(18, 30, n),
        "time_s": np.arange(n, dtype=float),
    }


def exported(arm):
    """The names of the executed module."""
    module: dict = {"__name__": "exported"}
    exec(python_module(arm), module)
    return module


URDF = """<?xml version="1.0"?>
<!-- our cell, do not edit by hand -->
<robot name="cell">
  <link name="world"/>
  <link name='base_link'><visual><geometry><mesh filename="package://cell/base.stl"/></geometry></visual></link>
  <joint name="mount" type="fixed"><origin xyz="0.1 0.2 0.3" rpy="0 0 0.5"/><parent link="world"/><child link="base_link"/></joint>
  <link name="shoulder"><inertial><mass value="9"/><origin xyz="0 0 0.1" rpy="0 0 0"/></inertial></link>
  <joint name="pan" type="revolute">
    <parent link="base_link"/><child link="shoulder"/>   <!-- the pan axis > here -->
    <origin   rpy='0 0 0'
              xyz="0 0 0.29"/>
    <axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8" effort="1" velocity="1"/>
  </joint>
  <link name="upper"/>
  <joint name="lift" type="revolute"><parent link="shoulder"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1.9" upper="1.9" effort="1" velocity="1"/></joint>
  <link name="fore"/>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.27"/><axis xyz="0 1 0"/>
    <limit lower="-1.9" upper="1.2" effort="1" velocity="1"/></joint>
  <link name="roll"/>
  <joint name="wrist1" type="revolute"><parent link="fore"/><child link="roll"/><origin xyz="0.302 0 0.07"/><axis xyz="1 0 0"/>
    <limit lower="-2.7" upper="2.7" effort="1" velocity="1"/></joint>
  <link name="bend"/>
  <joint name="wrist2" type="revolute"><parent link="roll"/><child link="bend"/><origin xyz="0 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="end"/>
  <joint name="wrist3" type="revolute"><parent link="bend"/><child link="end"/><origin xyz="0.072 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-6" upper="6" effort="1" velocity="1"/></joint>
  <link name="tool0"/>
  <joint name="tool_fixed" type="fixed"><origin xyz="0 0 0" rpy="0 1.5707963267948966 0"/><parent link="end"/><child link="tool0"/></joint>
  <gazebo reference="tool0"><origin xyz="9 9 9"/></gazebo>
</robot>
"""


def flanges(robot, readings, geometry=None):
    frames = forward(robot, robot.mixing @ readings.T, geometry)
    return transform(flange_matrices(frames), frames.end_origin.T)


def write_urdf(folder, text=URDF):
    path = folder / "cell.urdf"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    return {"urdf": str(path), "tip": "tool0"}
