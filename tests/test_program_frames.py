"""Poses of robot programs: those of the flange where the file states tool and frame, else a question."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources.choice import read_sources
from datasets.importers.user_tables import read_targets
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.files.targets import read_programme, target_warnings

SLIDING = [False] * 6
ROBOT = load_robot({"builtin": "abb_irb120"}, "test")
TILT = Rotation.from_euler("ZYX", [30, -20, 50], degrees=True)


def pose(place, turn=None):
    made = np.eye(4)
    made[:3, 3] = place
    made[:3, :3] = (turn or Rotation.identity()).as_matrix()
    return made


FLANGE = pose([500, 20, 600], Rotation.from_euler("ZYX", [170, 40, 20], degrees=True))
TOOL = pose([10, -20, 150], TILT)
USER, OBJECT = pose([100, 200, 30], TILT.inv()), pose([5, 6, 7], TILT)


def rapid_pose(matrix):
    place = ",".join(f"{v:.9f}" for v in matrix[:3, 3])
    turn = Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True)
    return f"[{place}],[{','.join(f'{v:.12f}' for v in turn)}]"


def rapid(moves, extra=""):
    seen = np.linalg.inv(USER @ OBJECT) @ FLANGE @ TOOL
    return "\n".join(
        [
            "MODULE m",
            f"PERS tooldata gripper:=[TRUE,[{rapid_pose(TOOL)}],[1,[0,0,50],[1,0,0,0],0,0,0]];",
            f'PERS wobjdata bench:=[FALSE,TRUE,"",[{rapid_pose(USER)}],[{rapid_pose(OBJECT)}]];',
            extra,
            f"CONST robtarget p10:=[{rapid_pose(seen)},[0,1,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
            "PROC main()",
            *moves,
            "ENDPROC",
        ]
    )


def krl_frame(matrix):
    turn = Rotation.from_matrix(matrix[:3, :3]).as_euler("ZYX", degrees=True)
    keys = zip("XYZABC", (*matrix[:3, 3], *turn))
    return "{" + ",".join(f"{key} {value:.9f}" for key, value in keys) + "}"


def krl(*lines):
    seen = krl_frame(np.linalg.inv(USER) @ FLANGE @ TOOL)
    return "\n".join(
        ["DEFDAT p", *lines, f"DECL E6POS XP1={seen[:-1]},S 6,T 27,E1 0.0}}", "ENDDAT"]
    )


def targets(folder, name, text):
    (folder / name).write_text(text)
    return read_targets(folder / name, SLIDING)[0]


def assert_flange(table):
    place = [table.columns[name][0] for name in ("x_mm", "y_mm", "z_mm")]
    turn = [table.columns[name][0] for name in ("qw", "qx", "qy", "qz")]
    np.testing.assert_allclose(place, FLANGE[:3, 3], atol=1e-6)
    found = Rotation.from_quat(turn, scalar_first=True)
    np.testing.assert_allclose(found.as_matrix(), FLANGE[:3, :3], atol=1e-9)


def test_tool_and_work_object_of_a_rapid_module(tmp_path):
    moves = ["! MoveL p10,v100,fine,tool0;", "MoveL Offs(p10,0,0,5),v100,z10,gripper\\WObj:=bench;"]
    assert_flange(targets(tmp_path, "p.mod", rapid(moves)))


@pytest.mark.parametrize(
    "lines",
    [
        [f"$TOOL={krl_frame(TOOL)}", f"$BASE={krl_frame(USER)}"],
        [f"TOOL_DATA[2]={krl_frame(TOOL)}", "$TOOL=TOOL_DATA[2]", f"$BASE={krl_frame(USER)}"],
        [
            f"TOOL_DATA[2]={krl_frame(TOOL)}",
            f"BASE_DATA[3]={krl_frame(USER)}",
            "DECL FDAT FP1={TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE}",
        ],
    ],
)
def test_tool_and_base_of_a_krl_program(tmp_path, lines):
    assert_flange(targets(tmp_path, "p.dat", krl(*lines)))


def fanuc(frame, tool):
    w, p, r = Rotation.from_matrix(FLANGE[:3, :3]).as_euler("xyz", degrees=True)
    x, y, z = FLANGE[:3, 3]
    return (
        f"P[1]{{\n GP1:\n UF : {frame}, UT : {tool}, CONFIG : 'N U T, 0, 0, 0',\n X = {x} mm, Y = {y} mm, "
        f"Z = {z} mm,\n W = {w} deg, P = {p} deg, R = {r} deg\n}};"
    )


def test_fanuc_positions_without_tool_and_frame(tmp_path):
    assert_flange(targets(tmp_path, "p.ls", fanuc(0, 0)))


MOVE = "MoveL p10,v100,fine,gripper\\WObj:=bench;"


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("a.mod", rapid([]), "0 tools and work objects in the moves to p10"),
        ("a.mod", rapid([MOVE, "MoveL p10,v100,fine,tool0;"]), "2 tools and work objects"),
        ("a.mod", rapid(["MoveL p10,v100,fine,drill;"]), "tooldata drill with none in the file"),
        ("a.mod", rapid([MOVE, "PDispOn p10, gripper;"]), "a program displacement"),
        ("a.mod", rapid([MOVE, "gripper.tframe.trans.z:=200;"]), "gripper, which the program cha"),
        ("k.dat", krl(), r"no \$BASE"),
        ("k.dat", krl("$BASE=$NULLFRAME"), r"no \$TOOL"),
        ("k.dat", krl("$BASE=$NULLFRAME", "$TOOL=TOOL_DATA[4]"), r"TOOL_DATA\[4\] without a value"),
        (
            "k.dat",
            krl("BAS(#BASE,0)", "BAS(#TOOL,0)", "$TOOL={X 1,Y 0,Z 0,A 0,B 0,C 0}"),
            r"several values of \$TOOL(?=.*write one program for each tool)",
        ),
        ("f.ls", fanuc(0, 1), "UF : 0, UT : 1"),
    ],
)
def test_poses_of_a_tool_that_the_file_does_not_state_are_refused(tmp_path, name, text, found):
    with pytest.raises(InputError, match=f"expected poses of the flange.*{found}.*; .*(joint)"):
        targets(tmp_path, name, text)


def test_configuration_data_are_named(tmp_path):
    (tmp_path / "p.mod").write_text(rapid([MOVE]))
    programme = read_programme(tmp_path / "p.mod", ROBOT)
    (sentence,) = target_warnings(programme, ROBOT)
    assert "configuration data" in sentence and "0, 1, -1, 0" in sentence


def test_an_import_says_that_poses_are_those_of_the_tool(tmp_path):
    (tmp_path / "k.dat").write_text(krl())
    (table,) = read_sources([tmp_path / "k.dat"], tmp_path).tables
    (sentence,) = table.warnings
    assert "those of the active tool" in sentence
    assert "tool X [mm]" in table.columns and "flange X [mm]" not in table.columns


def test_joint_targets_need_no_tool(tmp_path):
    text = "CONST jointtarget j1:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];"
    assert targets(tmp_path, "j.mod", text).columns["q2_deg"][0] == 2


def test_tool_positions_of_a_table_are_refused(tmp_path):
    header = "TCP X [mm],TCP Y [mm],TCP Z [mm],TCP qw,TCP qx,TCP qy,TCP qz"
    text = f"{header}\n500,200,300,1,0,0,0\n510,200,300,1,0,0,0\n"
    with pytest.raises(InputError, match="expected positions of the flange, found those of a tool"):
        targets(tmp_path, "t.csv", text)
    assert targets(tmp_path, "t.csv", text.replace("TCP", "flange")).columns["x_mm"][1] == 510
