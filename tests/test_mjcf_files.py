"""MJCF files as they are published: included files, classes of defaults, references, objects around the arm."""

import filecmp
from pathlib import Path

import numpy as np
import pytest

from datasets.formats.recording1 import read_recording
from export_scenes import arm_with, flanges, readings_of
from robot_model import load_robot
from robot_model.files.mjcf import unread
from robot_model.state import State
from robot_model.statics import STANDARD_GRAVITY
from workbench.app.wizard.files import Dropped
from workbench.commands.robot.export_arm import ArmOptions, export_arm
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import copy_description
from workbench.explanation.comparison.reference import reference_of
from workbench.recordings.importing.chain import ImportOptions, import_recording
from workbench.recordings.templates.write import write_template

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
    with pytest.raises(InputError, match='left, right; name one of them: tip = "left"'):
        reference_of(scene, None, {"tip": "elsewhere"})
    found = reference_of(scene, None, {"tip": "hand", "joints": ["joint1", "joint2"]})
    assert found.robot.joints == 2 and found.robot_keys["tip"] == "hand"


TWO = ("left", "right")


def cell(arms, is_driven: bool = True, sites=TWO) -> str:
    """An MJCF file of arms in one cell: pairs of a name and a number of joints."""
    bodies, servos = "", ""
    for place, (arm, count) in enumerate(arms):
        site = f'<site name="{arm}/tcp" pos="0.05 0 0"/>' if arm in sites else ""
        links = [
            f'<body pos="{0 if k else place} 0 0.3"><joint name="{arm}{k + 1}" axis="{k % 2} {1 - k % 2} 0"/>'
            for k in range(count)
        ]
        bodies += "".join(links) + site + "</body>" * count
        servos += "".join(f'<position joint="{arm}{k + 1}"/>' for k in range(count))
    servos = f"<actuator>{servos}</actuator>" if is_driven else ""
    return f'<mujoco model="cell"><worldbody>{bodies}</worldbody>{servos}</mujoco>'


@pytest.mark.parametrize("is_driven", [True, False])
@pytest.mark.parametrize("counts", [(6, 6), (6, 5)])
@pytest.mark.parametrize("sites", [TWO, TWO[:1]])
def test_of_several_arms_the_flange_names_one(tmp_path, is_driven, counts, sites):
    """None is taken without a word; servos of the other arm are no readings of this one."""
    file = tmp_path / "cell.xml"
    file.write_text(cell(list(zip(TWO, counts)), is_driven, sites))
    with pytest.raises(InputError, match="left/tcp, .*name one of them: .* or cell.xml#left/tcp"):
        load_robot(file)
    left = load_robot(f"{file}#left/tcp")
    assert left.joints == 6 and left.base[0, 3] == 0
    if sites == TWO:
        right = load_robot({"urdf": str(file), "tip": "right/tcp"})
        assert right.joints == counts[1] and right.base[0, 3] == 1000
    found = reference_of(f"{file}#left/tcp", None, {"tip": "right/tcp"})
    assert found.robot_keys["tip"] == "left/tcp"


def test_a_positioner_is_no_second_arm(tmp_path):
    file = tmp_path / "cell.xml"
    file.write_text(cell([("arm", 6), ("table", 2)], is_driven=False))
    assert load_robot(file).joints == 6


def test_an_example_recording_takes_one_arm_of_a_file(tmp_path, monkeypatch):
    """By a relative path, although the example is simulated in another folder."""
    (tmp_path / "cell.xml").write_text(cell([("left", 6), ("right", 6)]))
    monkeypatch.chdir(tmp_path)
    write_template("external-point", tmp_path / "new", "cell.xml#right/tcp")
    robot = read_recording(tmp_path / "new").robot
    assert robot["tip"] == "right/tcp" and load_robot(robot).joints == 6


def test_springs_of_a_class_are_said(scene):
    said = " ".join(unread(scene))
    assert "springs of the joints joint1, joint2, joint4, joint5" in said


def test_an_arm_on_a_free_base_is_refused_with_its_joint(scene, tmp_path):
    floating = ARM.replace('childclass="drive">', 'childclass="drive"><freejoint name="loose"/>', 1)
    (tmp_path / "parts" / "arm.xml").write_text(floating)
    with pytest.raises(InputError, match="joint loose: expected type hinge or slide, found free"):
        load_robot(scene)


def test_tables_are_imported_with_an_mjcf_file_as_robot(scene, tmp_path):
    """The recording depends on no other file: what the scene includes is in its robot.xml."""
    robot = load_robot(scene)
    readings = readings_of(robot, 40)
    frames = flanges(robot, readings)
    points = frames[:, :3, :3] @ [20.0, -30.0, 90.0] + frames[:, :3, 3]
    points += np.random.default_rng(1).normal(0, 0.05, points.shape)
    table = tmp_path / "log.csv"
    rows = np.column_stack([np.rad2deg(readings), points])
    head = ",".join([*(f"A{k} [deg]" for k in range(1, 6)), "X [mm]", "Y [mm]", "Z [mm]"])
    np.savetxt(table, rows, delimiter=",", header=head, comments="")
    import_recording([table], tmp_path / "made", ImportOptions(robot=f"{scene}#tcp"))
    (scene.parent / "parts" / "arm.xml").unlink()
    read = read_recording(tmp_path / "made")
    assert Path(read.robot["urdf"]).name == "robot.xml"
    np.testing.assert_allclose(flanges(load_robot(read.robot), readings), frames, atol=1e-9)
    assert read.robot["tip"] == "tcp"
    assert 'robot = "robot.xml#tcp"' in (tmp_path / "made" / "import.toml").read_text()


def test_a_linear_axis_without_a_joint_column_is_named_with_its_line(tmp_path):
    """Its header is no name of a joint; as a length that nothing else reads it stands in its place."""
    file = tmp_path / "rail.xml"
    rail = '<body pos="0 0 0.4"><joint name="rail" type="slide" axis="1 0 0" range="0 1"/>'
    text = cell([("arm", 5)], sites=("arm",), is_driven=False)
    text = text.replace("<worldbody>", f"<worldbody>{rail}").replace(
        "</worldbody>", "</body></worldbody>"
    )
    file.write_text(text)
    rng = np.random.default_rng(2)
    rows = np.column_stack([rng.uniform(0, 900, 30), rng.uniform(-50, 50, (30, 8))])
    head = ["Schiene [mm]", *(f"A{k} [deg]" for k in range(1, 6)), "X [mm]", "Y [mm]", "Z [mm]"]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(head), comments="")
    with pytest.raises(
        InputError, match=r'columns = \["Schiene \[mm\]", "A1 \[deg\]", .*"A5 \[deg\]"\] '
    ):
        import_recording([tmp_path / "log.csv"], tmp_path / "made", ImportOptions(robot=str(file)))


def test_an_mjcf_file_without_included_files_is_copied_as_it_is(scene, tmp_path):
    arm = scene.parent / "parts" / "arm.xml"
    name = copy_description(arm, tmp_path)
    assert name == "robot.xml" and filecmp.cmp(arm, tmp_path / name, shallow=False)


def test_a_dropped_mjcf_file_is_a_robot_and_other_xml_a_table():
    dropped = Dropped()
    dropped.add([{"name": "arm.xml", "content": ARM.encode()}])
    dropped.add([{"name": "log.xml", "content": b"<points><point x='1'/></points>"}])
    assert dropped.robots == ["arm.xml"]
    assert [path.name for path in dropped.sources(())] == ["log.xml"]


def test_an_arm_of_an_mjcf_file_is_exported_as_a_bare_urdf(scene, tmp_path, monkeypatch):
    """There is no URDF to patch, unless one is named."""
    from workbench.jobs.robot.compensation import correction_limits

    arm = arm_with({"urdf": str(scene)}, [])
    monkeypatch.setattr("workbench.files.solution_file.read_solution", lambda path: arm)
    monkeypatch.setattr(correction_limits, "checked", lambda arm, path, force: arm)
    file = tmp_path / "arm.urdf"
    made = export_arm(tmp_path, "urdf", file, ArmOptions())
    file.write_text(str(made.texts[file]))
    assert load_robot(file).joints == 5
