"""Readings of prismatic joints whose headers do not name them as joints: a track, the z axis of a SCARA."""

import numpy as np
import pytest

from datasets.importers.sources.programs.robot_programs import read_robot_program
from datasets.importers.user_tables import read_targets
from import_scenes import write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.robots import robot_keys

TRACK = """joint,type,theta [deg],d [mm],a [mm],alpha [deg]
1,prismatic,0,150,0,-90
2,revolute,0,0,420,0
3,revolute,0,0,310,90
4,revolute,0,0,0,-90
5,revolute,0,260,0,90
6,revolute,0,0,0,-90
7,revolute,0,90,0,0
"""
AXES = [f"A{k}" for k in range(1, 7)]
POINT = ["X", "Y", "Z"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """DH table of an arm on a track, readings (60, 7) of track (mm) and axes (deg), and points (60, 3) mm."""
    path = tmp_path_factory.mktemp("arm") / "track_standard.csv"
    path.write_text(TRACK)
    random = np.random.default_rng(5)
    track = random.uniform(0, 2500, (60, 1))
    axes = random.uniform(-110, 110, (60, 6))
    joints = np.column_stack([track, np.deg2rad(axes)])
    flange = nominal_poses(load_robot(robot_keys(str(path), "arm")), joints)
    points = flange[:, :3, :3] @ [30.0, 12.0, 70.0] + flange[:, :3, 3]
    points += random.normal(size=points.shape) * 0.03
    return path, np.column_stack([track, axes]), points


def imported(path, arm, tmp_path):
    return import_recording([path], tmp_path / "out", ImportOptions(robot=str(arm[0])))


@pytest.mark.parametrize(("header", "scale"), [("E1", 1.0), ("Schiene", 0.001)])
def test_the_column_of_a_track_is_the_one_that_fits(header, scale, arm, tmp_path):
    _, joints, points = arm
    unused = np.random.default_rng(1).normal(size=(len(points), 1))
    cells = np.column_stack([joints[:, 1:], scale * joints[:, 0], unused, points])
    path = write_rows(tmp_path / "t.csv", [*AXES, header, "Strom", *POINT], cells)
    made = imported(path, arm, tmp_path)
    assert np.allclose(made.recording.columns["q1_mm"], joints[:, 0])
    assert made.mapping.joints.columns == (header, *AXES)
    assert any(f"reads {header}, A1" in sentence for sentence in made.warnings)


def test_external_axes_of_kuka_are_no_euler_angles(arm, tmp_path):
    _, joints, points = arm
    still = np.zeros((len(points), 5))
    cells = np.column_stack([joints[:, 1:], joints[:, 0], still, points])
    external = [f"E{k}" for k in range(1, 7)]
    path = write_rows(tmp_path / "t.csv", [*AXES, *external, *POINT], cells)
    made = imported(path, arm, tmp_path)
    assert made.recording.measures == "external-point"
    assert np.allclose(made.recording.columns["q1_mm"], joints[:, 0])


def test_no_column_fits_a_track_that_was_not_recorded(arm, tmp_path):
    _, joints, points = arm
    unused = np.random.default_rng(1).uniform(0, 2500, size=(len(points), 1))
    cells = np.column_stack([joints[:, 1:], unused, points])
    path = write_rows(tmp_path / "t.csv", [*AXES, "E1", *POINT], cells)
    with pytest.raises(InputError, match="expected 7 joint columns"):
        imported(path, arm, tmp_path)


def test_headers_of_which_one_is_unknown_are_read_with_the_length_of_a_slide(tmp_path):
    scara = tmp_path / "scara_standard.csv"
    rows = (
        "1,revolute,0,320,275,0\n2,revolute,0,0,225,180\n3,prismatic,0,40,0,0\n4,revolute,0,0,0,0\n"
    )
    scara.write_text("joint,type,theta [deg],d [mm],a [mm],alpha [deg]\n" + rows)
    random = np.random.default_rng(3)
    joints = random.uniform([-120, -130, 0, -180], [120, 130, 170, 180], (40, 4))
    turned = np.where([True, True, False, True], np.deg2rad(joints), joints)
    flange = nominal_poses(load_robot(robot_keys(str(scara), "scara")), turned)
    points = flange[:, :3, :3] @ [41.0, -20.0, 15.0] + flange[:, :3, 3]
    points += random.normal(size=points.shape) * 0.02
    header = ["Theta1(deg)", "Theta2(deg)", "Z-axis(mm)", "Theta4(deg)", *POINT]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([joints, points]))
    made = imported(path, (scara,), tmp_path)
    assert np.allclose(made.recording.columns["q3_mm"], joints[:, 2])


def test_a_northing_is_no_row_number(arm, tmp_path):
    """E, N and H of a total station: N stands above numbers of rows, too."""
    _, joints, points = arm
    cells = np.column_stack([joints, points / 1000])
    header = [*[f"J{k}" for k in range(1, 8)], "E [m]", "N [m]", "H [m]"]
    made = imported(write_rows(tmp_path / "t.csv", header, cells), arm, tmp_path)
    assert np.allclose(made.recording.points, points, atol=1e-4)


def test_a_track_in_another_unit_than_the_points(arm, tmp_path):
    _, joints, points = arm
    cells = np.column_stack([joints, points / 1000])
    path = write_rows(tmp_path / "t.csv", [*[f"J{k}" for k in range(1, 8)], *POINT], cells)
    made = imported(path, arm, tmp_path)
    assert made.mapping.point.unit == "m" and made.mapping.joints.unit[0] == "mm"
    assert np.allclose(made.recording.columns["q1_mm"], joints[:, 0])


def test_programs_keep_external_axes_that_move(tmp_path):
    kuka = tmp_path / "p.dat"
    axes = "A1 1.0,A2 2.0,A3 3.0,A4 4.0,A5 5.0,A6 6.0"
    kuka.write_text(
        f"DECL E6AXIS XP1={{{axes},E1 100.5,E2 0.0}}\nDECL E6AXIS XP2={{{axes},E1 2400.0,E2 0.0}}\n"
    )
    (table,) = read_robot_program(kuka)
    assert table.columns["E1"].tolist() == [100.5, 2400.0] and "E2" not in table.columns
    abb = tmp_path / "p.mod"
    targets = [
        f"CONST jointtarget p{k}:=[[1,2,3,4,5,6],[{k}00,9E9,9E9,9E9,9E9,9E9]];" for k in "12"
    ]
    abb.write_text("\n".join(targets))
    (table,) = read_robot_program(abb)
    assert table.columns["E1"].tolist() == [100.0, 200.0] and "E2" not in table.columns


def test_targets_without_the_column_of_the_track_are_refused_by_their_number(tmp_path):
    """Their units would be asked for as if the first axis were the track."""
    path = write_rows(tmp_path / "t.csv", [f"{a} [deg]" for a in AXES], np.zeros((2, 6)))
    with pytest.raises(InputError, match="expected 7 columns of joint readings"):
        read_targets(path, [True, *6 * [False]])
