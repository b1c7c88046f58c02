"""Cartesian stiffness: MuJoCo's deflection under a wrench, symmetry, units, and files that other programs read."""

import json
import re
import tomllib

import numpy as np
import pytest

from conftest import ROOT
from export_scenes import arm_with, readings_of
from robot_model import load_robot
from scenes import ABB
from workbench.core.errors import InputError
from workbench.files.exports.mjcf import mjcf
from workbench.jobs.robot.stiffness import (
    ELEMENTS,
    MODELS,
    cartesian_stiffness,
    save,
    stiffness_columns,
)

ROWS = [
    *(("joint-compliance", f"joint-{k}", {}) for k in range(1, 7)),
    ("bearing-compliance", "joint-2", {}),
    ("link-compliance", "link-2", {}),
    ("link-compliance", "link-3", {}),
    ("pedestal-compliance", "base", {}),
]
TOOL = np.array([20.0, -30.0, 80.0])
WRENCH = np.array([40.0, -25.0, 60.0, 1.5, -2.0, 1.0])


def compliant(rows=ROWS):
    arm = arm_with(ABB, rows)
    small = {key: 2e-6 for key in arm.values if key.count(".") == 2}
    small |= {"joint-1.joint-compliance.compliance": 5e-6, "base.pedestal-compliance.about_y": 1e-6}
    return arm_with(ABB, rows, values={k: v for k, v in small.items() if k in arm.values})


def test_mujoco_deflects_by_as_much_under_a_wrench():
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo")
    from mujoco_statics import pose_of, settle

    arm = compliant()
    readings = readings_of(arm.robot, 6)
    found = cartesian_stiffness(arm, readings, TOOL)
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    site, body = model.site("flange").id, model.body("flange").id
    expected = sum(found.deflection(WRENCH).values())
    for reading, point, moved in zip(readings, found.points, expected):
        settle(model, data, reading)
        before = pose_of(data, site)
        # a wrench at the tool point, as force and moment at the body's centre of mass
        lever = (point - 1e3 * data.xipos[body]) * 1e-3
        force = np.concatenate([WRENCH[:3], WRENCH[3:] + np.cross(lever, WRENCH[:3])])
        after = loaded(mujoco, model, data, reading, body, force)
        shift = (after @ np.append(TOOL, 1) - before @ np.append(TOOL, 1))[:3]
        turn = after[:3, :3] @ before[:3, :3].T
        rotation = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        np.testing.assert_allclose(shift, moved[:3], atol=2e-3 * np.abs(moved[:3]).max())
        np.testing.assert_allclose(rotation, moved[3:], atol=2e-3 * np.abs(moved[3:]).max())


def loaded(mujoco, model, data, reading, body, force):
    """Pose of the flange at rest with a constant wrench on a body."""
    from mujoco_statics import pose_of

    stiffness = np.ravel(
        model.jnt_stiffness[:, 0] if model.jnt_stiffness.ndim > 1 else model.jnt_stiffness
    ).copy()
    for actuator in range(model.nu):
        stiffness[model.actuator_trnid[actuator, 0]] += model.actuator_gainprm[actuator, 0]
    data.xfrc_applied[body] = force
    for _ in range(80):
        mujoco.mj_forward(model, data)
        total = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, force[:3], force[3:], data.xipos[body], body, total)
        step = (data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias + total) / stiffness
        data.qpos[:] += step
        if np.abs(step).max() < 1e-13:
            break
    mujoco.mj_forward(model, data)
    data.xfrc_applied[body] = 0
    return pose_of(data, model.site("flange").id)


def test_compliance_is_symmetric_and_stiffness_its_inverse():
    found = cartesian_stiffness(compliant(), readings_of(compliant().robot, 5), TOOL)
    metres = found.total * np.array([1e-3, 1e-3, 1e-3, 1, 1, 1])[:, None]
    np.testing.assert_allclose(metres, metres.transpose(0, 2, 1), rtol=0, atol=1e-18)
    product = found.stiffness @ found.total
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-6)
    assert set(found.compliance) == set(ELEMENTS) and (found.translational()[:, 0] > 0).all()


def test_a_direction_that_does_not_deflect_has_no_finite_stiffness():
    arm = compliant([("joint-compliance", "joint-2", {})])
    found = cartesian_stiffness(arm, readings_of(arm.robot, 3))
    assert np.isnan(found.stiffness).all() and (found.compliance["bearing"] == 0).all()
    with pytest.raises(InputError, match="holds no compliance"):
        cartesian_stiffness(arm_with(ABB, ()), readings_of(arm.robot, 3))


def test_the_files_hold_what_was_computed(tmp_path):
    arm = compliant()
    found = cartesian_stiffness(arm, readings_of(arm.robot, 7), TOOL)
    save(found, WRENCH, tmp_path)
    columns = stiffness_columns(found, WRENCH)
    table = np.genfromtxt(tmp_path / "stiffness.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["deflection_mm"], columns["deflection_mm"], rtol=1e-8)
    np.testing.assert_array_equal(np.load(tmp_path / "compliance.npy"), found.total)
    import pyvista

    mesh = pyvista.read(tmp_path / "map.vtk")
    moved = sum(found.deflection(WRENCH).values())[:, :3]
    np.testing.assert_allclose(mesh["deflection_vector_mm"], moved, rtol=1e-6, atol=1e-12)
    models = np.genfromtxt(tmp_path / "models.csv", delimiter=",", names=True)
    assert models.dtype.names == ("rigid_mm", *MODEL_COLUMNS)
    np.testing.assert_allclose(models[MODEL_COLUMNS[-1]], columns["deflection_mm"], rtol=1e-8)
    np.testing.assert_allclose(mesh.points, found.points, rtol=1e-6)
    np.testing.assert_allclose(mesh["deflection_mm"], columns["deflection_mm"], rtol=1e-6)
    assert (
        "mm)" in (tmp_path / "map.svg").read_text() or (tmp_path / "map.pdf").stat().st_size > 5000
    )


def test_the_command_says_how_much_each_part_deflects(workbench, tmp_path):
    keys = solution_of(compliant())
    (tmp_path / "solution.json").write_text(json.dumps(keys))
    (tmp_path / "t.csv").write_text(
        "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,10,10,0,30,0\n9,9,9,9,9,9\n"
    )
    done = workbench(
        "stiffness",
        "solution.json",
        "t.csv",
        "--wrench",
        *("100", "0", "0", "0", "0", "0"),
        "--json",
        "a.json",
        "--out",
        "run",
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads((tmp_path / "a.json").read_text())
    parts = answer["deflection_rms_mm"]
    assert all(parts[part] > 0 for part in ELEMENTS) and parts["total"] > parts["link"]
    assert (tmp_path / "run" / "map.pdf").is_file()


def solution_of(arm):
    """The keys of a solution.json of an arm."""
    from workbench.files.solution_file import FORMAT, name_of

    return {
        "format": FORMAT,
        "recording": "made",
        "measures": "external-point",
        "robot": ABB,
        "effects": [{"effect": name_of(e), "where": e.where, **e.options} for e in arm.effects],
        "values": arm.values,
        "free": [],
        "covariance": [],
        "load_centre_mm": [0, 0, 0],
        "held_out": {"rms_mm": 0.05},
        "nominal": {"rms_mm": 1.0},
        "converged": True,
        "outcome": "converged",
    }


MODEL_COLUMNS = (
    "joints_mm",
    "joints_and_bearings_mm",
    "joints_bearings_links_and_pedestal_mm",
)


PUBLISHED = """
robot = "abb_irb120"
source = "made up for this test"
[joint]
1 = 1e5
2 = 8e4
[bearing]
2 = 5e5
[link]
2 = 4e5
[pedestal]
about_y = 2e6
"""


def test_published_stiffness_is_an_input_and_models_stand_side_by_side(tmp_path):
    from workbench.files.stiffness_file import read_stiffness

    (tmp_path / "k.toml").write_text(PUBLISHED)
    arm = read_stiffness(tmp_path / "k.toml")
    readings = readings_of(arm.robot, 6)
    found = cartesian_stiffness(arm, readings, TOOL)
    models = found.models(WRENCH)
    assert list(models) == list(MODELS) and not models["rigid"].any()
    total = sum(found.deflection(WRENCH).values())
    wanted = np.linalg.norm(total[:, :3], axis=1)
    np.testing.assert_allclose(models["joints, bearings, links and pedestal"], wanted, rtol=1e-12)
    # the stiffness of joint 1 is that which the file states: a moment about its axis turns it by M / k
    only = {"joint-1.joint-compliance.compliance": 1e-5}
    assert only.items() <= arm.values.items()
    largest = found.models()
    assert (largest["joints"] <= largest["joints and bearings"] + 1e-15).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("1 = 1e5", "1 = -1e5", "key joint.1: expected a stiffness above zero"),
        ("1 = 1e5", "9 = 1e5", "key joint.9: expected a number from 1 to 6"),
        ("about_y", "about_z", "key pedestal: expected about_x and about_y, found about_z"),
        ("[link]", "[links]", "found the key links"),
        ('robot = "abb_irb120"', "", "found no key robot"),
        ("[joint]", "[joint", "cannot be read"),
        (
            '"abb_irb120"',
            '"abb_ibr120"',
            "k.toml, key robot: expected one of .* did you mean abb_irb120",
        ),
        (
            '"abb_irb120"',
            '"own.urdf"',
            "k.toml, key robot: expected the path of a file .*own.urdf",
        ),
    ],
)
def test_a_wrong_stiffness_file_is_a_sentence(old, new, words, tmp_path):
    from workbench.files.stiffness_file import read_stiffness

    (tmp_path / "k.toml").write_text(PUBLISHED.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_stiffness(tmp_path / "k.toml")


def test_the_command_takes_published_stiffness(workbench, tmp_path):
    (tmp_path / "k.toml").write_text(PUBLISHED)
    (tmp_path / "t.csv").write_text(
        "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,10,10,0,30,0\n20,-10,15,10,40,5\n"
    )
    call = ("stiffness", "k.toml", "t.csv", "--wrench", "0", "0", "100", "0", "0", "0")
    done = workbench(*call, "--out", "out", "--json", "a.json")
    assert done.returncode == 0, done.stderr
    answer = json.loads((tmp_path / "a.json").read_text())
    sizes = [row["rms_mm"] for row in answer["models"]]
    assert sizes[0] == 0 < sizes[1] < sizes[2] < sizes[3]
    product = np.array(answer["first_pose"]["compliance"]) @ np.array(
        answer["first_pose"]["stiffness"]
    )
    np.testing.assert_allclose(product, np.eye(6), atol=1e-6)
    assert answer["robot"] == "ABB IRB 120" and answer["source"] == "made up for this test"
    table = np.genfromtxt(tmp_path / "out" / "stiffness.csv", delimiter=",", names=True)
    assert table["q2_deg"].tolist() == [10, -10] and (table["deflection_z_mm"] > 0).all()
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"models.pdf", "models.svg", "map.pdf", "map.svg", "map.vtk", "stiffness.npy"} <= names
    done = workbench("stiffness", "absent.toml", "t.csv")
    assert done.returncode == 2 and "absent.toml" in done.stderr


TWO_LINKS = """
<robot name="planar">
  <link name="base"/><link name="upper"/><link name="fore"/><link name="tip"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="fore"/><origin xyz="0.6 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="end" type="fixed">
    <parent link="fore"/><child link="tip"/><origin xyz="0.5 0 0"/>
  </joint>
</robot>
"""


def test_an_own_urdf_with_measured_stiffness_deflects_as_by_hand(workbench, tmp_path):
    """Two joints, stretched out: 200 N down make F (l^2 / k1 + l2^2 / k2)."""
    (tmp_path / "own.urdf").write_text(TWO_LINKS)
    (tmp_path / "k.toml").write_text('robot = "own.urdf"\n[joint]\n1 = 1e5\n2 = 4e4\n')
    (tmp_path / "t.csv").write_text("q1_deg,q2_deg\n0,0\n20,-30\n")
    wrench = ("--wrench", "0", "0", "-200", "0", "0", "0")
    done = workbench("stiffness", "k.toml", "t.csv", *wrench, "--out", "out")
    assert done.returncode == 0, done.stderr
    table = np.genfromtxt(tmp_path / "out" / "stiffness.csv", delimiter=",", names=True)
    by_hand = -200 * (1.1**2 / 1e5 + 0.5**2 / 4e4) * 1e3
    assert table["deflection_z_mm"][0] == pytest.approx(by_hand, rel=1e-6)
    assert table["deflection_x_mm"][0] == pytest.approx(0, abs=1e-9)


def test_poses_of_the_page_are_within_the_limits_of_its_robot(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "how-to" / "stiffness.md").read_text(encoding="utf-8")
    code, named = re.findall(r"```(?:python|toml)\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    poses = np.loadtxt("poses.csv", delimiter=",", skiprows=1)
    low, high = np.rad2deg(load_robot({"builtin": tomllib.loads(named)["robot"]}).limits.T)
    assert len(poses) == 500 and (low <= poses).all() and (poses <= high).all()
