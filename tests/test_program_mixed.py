"""Robot programs that hold joint positions and poses, and FANUC programs that are corrected in place."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from counted_robots import arm
from robot_model import load_robot
from robot_model.chain import forward
from scenes import ABB
from test_correction_limits import solution
from test_program_patch import CHANGES, NUMBER, exported
from workbench.commands.robot.export_arm import ArmOptions, export_arm
from workbench.core.errors import InputError
from workbench.files.solution_file import read_solution
from workbench.files.targets import read_programme
from workbench.jobs.robot.compensation.compensate import compensate, nominal_poses
from workbench.jobs.robot.compensation.stated_configuration import with_stated_configuration

ROBOT = load_robot(ABB)
READINGS = np.array(
    [[0.0, 10, 10, 0, 30, 0], [40, -20, 25, 30, -50, 10], [-30, 5, -5, -60, 70, 90]]
)
FANUC = load_robot("fanuc_lr_mate_200id")


def angles_of(pose, sequence):
    return (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_euler(sequence, degrees=True))


def mixed_krl():
    """A joint move, a linear move, a joint move."""
    moves = ["&ACCESS RVP", "DEF job()", "$TOOL=$NULLFRAME", "$BASE=$NULLFRAME"]
    for k, row in enumerate(READINGS):
        if k == 1:
            pose = angles_of(nominal_poses(ROBOT, np.deg2rad(row[None]))[0], "ZYX")
            keys = ", ".join(f"{key} {value:.6f}" for key, value in zip("XYZABC", pose))
            moves.append(f"LIN {{{keys}}} C_DIS ; glue")
        else:
            keys = ", ".join(f"A{j} {value:.3f}" for j, value in enumerate(row, 1))
            moves.append(f"PTP {{E6AXIS: {keys}, E1 0}}")
    return "\r\n".join([*moves, "END", ""])


def test_joints_and_poses_of_one_program_are_targets_in_the_order_of_its_lines(tmp_path):
    path = tmp_path / "job.src"
    path.write_text(mixed_krl())
    programme = read_programme(path, ROBOT)
    assert programme.is_joint.tolist() == [True, False, True]
    assert programme.table.rows.tolist() == [5, 6, 7]
    wanted = nominal_poses(ROBOT, np.deg2rad(READINGS))
    np.testing.assert_allclose(programme.poses, wanted, atol=1e-4)
    np.testing.assert_allclose(programme.readings[[0, 2]], np.deg2rad(READINGS[[0, 2]]), atol=1e-9)
    np.testing.assert_array_equal(programme.readings[1], programme.readings[0])


def test_a_mixed_program_is_corrected_in_place(tmp_path):
    text, readings, notes = exported(tmp_path, "krl", "job.src", mixed_krl())
    assert any("Only the numbers of 3 positions" in note for note in notes)
    assert "C_DIS ; glue" in text and text.count("E1 0") == 2
    joints = [[float(x) for x in re.findall(r"A\d (\S+?),", line)] for line in text.split("\n")]
    found = [row for row in joints if len(row) == 6]
    np.testing.assert_allclose(found, np.rad2deg(readings[[0, 2]]), atol=6e-6)
    line = next(line for line in text.split("\n") if line.startswith("LIN"))
    pose = [float(x) for x in re.findall(r"[XYZABC] (-?[\d.]+)", line)]
    corrected = angles_of(nominal_poses(ROBOT, readings[1][None])[0], "ZYX")
    np.testing.assert_allclose(pose, corrected, atol=2e-4)


def test_the_frames_of_a_data_file_are_those_of_its_program(tmp_path):
    pose = angles_of(nominal_poses(ROBOT, np.deg2rad(READINGS[1:2]))[0], "ZYX")
    keys = ",".join(f"{key} {value:.6f}" for key, value in zip("XYZABC", pose))
    (tmp_path / "job.dat").write_text(f"DEFDAT job\nDECL E6POS XP1={{{keys},E1 0}}\nENDDAT\n")
    with pytest.raises(InputError, match="found those of a tool"):
        read_programme(tmp_path / "job.dat", ROBOT)
    (tmp_path / "job.src").write_text(
        "DEF job()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nPTP XP1\nEND\n"
    )
    programme = read_programme(tmp_path / "job.dat", ROBOT)
    np.testing.assert_allclose(programme.poses[0][:3, 3], pose[:3], atol=1e-5)
    run = solution(tmp_path / "arm", changes=CHANGES)
    made = export_arm(run, "krl", tmp_path / "out.dat", ArmOptions(targets=tmp_path / "job.dat"))
    (content,) = made.texts.values()
    before = (tmp_path / "job.dat").read_bytes()
    assert content != before and re.sub(NUMBER, b"", content) == re.sub(NUMBER, b"", before)


def test_an_export_starts_where_the_option_says(tmp_path):
    """Two starts with opposite signs of joint 5: the poses of the tool are the same, the configuration is the other."""
    pose = nominal_poses(ROBOT, np.deg2rad(READINGS[1:2]))[0]
    row = ",".join(f"{value:.6f}" for value in [*pose[:3, 3], *_quaternion(pose)])
    (tmp_path / "t.csv").write_text(f"x_mm,y_mm,z_mm,qw,qx,qy,qz\n{row}\n")
    run = solution(tmp_path / "arm", changes=CHANGES)
    names = []
    for sign in (1, -1):
        start = np.array(READINGS[1]) + (0 if sign > 0 else np.array([0, 0, 0, 180, 0, 180]))
        start[4] *= sign
        stated = ",".join(f"{(value + 180) % 360 - 180:.3f}" for value in start)
        options = ArmOptions(targets=tmp_path / "t.csv", start=stated)
        notes = export_arm(run, "rapid", tmp_path / "out.mod", options).notes
        names += [note for note in notes if note.startswith("Configuration of the arm")]
    assert len(names) == 2 and names[0] != names[1]
    with pytest.raises(InputError, match="--start: expected with --targets"):
        export_arm(run, "urdf", tmp_path / "a.urdf", ArmOptions(start="0,0,0,0,0,0"))


def _quaternion(pose):
    return Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)


def fanuc_block(number, body):
    return (
        f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 0,{body}\n   GP2:\n\tUF : 0, UT : 0,\n"
        f"\tJ1=     12.500  mm\n}};"
    )


def fanuc_joints(values):
    cells = [f"\tJ{k}= {value:9.3f} deg" for k, value in enumerate(values, 1)]
    return "\n" + ",".join(cells[:3]) + ",\n" + ",".join(cells[3:])


def fanuc_pose(pose, config):
    x, y, z, w, p, r = angles_of(pose, "xyz")
    return (
        f"\t\tCONFIG : '{config}',\n\tX = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,\n"
        f"\tW = {w:9.3f} deg,\tP = {p:9.3f} deg,\tR = {r:9.3f} deg"
    )


def fanuc_program(blocks):
    head = ["/PROG  JOB", "/ATTR", "OWNER\t\t= MNEDITOR;", "/MN", "   1:J P[1] 80% FINE    ;"]
    head += ["   2:L P[2:weld] 120mm/sec CNT50    ;", "/POS"]
    return "\r\n".join([*head, *blocks, "/END", ""])


def test_a_fanuc_program_is_corrected_in_place(tmp_path):
    pose = nominal_poses(ROBOT, np.deg2rad(READINGS[1:2]))[0]
    blocks = [
        fanuc_block(1, fanuc_joints(READINGS[0])),
        fanuc_block(2, fanuc_pose(pose, "F U T, 0, 0, 0")),
    ]
    path, mapping = tmp_path / "job.ls", tmp_path / "map.toml"
    path.write_bytes(fanuc_program(blocks).encode())
    mapping.write_text('format = "import/1"\n[controller]\njoint_signs = [1, 1, -1, -1, -1, -1]\n')
    run = solution(tmp_path / "arm", changes=CHANGES)
    options = ArmOptions(targets=path, map=mapping)
    made = export_arm(run, "fanuc", tmp_path / "out.ls", options)
    (content,) = made.texts.values()
    assert re.sub(NUMBER, b"", content) == re.sub(NUMBER, b"", path.read_bytes())
    text = content.decode()
    assert text.count("J1=     12.500  mm") == 2 and "120mm/sec CNT50" in text
    joints = [float(x) for x in re.findall(r"J\d= +(\S+) deg", text)]
    wanted = compensate(read_solution(run), np.deg2rad(READINGS[:1])).readings
    np.testing.assert_allclose(joints, np.rad2deg(wanted[0]), atol=6e-4)
    found = [float(x) for x in re.findall(r"[XYZ] = +(\S+)  mm", text)]
    assert 0.05 < np.linalg.norm(np.array(found) - pose[:3, 3]) < 2.0


def test_a_table_is_no_fanuc_program(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,5,6\n")
    run = solution(tmp_path / "arm", changes=CHANGES)
    with pytest.raises(
        InputError, match=r"expected --targets with a FANUC program as text \(.ls\)"
    ):
        export_arm(run, "fanuc", tmp_path / "out.ls", ArmOptions(targets=path))


def fanuc_letters(readings):
    """CONFIG of readings (6,) deg: from the places of shoulder, elbow and wrist in the plane of the arm."""
    frames = forward(FANUC, FANUC.mixing @ np.deg2rad(readings)[:, None])
    points = frames.z_origin[..., 0]
    out = np.array([np.cos(np.deg2rad(readings[0])), np.sin(np.deg2rad(readings[0])), 0.0])
    side = [np.array([point @ out, point[2]]) for point in (points[1], points[2], points[4])]
    shoulder, elbow, wrist = side
    upper, rest = elbow - shoulder, wrist - shoulder
    is_behind_arm = upper[0] * rest[1] - upper[1] * rest[0] > 0
    turns = [int(np.floor((readings[k] + 180) / 360)) for k in (0, 3, 5)]
    letters = f"{'F' if readings[4] > 0 else 'N'} {'D' if is_behind_arm else 'U'} {'B' if wrist[0] < 0 else 'T'}"
    return f"{letters}, {', '.join(map(str, turns))}"


def test_the_configuration_of_fanuc_poses_is_read(tmp_path):
    rng = np.random.default_rng(11)
    low, high = np.nan_to_num(np.rad2deg(FANUC.limits) - [-1, 1], nan=0).T
    low[2], high[2] = -60, 180  # without limits of its own: the angle to the horizontal
    readings = np.round(rng.uniform(0.85 * low, 0.85 * high, (200, 6)), 3)
    readings = readings[(np.abs(readings[:, 4]) > 10)]
    letters = [fanuc_letters(row) for row in readings]
    chosen = [letters.index(one) for one in sorted(set(letters))][:24]
    assert len({letters[k][:5] for k in chosen}) >= 6
    poses = nominal_poses(FANUC, np.deg2rad(readings[chosen]))
    blocks = [fanuc_block(n, fanuc_pose(poses[n - 1], letters[k])) for n, k in enumerate(chosen, 1)]
    (tmp_path / "job.ls").write_text(fanuc_program(blocks))
    programme, said = with_stated_configuration(
        read_programme(tmp_path / "job.ls", FANUC), arm(FANUC)
    )
    assert "chose their configuration" in said[0] and len(said) == 1
    assert [fanuc_letters(np.rad2deg(row)) for row in programme.readings] == [
        letters[k] for k in chosen
    ]
    np.testing.assert_allclose(nominal_poses(FANUC, programme.readings), poses, atol=2e-2)
