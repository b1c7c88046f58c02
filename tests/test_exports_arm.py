"""A calibrated arm taken elsewhere: each export is executed or read back by another program than the workbench."""

import inspect
import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from export_scenes import CURVE, GEOMETRY, arm_with, covariates_of, exported, flanges, readings_of
from robot_model import load_robot
from scenes import ABB, CRAIG, SLIDING
from workbench.core.errors import InputError
from workbench.files.exports.check import check_program, check_python
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.mjcf import control_terms, left_out, mjcf
from workbench.files.exports.programs import LANGUAGES, Program, program_text, read_program
from workbench.files.exports.python import python_module
from workbench.files.exports.ur_kinematics import (
    SEGMENTS,
    read_ur_kinematics,
    ur_kinematics_yaml,
)
from workbench.jobs.robot.compensation.compensate import actual_poses, compensate

MIXTURE = [[[10.0 * k, -5.0, 3.0 * k] for k in range(7)]]


EVERY = (
    ("transmission-harmonic", "joint-2", {"order": 2.0}),
    ("zero-offset", "joint-3", {}),
    ("backlash", "joint-3", {}),
    ("backlash", "joint-2", {"seat": "gravity", "width": 2.0}),
    ("zero-shift", "joint-1", {"after": 5.0}),
    ("joint-coupling", "joint-6", {"joint": 5}),
    ("joint-thermal-drift", "joint-1", {}),
    ("joint-compliance", "joint-2", {}),
    ("link-self-weight", "joint-3", {}),
    ("link-compliance", "link-3", {}),
    ("bearing-compliance", "joint-1", {}),
    ("pedestal-compliance", "base", {}),
    ("tool-deflection", "tool", {}),
    ("mount-tilt", "base", {}),
    ("first-moment", "link-3", {}),
    ("link-thermal-growth", "link-2", {}),
    ("axis-run-out", "joint-4", {}),
    ("smooth-function", "joint-2", CURVE),
    ("smooth-function", "joint-4", CURVE | {"names": ["tau3"], "spans": [[-20.0, 20.0]]}),
    (
        "compliance-with-masses",
        "joint-3",
        {"law": "joint-compliance", "mixtures": MIXTURE, "shares": [[0.3]]},
    ),
)


ALONE = """
import json, sys
import numpy as np
import exported
given = json.load(open("given.json"))
covariates = {k: np.array(v) for k, v in given["covariates"].items()}
readings = np.array(given["readings"])
corrected, left = exported.corrected_readings(readings, None, covariates, force=True)
foreign = [m for m in sys.modules if m.split(".")[0] in
           ("workbench", "robot_model", "datasets", "sensors", "scipy", "pydantic", "torch")]
print(json.dumps({"poses": exported.flange_poses(readings, covariates).tolist(),
                  "corrected": corrected.tolist(), "left": left.tolist(), "foreign": foreign}))
"""


def run_alone(folder, text, readings_deg, covariates):
    """What the module answers in a fresh interpreter that cannot see the workbench's folder."""
    (folder / "exported.py").write_text(text)
    (folder / "alone.py").write_text(ALONE)
    given = {"readings": readings_deg.tolist()}
    given["covariates"] = {k: v.tolist() for k, v in covariates.items()}
    (folder / "given.json").write_text(json.dumps(given))
    done = subprocess.run(
        [sys.executable, "alone.py"], cwd=folder, env={}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("spec", [ABB, CRAIG, SLIDING], ids=["abb", "craig", "sliding"])
def test_the_python_module_alone_predicts_and_corrects_as_the_workbench_does(spec, tmp_path):
    turning = {"transmission-harmonic", "axis-run-out"}
    robot = load_robot(spec)
    rows = [
        row for row in EVERY if not (row[0] in turning and robot.prismatic[int(row[1][-1]) - 1])
    ]
    arm = arm_with(spec, rows)
    readings = readings_of(robot)
    covariates = covariates_of(len(readings))
    shown = np.where(robot.prismatic, readings, np.rad2deg(readings))
    exported = run_alone(tmp_path, python_module(arm), shown, covariates)
    assert exported["foreign"] == []
    wanted = actual_poses(arm, readings, covariates)
    np.testing.assert_allclose(exported["poses"], wanted, rtol=0, atol=1e-7)
    found = compensate(arm, readings, covariates=covariates)
    corrected = np.where(robot.prismatic, found.readings, np.rad2deg(found.readings))
    near = found.left_mm < 1e-5
    assert near.sum() > 8
    np.testing.assert_allclose(np.array(exported["corrected"])[near], corrected[near], atol=1e-4)
    assert np.array(exported["left"])[near].max() < 1e-4


@pytest.mark.parametrize("names", [("reflector1",), ("reflector2", "reflector10"), ("tip",), ("",)])
def test_measured_points_take_a_calibrated_point_by_default(names):
    points = {name: [10.0 * k, -20.0, 30.0] for k, name in enumerate(names, 1)}
    keys = {
        f"tool.{name}{'_' if name else ''}{c}": value
        for name, point in points.items()
        for c, value in zip("xyz", point)
    }
    base = dict(zip((f"base.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")), range(6)))
    arm = arm_with(ABB, (), values=keys | base)
    check_python(arm, python_module(arm))
    measured_points = exported(arm)["measured_points"]
    reading = [[0, -30, 20, 0, 10, 0]]
    first = measured_points(reading, points[names[0]])
    np.testing.assert_allclose(measured_points(reading), first, atol=1e-9)
    if len(names) > 1:
        second = measured_points(reading, points[names[1]])
        np.testing.assert_allclose(measured_points(reading, reflector=10), second, atol=1e-9)
        assert np.abs(second - first).max() > 1
    with pytest.raises(ValueError, match="reflector7, found"):
        measured_points(reading, reflector=7)


def test_a_module_without_a_calibrated_point_asks_for_one():
    arm = arm_with(ABB, ())
    check_python(arm, python_module(arm))
    with pytest.raises(ValueError, match="give tool_point"):
        exported(arm)["measured_points"]([[0] * 6])


def test_the_docstring_names_covariates_only_where_a_term_uses_one():
    ranges = {f"q{k}_deg": (-40.0, 40.0) for k in range(1, 7)}
    ranges |= {"payload_kg": (0.0, 3.0), "temperature_c": (20.0, 25.0)}
    tool = {f"tool.{c}": 50.0 for c in "xyz"}
    rigid = replace(arm_with(ABB, (), values=tool), fitted_range=ranges)
    spring = arm_with(ABB, [("joint-compliance", "joint-2", {})], values=tool)
    spring = replace(spring, fitted_range=ranges)
    without, with_load = (python_module(arm).split('"""')[1] for arm in (rigid, spring))
    assert "Covariates" not in without and "covariates=covariates" not in without
    assert "in file units: payload_kg." in with_load and '{"payload_kg": 1.5}' in with_load
    for text in (without, with_load):
        example = text.split("Example:")[1].replace("import exported_arm", "")
        names = exported(rigid if text is without else spring)
        exec(inspect.cleandoc(example).replace("exported_arm.", ""), names)
        assert names["points"].shape == (1, 3)


def test_the_python_module_holds_no_more_than_the_arm_needs():
    plain = python_module(arm_with(ABB, ()))
    assert "class Backlash" not in plain and "class TransmissionHarmonic" not in plain
    with_gap = python_module(arm_with(ABB, [("backlash", "joint-3", {})]))
    assert "class Backlash" in with_gap and "Terms: backlash at joint-3" in with_gap
    assert "approach3" in with_gap.split("\n\n")[1] + with_gap.split('"""')[1]


SPRINGS = {
    "none": ([], {}),
    "joints": (
        [("joint-compliance", "joint-2", {}), ("joint-compliance", "joint-3", {})],
        {
            "joint-2.joint-compliance.compliance": 3e-5,
            "joint-3.joint-compliance.compliance": 5e-5,
        },
    ),
    "bearing-1": ([("bearing-compliance", "joint-1", {}), ("mount-tilt", "base", {})], {}),
    "bearing-2": (
        [("bearing-compliance", "joint-2", {})],
        {"joint-2.bearing-compliance.tilt": 2e-4},
    ),
    "bearing-4": (
        [("bearing-compliance", "joint-4", {})],
        {"joint-4.bearing-compliance.tilt": 2e-4},
    ),
    "link": ([("link-compliance", "link-2", {})], {"link-2.link-compliance.bending": 2e-5}),
    "pedestal": ([("pedestal-compliance", "base", {})], {}),
    "moments": (
        [("joint-compliance", "joint-2", {}), ("first-moment", "link-3", {})],
        {"joint-2.joint-compliance.compliance": 3e-5, "link-3.first-moment.mx": 120.0},
    ),
    "tilt": (
        [("joint-compliance", "joint-2", {}), ("mount-tilt", "base", {})],
        {"joint-2.joint-compliance.compliance": 3e-5},
    ),
    "offset": ([("zero-offset", "joint-3", {})], {}),
}


@pytest.mark.parametrize("case", SPRINGS)
def test_mujoco_puts_the_flange_where_the_model_does(case):
    pytest.importorskip("mujoco", reason="needs MuJoCo")
    from mujoco_statics import flange_at_rest

    rows, values = SPRINGS[case]
    arm = arm_with(ABB, rows, values=values)
    readings, load = readings_of(arm.robot), np.linspace(0, 3, 12)
    wanted = actual_poses(arm, readings, {"payload_kg": load})
    found = flange_at_rest(mjcf(arm), readings, load)
    rigid = actual_poses(replace(arm, effects=()), readings, {"payload_kg": load})
    effect = np.linalg.norm((wanted - rigid)[:, :3, 3], axis=1).max()
    assert effect > 0.05 or case == "none"
    assert np.abs(found - wanted)[:, :3, 3].max() < 2e-4 + 0.01 * effect
    assert not left_out(arm) and not control_terms(arm)


def test_a_simulation_of_the_exported_model_comes_to_rest_there():
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo")
    from mujoco_statics import pose_of

    rows, values = SPRINGS["joints"]
    arm = arm_with(ABB, rows, values=values)
    reading = readings_of(arm.robot, 1)
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = reading[0]
    for _ in range(600):
        mujoco.mj_step(model, data)
    found = pose_of(data, model.site("flange").id)
    assert np.abs(found - actual_poses(arm, reading)[0])[:3, 3].max() < 2e-3


def test_terms_that_are_no_springs_go_into_the_servo_targets():
    pytest.importorskip("mujoco", reason="needs MuJoCo")
    from mujoco_statics import flange_at_rest

    rows = [
        ("joint-compliance", "joint-2", {}),
        ("transmission-harmonic", "joint-2", {"order": 2.0}),
        ("backlash", "joint-3", {}),
        ("smooth-function", "joint-2", CURVE),
    ]
    arm = arm_with(ABB, rows, values={"joint-2.joint-compliance.compliance": 2e-5})
    assert len(control_terms(arm)) == 3
    assert left_out(arm) == [effect.title for effect in control_terms(arm)]
    module: dict = {"__name__": "exported"}
    exec(python_module(arm), module)
    readings, covariates = readings_of(arm.robot), covariates_of(12)
    targets = module["servo_targets"](np.rad2deg(readings), covariates)
    found = flange_at_rest(mjcf(arm), targets, covariates["payload_kg"])
    wanted = actual_poses(arm, readings, covariates)
    assert np.abs(found - wanted)[:, :3, 3].max() < 5e-3
    plain = flange_at_rest(mjcf(arm), readings, covariates["payload_kg"])
    assert np.abs(plain - wanted)[:, :3, 3].max() > 0.1


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_program_holds_the_corrected_targets(language):
    robot = load_robot(ABB)
    readings = readings_of(robot, 5)
    text = program_text(Program(readings, "weld", "ABB", 0.05), language)
    np.testing.assert_allclose(read_program(text, language), readings, atol=1e-9)
    assert "0.05 mm" in text and "weld" in text
    with pytest.raises(InputError, match="program name"):
        program_text(Program(readings, "1 weld", "ABB", 0.05), language)
    with pytest.raises(InputError, match="without; correct the targets"):
        program_text(Program(np.nan * readings, "weld", "ABB", 0.05), language)
    with pytest.raises(
        InputError, match="six revolute joints and at most six linear axes, found 5"
    ):
        program_text(Program(readings[:, :5], "weld", "x", 0.05), language)


TRACK_FIRST, TRACK_LAST = (True, *(False,) * 6), (*(False,) * 6, True)


@pytest.mark.parametrize("language", ["krl", "rapid"])
@pytest.mark.parametrize("slides", [TRACK_FIRST, TRACK_LAST])
def test_a_linear_axis_is_an_external_axis(language, slides):
    turning, track = readings_of(load_robot(ABB), 4), np.array([-20.5, 0.0, 1234.56789, 7.0])
    place = slides.index(True)
    program = Program(np.insert(turning, place, track, axis=1), "weld", "x", 0.05, slides)
    text = program_text(program, language)
    check_program(program, text, language)
    if language == "krl":
        pattern = r"PTP \{E6AXIS: (.*)\}"
        rows = [dict(word.split() for word in row.split(", ")) for row in re.findall(pattern, text)]
        found = [[*(row[f"A{k}"] for k in range(1, 7)), row["E1"]] for row in rows]
    else:
        pattern = r":= \[\[(.*)\], \[(.*), 9E9, 9E9, 9E9, 9E9, 9E9\]\];"
        found = [[*axes.split(", "), eax_a] for axes, eax_a in re.findall(pattern, text)]
    wanted = np.column_stack([np.rad2deg(turning), track])
    np.testing.assert_allclose(np.array(found, float), wanted, atol=1e-6)


def test_urscript_moves_no_linear_axis():
    program = Program(np.zeros((2, 7)), "weld", "x", 0.05, TRACK_LAST)
    with pytest.raises(InputError, match="movej moves the six joints of the arm only"):
        program_text(program, "urscript")


def test_programs_say_the_same_without_the_own_reader():
    """URScript runs as Python but for its `end`; axes of KRL and robot targets of RAPID are read number by number."""
    robot = load_robot(ABB)
    readings = readings_of(robot, 5)
    program = Program(readings, "weld", "ABB", 0.05)
    moves = []
    script = program_text(program, "urscript")
    lines = [line for line in script.splitlines() if line.strip() != "end"]
    called = [line for line in lines if line.strip() == "weld()"]
    scope = {"movej": lambda joints, a, v: moves.append(joints)}
    exec("\n".join(lines if called else [*lines, "weld()"]), scope)
    np.testing.assert_allclose(moves, readings, atol=1e-9)
    axes = re.findall(r"\bA[1-6] (-?[0-9.]+)", program_text(program, "krl"))
    np.testing.assert_allclose(
        np.reshape(axes, (5, 6)).astype(float), np.rad2deg(readings), atol=1e-6
    )
    targets = re.findall(r":= \[\[([^]]+)\]", program_text(program, "rapid"))
    numbers = [[float(cell) for cell in row.split(",")] for row in targets]
    np.testing.assert_allclose(numbers, np.rad2deg(readings), atol=1e-6)


def test_the_kinematics_of_a_universal_robots_arm_are_those_of_its_own_package():
    arm = arm_with({"builtin": "ur10"}, ())
    places = read_ur_kinematics(ur_kinematics_yaml(arm))
    assert len(places) == len(SEGMENTS)
    readings = readings_of(arm.robot, 6)
    geometry = calibrated_geometry(arm)
    wanted = flanges(arm.robot, readings, geometry)
    rests = []
    for reading, pose in zip(readings, wanted):
        here = np.eye(4)
        for place, angle in zip(places, reading):
            turn = np.eye(4)
            c, s = np.cos(angle), np.sin(angle)
            turn[:2, :2] = [[c, -s], [s, c]]
            here = here @ place @ turn
        rests.append(np.linalg.inv(here) @ pose)
    # what lies behind the last axis is the same at every pose
    np.testing.assert_allclose(rests, np.broadcast_to(rests[0], (6, 4, 4)), atol=1e-6)
    with pytest.raises(InputError, match="Universal Robots"):
        ur_kinematics_yaml(arm_with(ABB, ()))


def test_the_nominal_file_is_the_one_that_the_maker_publishes():
    """`ur_description` for a UR10: z 0.1273 to the shoulder, x -0.612 to the forearm, y 0.0922 to the last wrist."""
    robot = load_robot({"builtin": "ur10"})
    values = {
        f"joint-{k + 1}.{n}{k + 1}": robot.geometry[k, c]
        for k in range(6)
        for c, n in enumerate(GEOMETRY)
    }
    nominal = replace(arm_with({"builtin": "ur10"}, ()), values=values)
    places = read_ur_kinematics(ur_kinematics_yaml(nominal))
    np.testing.assert_allclose(places[0][:3, 3], [0, 0, 127.3], atol=0.05)
    np.testing.assert_allclose(places[2][:3, 3], [-612, 0, 0], atol=0.1)
    np.testing.assert_allclose(places[3][:3, 3], [-572.3, 0, 163.941], atol=0.1)
    np.testing.assert_allclose(places[4][:3, 3], [0, -115.7, 0], atol=0.1)
    np.testing.assert_allclose(places[5][:3, 3], [0, 92.2, 0], atol=0.1)


def test_an_arm_is_asked_for_as_it_is_after_the_recording():
    """Without a recorded time the row is the clock: a joint that shifted in the recording stays shifted."""
    shifted = arm_with(ABB, [("zero-shift", "joint-1", {"after": 50.5})])
    shifted = replace(shifted, rows=120)
    readings = readings_of(shifted.robot, 3)
    before, after = ({"row": np.full(3, row)} for row in (0.0, 120.0))
    wanted = actual_poses(shifted, readings, after)
    assert np.abs(wanted - actual_poses(shifted, readings, before)).max() > 0.05
    np.testing.assert_array_equal(actual_poses(shifted, readings), wanted)
    flange_poses = exported(shifted)["flange_poses"]
    np.testing.assert_allclose(flange_poses(np.rad2deg(readings)), wanted, atol=1e-7)
