"""Denavit-Hartenberg tables with a fixed row before the first joint or after the last one (mount, flange)."""

import numpy as np
import pytest

from datasets.importers.sources.dh_tables import read_dh_table
from import_scenes import assert_same_rows, degrees, pose_scene, simulated, write_rows
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

HEADER = "joint,theta,d [mm],a [mm],alpha [deg]"
MODIFIED = "joint,theta,d [mm],a i-1 [mm],alpha i-1 [deg]"
THREE = ["J1,q1,300,20,-90", "J2,q2-90,0,250,0", "J3,q3,10,40,90"]


def keys_of(folder, header, rows):
    path = folder / "arm.csv"
    path.write_text("\n".join([header, *rows, ""]))
    return read_dh_table(path)[0]


@pytest.mark.parametrize(
    "row",
    ["Flange,0,85,12,30", "J4,0,85,12,30", "tool plate,-,85,12,30", "4,fixed,85,12,30"],
)
def test_a_row_after_the_last_joint_is_the_flange(row, tmp_path):
    keys = keys_of(tmp_path, HEADER, [*THREE, row])
    assert len(keys["joint"]) == 3 and "base" not in keys
    assert keys["flange"] == {"xyz_mm": [12.0, 0.0, 85.0], "rpy_deg": [30.0, 0.0, 0.0]}


def test_a_row_before_the_first_joint_is_the_base(tmp_path):
    keys = keys_of(tmp_path, HEADER, ["mount,90,50,0,0", *THREE])
    assert [joint["d_mm"] for joint in keys["joint"]] == [300, 0, 10]
    assert keys["base"] == {"xyz_mm": [0.0, 0.0, 50.0], "rpy_deg": [0.0, 0.0, 90.0]}


@pytest.mark.parametrize("header", [HEADER, MODIFIED])
def test_a_fixed_row_acts_as_a_joint_that_stands_at_its_theta(header, tmp_path):
    """The same table with a fourth joint in the place of the fixed row has the same flange at the reading 0."""
    fixed = load_robot(keys_of(tmp_path, header, [*THREE, "Flange,25,85,12,30"]))
    moving = load_robot(keys_of(tmp_path, header, [*THREE, "J4,q4+25,85,12,30"]))
    readings = np.array([10.0, -20.0, 35.0])
    poses = [
        forward(arm, arm.mixing @ np.deg2rad(q)[:, None])
        for arm, q in ((fixed, readings), (moving, np.append(readings, 0.0)))
    ]
    for one, other in zip(poses[0].end, poses[1].end):
        np.testing.assert_allclose(one, other, atol=1e-9)
    np.testing.assert_allclose(poses[0].end_origin, poses[1].end_origin, atol=1e-9)


@pytest.mark.parametrize("names", [["base", "shoulder", "elbow"], ["A", "B", "C"]])
def test_names_without_numbers_are_joints(names, tmp_path):
    rows = [f"{name},0,300,20,-90" for name in names]
    assert len(keys_of(tmp_path, HEADER, rows)["joint"]) == 3


def test_a_slide_without_a_variable_stays_a_joint(tmp_path):
    rows = ["1,0,300,20,-90,prismatic", "2,q2,0,250,0,", "3,q3,10,40,90,"]
    keys = keys_of(tmp_path, HEADER + ",type", rows)
    assert len(keys["joint"]) == 3 and keys["joint"][0]["kind"] == "prismatic"


def test_a_fixed_row_between_joints_is_refused(tmp_path):
    with pytest.raises(InputError, match="row 3: expected fixed rows only before the first joint"):
        keys_of(tmp_path, HEADER + ",type", ["1,0,300,20,-90,", "2,0,0,9,0,fixed", "3,0,0,9,0,"])


def test_import_with_a_flange_row(tmp_path):
    """Without variables in theta, the name of the row says that it has no joint."""
    truth = simulated(tmp_path, pose_scene("abb_irb120", 36, 4, "share_of_limits = 0.4"))
    arm = load_robot("abb_irb120").geometry
    rows = [
        [f"axis {k + 1}", *np.rad2deg([theta]), d, a, *np.rad2deg([alpha])]
        for k, (theta, d, a, alpha, _) in enumerate(arm)
    ]
    header = HEADER.split(",")
    table = write_rows(tmp_path / "arm_standard.csv", header, [*rows, ["flange", 0, 40, 0, 180]])
    names = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    path = write_rows(tmp_path / "t.csv", names, np.column_stack([degrees(truth), truth.points]))
    made = import_recording([path], tmp_path / "out", ImportOptions(robot=str(table)))
    assert_same_rows(made.recording, truth)
    assert made.recording.robot["flange"]["xyz_mm"] == [0.0, 0.0, 40.0]
    rows[2][0] = "elbow"
    more = write_rows(tmp_path / "all_standard.csv", header, [*rows, ["more", 0, 40, 0, 180]])
    with pytest.raises(InputError, match="expected 7 joint columns.*word fixed in a column type"):
        import_recording([path], tmp_path / "again", ImportOptions(robot=str(more)))


def test_offsets_in_degrees_next_to_a_column_in_radians(tmp_path):
    """`q2-90` cannot be 90 radians, though alpha is stated in them."""
    rows = ["J1,q1,300,20,-1.5707963", "J2,q2-90,0,250,0", "J3,q3,10,40,1.5707963"]
    keys = keys_of(tmp_path, "joint,theta,d [mm],a [mm],alpha [rad]", rows)
    assert [joint["theta_deg"] for joint in keys["joint"]] == [0.0, -90.0, 0.0]
    assert [joint["alpha_deg"] for joint in keys["joint"]] == [-90.0, 0.0, 90.0]
