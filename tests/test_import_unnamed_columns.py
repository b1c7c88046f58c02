"""Import of tables whose headers are unknown: columns are found by how well they fit the robot, never guessed."""

import numpy as np
import pytest

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from robot_model import load_robot
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.recordings.importing import ImportOptions, import_recording

JOINTS = ["Grundachse", "Schulter", "Ellbogen", "Hand A", "Hand B", "Hand C"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, truth, joints=JOINTS, point=("Ost", "Nord", "Höhe"), more=()):
    """A table with two further columns of numbers, whose points are in m."""
    noise = np.random.default_rng(0).normal(size=(truth.n, 2 + len(more)))
    noise[:, 2:] *= 100
    cells = [noise[:, :1], degrees(truth), truth.points / 1000, noise[:, 1:]]
    header = ["Strom", *joints, *point, "Feuchte", *more]
    return write_rows(path, header, np.column_stack(cells))


def test_points_without_a_known_header_are_found_by_their_fit(truth, tmp_path):
    names = [f"J{k} [deg]" for k in range(1, 7)]
    made = import_recording([table(tmp_path / "t.csv", truth, names)], tmp_path / "out", UR10)
    assert made.mapping.point.columns == ("Ost", "Nord", "Höhe")
    assert made.mapping.point.unit == "m"
    assert_same_rows(made.recording, truth)
    assert made.warnings[0].startswith("No header names the measured point.")


def test_joints_and_points_without_known_headers_are_found_by_their_fit(truth, tmp_path):
    made = import_recording([table(tmp_path / "t.csv", truth)], tmp_path / "out", UR10)
    assert made.mapping.joints.columns == tuple(JOINTS)
    assert_same_rows(made.recording, truth)
    assert "joint readings" in made.warnings[0]


def test_northing_before_easting_is_exchanged(truth, tmp_path):
    points = truth.points[:, [1, 0, 2]] / 1000
    header = [*(f"J{k}" for k in range(1, 7)), "Nord", "Ost", "Höhe"]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([degrees(truth), points]))
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.mapping.point.columns == ("Ost", "Nord", "Höhe")
    assert_same_rows(made.recording, truth)


def test_columns_that_do_not_fit_are_not_used(truth, tmp_path):
    noise = np.random.default_rng(1).normal(size=(truth.n, 3)) * 500
    header = [*(f"J{k}" for k in range(1, 7)), "Ost", "Nord", "Höhe"]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([degrees(truth), noise]))
    with pytest.raises(InputError, match="expected columns with a measured point"):
        import_recording([path], tmp_path / "out", UR10)


def test_two_sets_that_fit_are_a_question(truth, tmp_path):
    shifted = truth.points + [10.0, 20.0, 30.0]
    header = [*(f"J{k}" for k in range(1, 7)), "Ost", "Nord", "Höhe", "Ost'", "Nord'", "Höhe'"]
    cells = np.column_stack([degrees(truth), truth.points, shifted])
    path = write_rows(tmp_path / "t.csv", header, cells)
    with pytest.raises(InputError, match="several sets of columns that fit"):
        import_recording([path], tmp_path / "out", UR10)


@pytest.mark.parametrize(
    "header, kind, label",
    [
        ("x-Koordinate in mm", "xyz", "x"),
        ("y-Position", "xyz", "y"),
        ("Z coordinate (mm)", "xyz", "z"),
        ("Drehwinkel um z", "turn", "z"),
    ],
)
def test_a_noun_after_the_component_is_understood(header, kind, label):
    found = read_header(header)
    assert (found.kind, found.label) == (kind, label)


def test_the_next_command_is_printed_in_full(truth, tmp_path, capsys):
    path, out = table(tmp_path / "t.csv", truth), tmp_path / "my robot"
    assert run(["import", str(path), "--robot", "ur10", "--out", str(out)]) == 0
    assert (
        f"Next: workbench calibrate '{out}' --out 'my robot-calibrate'" in capsys.readouterr().out
    )


def test_an_angle_in_the_header_of_a_prismatic_joint_is_refused(truth, tmp_path):
    table_of_links = tmp_path / "gantry_standard.csv"
    rows = "1,0,0,0,-90,prismatic\n2,90,0,0,90,prismatic\n3,0,300,100,0,\n4,0,0,250,0,\n"
    table_of_links.write_text("joint,theta,d [mm],a [mm],alpha [deg],type\n" + rows)
    header = ["J1 [deg]", "J2 [mm]", "J3 [deg]", "J4 [deg]", "X", "Y", "Z"]
    cells = np.random.default_rng(0).normal(size=(20, 7)) * 50
    path = write_rows(tmp_path / "t.csv", header, cells)
    with pytest.raises(InputError, match=r"J1 \[deg\]: expected a length of a prismatic joint"):
        import_recording([path], tmp_path / "out", ImportOptions(robot=str(table_of_links)))


def test_joints_that_hardly_move_are_a_question(truth, tmp_path):
    """Joints 4 and 6 of a parked wrist are not distinguishable by any fit, so that nobody may guess their order."""
    rng = np.random.default_rng(4)
    readings = truth.joints.copy()
    readings[:, [3, 5]] = rng.normal(size=(truth.n, 2)) * 5e-5
    flange = nominal_poses(load_robot({"builtin": "ur10"}), readings)
    points = flange[:, :3, :3] @ [10.0, 40.0, 130.0] + flange[:, :3, 3]
    points += rng.normal(size=points.shape) * 0.05
    path = write_rows(
        tmp_path / "t.csv",
        [*JOINTS, "Ost", "Nord", "Höhe"],
        np.column_stack([np.rad2deg(readings), points / 1000]),
    )
    with pytest.raises(InputError, match="found several sets of columns that fit"):
        import_recording([path], tmp_path / "out", UR10)


def test_a_left_handed_frame_is_said(truth, tmp_path):
    points = truth.points * [1.0, 1.0, -1.0] / 1000
    cells = np.column_stack([degrees(truth), points])
    path = write_rows(tmp_path / "t.csv", [*JOINTS, "Ost", "Nord", "Tiefe"], cells)
    made = import_recording([path], tmp_path / "out", UR10)
    assert "form a left-handed frame" in made.warnings[0]


def test_two_tables_without_a_known_header_are_read_in_their_order(truth, tmp_path):
    log = write_rows(tmp_path / "log.csv", JOINTS, degrees(truth))
    header = ["Punkt-Nr.", "Ost [m]", "Nord [m]", "Quote [m]"]
    numbers = 100.0 + np.arange(truth.n)
    rows = np.column_stack([numbers, truth.points / 1000])
    tracker = write_rows(tmp_path / "tracker.csv", header, rows)
    made = import_recording([log, tracker], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)
    with pytest.raises(InputError, match="add --robot"):
        import_recording([log, tracker], tmp_path / "again", ImportOptions())


def test_the_proposal_has_the_columns_that_fit_the_robot(truth, tmp_path, capsys):
    path, file = table(tmp_path / "t.csv", truth), tmp_path / "map.toml"
    assert run(["import", str(path), "--robot", "ur10", "--propose", str(file)]) == 0
    assert "CHECK, a guess from the fit to the robot" in file.read_text("utf-8")
    assert run(["import", str(path), "--map", str(file), "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    proposed = read_mapping(file)
    assert proposed.joints.columns == tuple(JOINTS)
    assert proposed.point.columns == ("Ost", "Nord", "Höhe")
