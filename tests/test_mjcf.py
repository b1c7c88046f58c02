"""An arm read from MJCF stands where MuJoCo itself puts it, with MuJoCo's masses and limits."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w

import datasets
from datasets.recording import Recording
from export_scenes import arm_with, flanges, readings_of
from robot_model import load_robot
from robot_model.chain import forward
from robot_model.effects import CATALOGUE
from robot_model.files.mjcf import terms_of, unread
from robot_model.state import State
from scenes import ABB
from test_exports_arm import SPRINGS
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.explanation.comparison.reference import reference_of
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.mjcf import mjcf
from workbench.files.exports.urdf import urdf
from workbench.jobs.robot.compensation.compensate import actual_poses
from workbench.jobs.robot.simulate import simulate

MJCF_CELL = """<mujoco model="cell">
  <compiler angle="degree" autolimits="true"/>
  <option gravity="0 0.5 -9.8"/>
  <default><joint axis="0 0 1"/><default class="elbow"><joint axis="0 1 0" range="-120 120"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="foot" pos="0.1 0.2 0.3" euler="0 0 30">
      <geom type="box" size="0.1 0.1 0.1"/>
      <body name="turret" pos="0 0 0.29">
        <joint name="pan" range="-165 165"/>
        <inertial pos="0.01 0.02 -0.1" mass="7" diaginertia="1 1 1"/>
        <body name="upper" childclass="elbow">
          <joint name="lift" pos="0.01 0.05 0.02"/>
          <geom type="capsule" size="0.05 0.1" pos="0 0 0.1" mass="4"/>
          <geom type="sphere" size="0.04" pos="0 0.1 0.2"/>
          <body name="fore" pos="0 0 0.27" axisangle="0 0 1 20">
            <joint name="elbow"/>
            <joint name="twist" axis="1 0 0" range="-160 160" pos="0.1 0 0.07"/>
            <inertial pos="0.1 0 0.05" mass="3" diaginertia="1 1 1"/>
            <body name="wrist" pos="0.302 0 0.07" xyaxes="1 0 0 0 0.8 0.6">
              <joint name="bend"/>
              <inertial pos="0 0 0.01" mass="1" diaginertia="1 1 1"/>
              <body name="hand" pos="0.072 0 0" quat="0.7 0 0.7 0.1">
                <joint name="roll" axis="0 0 1"/>
                <inertial pos="0 0 0.03" mass="0.5" diaginertia="1 1 1"/>
                <body name="finger"><joint name="grip" type="slide" axis="1 0 0" range="0 0.03"/>
                  <inertial pos="0 0 0.1" mass="0.1" diaginertia="1 1 1"/></body>
                <site name="flange" pos="0 0 0.05" euler="10 20 30"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="pan" kp="100"/><position joint="lift" kp="100"/><position joint="elbow" kp="100"/>
    <position joint="twist" kp="100"/><position joint="bend" kp="100"/><position joint="roll" kp="100"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def cell_file(tmp_path):
    path = tmp_path / "cell.xml"
    path.write_text(MJCF_CELL)
    return path


def test_the_flange_and_the_torques_are_those_of_mujoco(cell_file):
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo")
    robot = load_robot(cell_file)
    model = mujoco.MjModel.from_xml_path(str(cell_file))
    data = mujoco.MjData(model)
    readings = readings_of(robot, 8)
    n = len(readings)
    frames = flanges(robot, readings)
    blank = np.zeros((3, n))
    variables = robot.mixing @ readings.T
    state = State(
        robot,
        variables,
        {},
        robot.gravity,
        np.zeros(n),
        np.zeros(3),
        blank,
        np.ones(n, int),
        blank,
    )
    site = model.site("flange").id
    strength = np.linalg.norm(model.opt.gravity) / 9.80665
    for k, reading in enumerate(readings):
        data.qpos[:6] = reading
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(1e3 * data.site_xpos[site], frames[k, :3, 3], atol=1e-6)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3), frames[k, :3, :3], atol=1e-9)
        torque = -data.qfrc_bias[:6]
        np.testing.assert_allclose(state.torque[:, k] * strength, torque, atol=1e-3)
    np.testing.assert_allclose(np.rad2deg(robot.limits[:2]), [[-165, 165], [-120, 120]], atol=1e-9)
    assert forward(robot, variables).end_origin.shape == (3, n)


def test_what_a_foreign_file_says_and_is_not_taken_over_is_said(cell_file):
    said = unread(cell_file)
    assert len(said) == 1 and "servos are taken as rigid" in said[0]
    cell_file.write_text(MJCF_CELL.replace('name="roll" axis', 'name="roll" stiffness="5" axis'))
    assert "springs of the joints roll are taken as rigid" in unread(cell_file)[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<worldbody>", '<include file="a.xml"/><worldbody>', "a.xml: expected a readable MJCF"),
        ("<worldbody>", '<include file="cell.xml"/><worldbody>', "files that include one another"),
        ('name="roll" axis="0 0 1"', 'name="roll" type="ball"', "joint roll: expected type hinge"),
        ('pos="0 0 0.29"', 'pos="0 0"', "expected 3 finite number"),
        ("</mujoco>", "", "mistake|one of|xml"),
        ('<site name="flange"', '<site name="elsewhere"', None),
    ],
)
def test_a_broken_file_is_a_sentence(cell_file, old, new, words):
    cell_file.write_text(MJCF_CELL.replace(old, new))
    if words is None:
        assert load_robot({"urdf": str(cell_file), "tip": "elsewhere"}).joints == 6
        with pytest.raises(InputError, match="the tip to be a link"):
            load_robot({"urdf": str(cell_file), "tip": "flange"})
        return
    with pytest.raises(InputError, match=words):
        load_robot({"urdf": str(cell_file)})


@pytest.mark.parametrize("case", SPRINGS)
def test_an_exported_model_read_back_is_the_calibrated_arm_with_its_terms(case, tmp_path):
    rows, values = SPRINGS[case]
    arm = arm_with(ABB, rows, values=values)
    path = tmp_path / "arm.xml"
    path.write_text(mjcf(arm))
    again = load_robot({"urdf": str(path), "tip": "flange"})
    readings = readings_of(again)
    offset = np.zeros(6)
    offset[2] = arm.values.get("joint-3.zero-offset.k0", 0.0)
    wanted = flanges(arm.robot, readings + offset, calibrated_geometry(arm))
    np.testing.assert_allclose(flanges(again, readings), wanted, atol=1e-6)
    np.testing.assert_allclose(again.payload_com, arm.load_centre, atol=1e-6)
    held = terms_of(path)
    effects = make_effects(
        CATALOGUE, [(e.pop("effect"), e.pop("where"), e) for e in held["effects"]]
    )
    assert [e.title for e in effects] == [e.title for e in arm.effects]
    assert all(arm.values[key] == value for key, value in held["values"].items())


def test_joints_keep_the_names_of_the_file_of_the_calibration(cell_file, tmp_path):
    """In both formats; an arm of a table has numbered joints, and a recording against the file says the numbers."""
    names = ("pan", "lift", "elbow", "twist", "bend", "roll")
    arm = arm_with({"urdf": str(cell_file)}, ())
    (tmp_path / "out.xml").write_text(mjcf(arm))
    (tmp_path / "out.urdf").write_text(urdf(arm))
    for file in ("out.xml", "out.urdf"):
        assert load_robot(tmp_path / file).joint_names == names
    assert 'joint="joint_6"' in mjcf(arm_with(ABB, ()))
    notes = " ".join(reference_of(cell_file, None).notes)
    assert "numbered along the chain of cell.xml: 1 pan, 2 lift, 3 elbow" in notes
    (tmp_path / "numbered.xml").write_text(mjcf(arm_with(ABB, ())))
    assert "numbered" not in " ".join(reference_of(tmp_path / "numbered.xml", None).notes)


@pytest.mark.parametrize("case", SPRINGS)
def test_an_exported_model_as_a_simulation_predicts_as_the_arm_does(case, tmp_path):
    """First moments, offsets and tilts are in the bodies of the file: as terms, too, they counted twice."""
    rows, values = SPRINGS[case]
    arm = arm_with(ABB, rows, values=values)
    path = tmp_path / "arm.xml"
    path.write_text(mjcf(arm))
    read = reference_of(path, None)
    again = replace(arm, robot=read.robot, effects=read.effects, values=dict(read.values))
    readings, covariates = readings_of(arm.robot), {"payload_kg": np.linspace(0, 3, 12)}
    wanted = actual_poses(arm, readings, covariates)
    found = actual_poses(again, readings, covariates)
    rigid = actual_poses(replace(arm, effects=()), readings, covariates)
    effect = np.abs(wanted - rigid)[:, :3, 3].max()
    assert np.abs(found - wanted)[:, :3, 3].max() < 2e-4 + 0.01 * effect  # of second order


def test_a_recording_of_an_mjcf_cell_is_written_and_read(cell_file, tmp_path):
    scene = {
        "robot": "cell.xml",
        "samples": 12,
        "sigma_mm": 0.02,
        "reflectors": [[0.0, 0.0, 50.0]],
        "share_of_limits": 0.3,
    }
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(scene))
    made = simulate(path)
    again = datasets.read(datasets.write(made, tmp_path / "recording"))
    np.testing.assert_allclose(again.points, made.points, atol=1e-5)
    assert load_robot(again.robot).joints == 6


def test_arrays_with_the_path_of_an_mjcf_file_make_a_recording(cell_file):
    rng = np.random.default_rng(5)
    joints, points = rng.uniform(-5, 5, (9, 6)), rng.uniform(-100, 100, (9, 3))
    made = Recording.from_arrays(str(cell_file), joints, points)
    assert load_robot(made.robot).joints == 6
