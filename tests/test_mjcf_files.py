"""MJCF files as they are published: included files, classes of defaults, references, objects around the arm."""

import numpy as np
import pytest

from export_scenes import flanges, readings_of
from robot_model import load_robot
from robot_model.mjcf import unread
from robot_model.state import State
from robot_model.statics import STANDARD_GRAVITY
from workbench.core.errors import InputError
from workbench.explanation.reference import reference_of

ARM = """<mujoco model="arm">
  <compiler angle="radian" meshdir="assets"/>
  <default>
    <geom density="2700" type="capsule"/>
    <default class="drive">
      <joint axis="0 0 1" range="-2.9 2.9" damping="1" stiffness="3"/>
      <general biastype="affine" forcerange="-87 87"/>
      <default class="steel"><geom density="7850" type="cylinder" size="0.03 0.05"/></default>
      <default class="finger"><joint axis="0 1 0" type="slide" range="0 0.04"/></default>
      <default class="skin"><geom type="mesh" contype="0" conaffinity="0" density="0"/></default>
    </default>
  </default>
  <worldbody>
    <body name="foot" pos="0.3 0.1 0.05" euler="0.1 0.2 0.3" childclass="drive">
      <geom type="box" size="0.1 0.1 0.05"/>
      <body name="turret" pos="0 0 0.15">
        <joint name="joint1"/>
        <geom fromto="0 0 0 0 0.02 0.2" size="0.06"/>
        <body name="upper" pos="0 0 0.25" quat="1 -1 0 0">
          <joint name="joint2" ref="0.4" range="-1.7 1.9" pos="0 0.02 0"/>
          <geom class="steel" fromto="0 0 0 0.3 0 0.1" size="0.05"/>
          <geom class="steel" pos="0.3 0 0.1" euler="1.5 0 0"/>
          <body name="fore" pos="0.31 0 0.1" euler="0.3 1.2 0">
            <joint name="joint3" stiffness="0"/>
            <inertial mass="2.5" pos="0.1 0.02 -0.03" diaginertia="0.1 0.1 0.1"/>
            <body name="wrist" pos="0.25 0 0.1" axisangle="0 1 0 1.5">
              <joint name="joint4" axis="0.6 0 0.8"/>
              <geom type="ellipsoid" size="0.04 0.04 0.06"/>
              <body name="hand" pos="0 0 0.08" zaxis="0 1 1">
                <joint name="joint5" axis="1 0 0"/>
                <geom type="sphere" size="0.03" pos="0 0 0.02"/>
                <site name="tcp" pos="0 0 0.1"/>
                <body name="left" pos="0 0.01 0.05"><joint name="grip1" class="finger"/>
                  <inertial mass="0.015" pos="0 0 0" diaginertia="2e-6 2e-6 1e-6"/></body>
                <body name="right" pos="0 -0.01 0.05"><joint name="grip2" class="finger"/>
                  <inertial mass="0.015" pos="0 0 0" diaginertia="2e-6 2e-6 1e-6"/></body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="split"><joint joint="grip1" coef="0.5"/><joint joint="grip2" coef="0.5"/></fixed>
  </tendon>
  <equality><joint joint1="grip1" joint2="grip2"/></equality>
  <actuator>
    <general class="drive" joint="joint1"/><general class="drive" joint="joint2"/>
    <general class="drive" joint="joint3"/><general class="drive" joint="joint4"/>
    <general class="drive" joint="joint5"/><general class="drive" tendon="split"/>
  </actuator>
</mujoco>
"""
SCENE = """<mujoco model="cell">
  <include file="parts/arm.xml"/>
  <worldbody>
    <geom type="plane" size="0 0 0.05"/>
    <body name="box" pos="0.5 0 0.1"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
    <body name="pendulum" pos="2 0 1"><joint type="ball"/><geom type="sphere" size="0.02"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.xml").write_text(ARM)
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return path


def test_a_published_scene_is_read_as_mujoco_reads_it(scene):
    """The flange at the site, and the torques of gravity, at readings that are MuJoCo's own."""
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo")
    robot = load_robot(scene)
    readings = readings_of(robot, 6)
    frames, torques = flanges(robot, readings), _torques(robot, readings)
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    joints = [model.joint(f"joint{k}") for k in range(1, 6)]
    for k, reading in enumerate(readings):
        for joint, angle in zip(joints, reading):
            data.qpos[joint.qposadr] = angle
        mujoco.mj_forward(model, data)
        where = data.site_xpos[model.site("tcp").id]
        np.testing.assert_allclose(1e3 * where, frames[k, :3, 3], atol=1e-6)
        torque = [data.qfrc_bias[joint.dofadr[0]] for joint in joints]
        np.testing.assert_allclose(-torques[:, k], torque, atol=1e-6)


def _torques(robot, readings) -> np.ndarray:
    """(J, n) N m of gravity as MuJoCo has it, 9.81 m/s^2."""
    n = len(readings)
    blank = np.zeros((3, n))
    still = np.zeros(n), np.zeros(3), blank, np.ones(n, int), blank
    state = State(robot, robot.mixing @ readings.T, {}, robot.gravity, *still)
    return state.torque * 9.81 / STANDARD_GRAVITY


def test_a_simulation_takes_tip_and_joints_of_the_recording_where_it_has_them(scene, tmp_path):
    """A gripper whose fingers end alike has no last link of its own."""
    fingers = ARM.replace('<site name="tcp" pos="0 0 0.1"/>', "")
    (tmp_path / "parts" / "arm.xml").write_text(fingers)
    with pytest.raises(InputError, match="left, right; choose one of them as tip"):
        reference_of(scene, None, {"tip": "elsewhere"})
    found = reference_of(scene, None, {"tip": "hand", "joints": ["joint1", "joint2"]})
    assert found.robot.joints == 2 and found.robot_keys["tip"] == "hand"


def test_springs_of_a_class_are_said(scene):
    said = " ".join(unread(scene))
    assert "springs of the joints joint1, joint2, joint4, joint5" in said


def test_an_arm_on_a_free_base_is_refused_with_its_joint(scene, tmp_path):
    floating = ARM.replace('childclass="drive">', 'childclass="drive"><freejoint name="loose"/>', 1)
    (tmp_path / "parts" / "arm.xml").write_text(floating)
    with pytest.raises(InputError, match="joint loose: expected type hinge or slide, found free"):
        load_robot(scene)
