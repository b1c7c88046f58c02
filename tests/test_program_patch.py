"""A corrected program is the user's own: only the numbers of its positions differ."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot_model import load_robot
from scenes import ABB
from test_correction_limits import solution
from workbench.commands.robot.export_arm import ArmOptions, export_arm
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.compensation.compensate import compensate, nominal_poses

READINGS = np.array(
    [[0.0, 10, 10, 0, 30, 0], [40, -20, 25, 30, -50, 10], [-30, 5, -5, -60, 70, 90]]
)
NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)"
CHANGES = {"joint-3.theta3": load_robot(ABB).geometry[2, 0] + 2e-3}
TOOL = "{X 10.0,Y -20.0,Z 150.0,A 30.0,B 0.0,C 10.0}"


def exported(folder, to, name, text):
    """The exported bytes of a program, the corrected readings (n, 6) rad, and the notes."""
    path = folder / name
    path.write_bytes(text.encode("cp1252"))
    run = solution(folder / "arm", changes=CHANGES)
    made = export_arm(run, to, folder / f"out{path.suffix}", ArmOptions(targets=path))
    (content,) = made.texts.values()
    assert re.sub(NUMBER, b"", content) == re.sub(NUMBER, b"", path.read_bytes())
    found = compensate(read_solution(run), np.deg2rad(READINGS))
    return content.decode("cp1252"), found.readings, made.notes


def joints_krl():
    rows = [
        ",".join(f"A{k} {value:.3f}" for k, value in enumerate(row, 1)) for row in READINGS.tolist()
    ]
    moves = [f"DECL E6AXIS XP{k}={{{row},E1 0.0,E2 7.5}}" for k, row in enumerate(rows, 1)]
    return "\r\n".join(["&ACCESS RVP", "DEFDAT GRÖSSE ; Werkstück 12", *moves, "ENDDAT", ""])


def test_joint_positions_of_a_kuka_program_are_replaced_in_place(tmp_path):
    text, readings, notes = exported(tmp_path, "krl", "job.dat", joints_krl())
    assert "GRÖSSE ; Werkstück 12\r\n" in text and text.count("E2 7.5") == 3
    found = [[float(x) for x in re.findall(r"A\d (\S+?),", line)] for line in text.split("\n")[2:5]]
    np.testing.assert_allclose(found, np.rad2deg(readings), atol=6e-6)
    assert np.abs(np.array(found) - READINGS).max() > 0.05
    assert any("Only the numbers of 3 positions" in note for note in notes)


def test_poses_of_a_tool_stay_poses_of_that_tool(tmp_path):
    tool = np.eye(4)
    tool[:3, 3] = [10, -20, 150]
    tool[:3, :3] = Rotation.from_euler("ZYX", [30, 0, 10], degrees=True).as_matrix()
    lines = ["DEF job()", f"$TOOL={TOOL} ; gripper 4", "$BASE=$NULLFRAME"]
    for k, pose in enumerate(nominal_poses(load_robot(ABB), np.deg2rad(READINGS)) @ tool, 1):
        x, y, z = pose[:3, 3]
        a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
        lines += [
            f"DECL E6POS XP{k}={{X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f}}}"
        ]
        lines += [f"LIN XP{k} C_DIS ; $VEL.CP=0.25"]
    text, _, _ = exported(tmp_path, "krl", "job.src", "\r\n".join([*lines, "END", ""]))
    assert f"$TOOL={TOOL} ; gripper 4" in text and text.count("$VEL.CP=0.25") == 3
    rows = [line for line in text.split("\r\n") if line.startswith("DECL")]
    keys = [[float(x) for x in re.findall(r"[XYZABC] (-?[\d.]+)", row)] for row in rows]
    for row, wanted in zip(keys, READINGS):
        pose = np.eye(4)
        pose[:3, 3] = row[:3]
        pose[:3, :3] = Rotation.from_euler("ZYX", row[3:], degrees=True).as_matrix()
        flange = pose @ np.linalg.inv(tool)
        nominal = nominal_poses(load_robot(ABB), np.deg2rad([wanted]))[0]
        # theta3 of the real arm is 2 mrad larger: the controller is sent that much back
        assert 0.2 < np.linalg.norm((flange - nominal)[:3, 3]) < 2.0


def test_joint_targets_of_a_rapid_module_are_replaced_in_place(tmp_path):
    rows = [", ".join(f"{value:.2f}" for value in row) for row in READINGS.tolist()]
    external = "[9E9, 9E9, 9E9, 9E9, 9E9, 9E9]"
    lines = ["MODULE job", "  ! speeds as agreed on 3.4."]
    lines += [
        f"  CONST jointtarget p{k} := [[{row}], {external}];" for k, row in enumerate(rows, 1)
    ]
    lines += ["  PROC main()", "    MoveAbsJ p1, v100, z5, tool0;", "  ENDPROC", "ENDMODULE", ""]
    text, readings, _ = exported(tmp_path, "rapid", "job.mod", "\n".join(lines))
    assert text.count(external) == 3 and "speeds as agreed on 3.4." in text
    found = [[float(x) for x in inner.split(",")] for inner in re.findall(r":= \[\[(.*?)\]", text)]
    np.testing.assert_allclose(found, np.rad2deg(readings), atol=6e-6)


@pytest.mark.parametrize("to", ["krl", "rapid", "urscript"])
def test_a_table_still_becomes_a_new_program(tmp_path, to):
    head = ",".join(f"q{k}_deg" for k in range(1, 7))
    rows = [",".join(map(str, row)) for row in READINGS.tolist()]
    path = tmp_path / "t.csv"
    path.write_text("\n".join([head, *rows, ""]))
    run = solution(tmp_path / "arm", changes=CHANGES)
    made = export_arm(run, to, tmp_path / "out.txt", ArmOptions(targets=path))
    (text,) = made.texts.values()
    assert "held-out RMS" in text
