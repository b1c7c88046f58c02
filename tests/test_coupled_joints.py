"""Robot files that miss the coupling of a joint with an earlier one, or state one that the readings do not have."""

import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from datasets.importers.sources.dh_tables import read_dh_table
from import_scenes import degrees, pose_scene, simulated, tracker, write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.recordings.importing import ImportOptions, import_recording

SCENE = pose_scene("fanuc_lr_mate_200id", 40, 5, "share_of_limits = 0.5")
HEADER = "joint,theta,d [mm],a [mm],alpha [deg]"
NAMES = [f"J{k}" for k in range(1, 7)]


def fanuc_keys() -> dict:
    """Keys of the robot file with the coupling of joints 2 and 3."""
    file = resources.files("robot_model") / "robots" / "fanuc_lr_mate_200id.toml"
    return tomllib.loads(file.read_text("utf-8"))


def with_coupling(place: int, coupled: dict | None) -> dict:
    """The same keys with another coupling of the joint at an index, or none."""
    keys = fanuc_keys()
    joint = {name: value for name, value in keys["joint"][place].items() if name != "coupled"}
    keys["joint"][place] = joint if coupled is None else joint | {"coupled": coupled}
    return keys


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    made = simulated(tmp_path_factory.mktemp("coupled"), SCENE)
    columns = {name: cells for name, cells in made.columns.items() if not name.startswith("q")}
    columns |= {name: cells for name, cells in made.columns.items() if name.endswith("_deg")}
    return replace(made, measures="external-point", columns=columns)


def suspicion(keys, recording):
    robot = load_robot(keys)
    return check_plausibility(robot, replace(recording, robot=keys))[0]


def test_a_missing_coupling_is_named_with_the_key_that_states_it(recording):
    found = suspicion(with_coupling(2, None), recording)
    assert found.certain and found.cause == "coupled-joints"
    assert "its angle is reading 3 + reading 2" in found.sentence
    assert "write coupled = { joint = 2, ratio = 1 } under [[joint]] number 3" in found.sentence


def test_a_coupling_of_the_opposite_sign_is_named(recording):
    found = suspicion(with_coupling(2, {"joint": 2, "ratio": -1.0}), recording)
    assert found.certain and "with a ratio of -1 instead of 1" in found.sentence


def test_a_coupling_that_the_readings_do_not_have_is_named(recording):
    angles = recording.columns["q3_deg"] + recording.columns["q2_deg"]
    decoupled = replace(recording, columns={**recording.columns, "q3_deg": angles})
    found = suspicion(fanuc_keys(), decoupled)
    assert found.certain and "remove its key coupled" in found.sentence


def test_a_missing_coupling_of_the_wrist_is_named(recording):
    reading = recording.columns["q6_deg"] + recording.columns["q5_deg"]
    coupled = replace(recording, columns={**recording.columns, "q6_deg": reading})
    found = suspicion(fanuc_keys(), coupled)
    assert found.certain and "coupled = { joint = 5, ratio = -1 }" in found.sentence


def test_a_sound_file_with_a_coupling_raises_no_doubt(recording):
    assert not check_plausibility(load_robot(fanuc_keys()), recording)


def tables(folder, recording):
    """Joint readings in radians and points in inches, and a Denavit-Hartenberg table without the coupling."""
    joints = write_rows(folder / "joints.csv", NAMES, np.deg2rad(degrees(recording)))
    points = tracker(folder / "points.csv", recording, 1 / 25.4, ("X", "Y", "Z"))
    rows = [HEADER]
    for k, joint in enumerate(fanuc_keys()["joint"], 1):
        sizes = (joint["d_mm"], joint["a_mm"], joint["alpha_deg"])
        rows.append(f"{k},q{k}{joint['theta_deg']:+g}," + ",".join(f"{v:g}" for v in sizes))
    table = folder / "arm.csv"
    table.write_text("\n".join([*rows, ""]))
    return [joints, points], table


def test_a_table_of_the_arm_is_refused_with_the_coupling_that_it_lacks(recording, tmp_path):
    files, table = tables(tmp_path, recording)
    with pytest.raises(InputError, match=r"or \+ q2 into its theta in the table \(q3 \+ q2\)"):
        import_recording(files, tmp_path / "made", ImportOptions(robot=str(table)))


def test_trusted_data_are_imported_with_the_coupling_as_a_warning(recording, tmp_path):
    files, table = tables(tmp_path, recording)
    options = ImportOptions(robot=str(table), trust_data=True)
    made = import_recording(files, tmp_path / "made", options)
    assert any("lacks its coupling" in said and "--trust-data" in said for said in made.warnings)
    assert np.abs(made.recording.points - recording.points).max() < 1e-3


def test_theta_with_the_variable_of_another_joint_states_the_coupling(recording, tmp_path):
    files, table = tables(tmp_path, recording)
    table.write_text(table.read_text().replace("3,q3", "3,q3+q2"))
    assert read_dh_table(table)[0]["joint"][2]["coupled"] == {"joint": 2, "ratio": 1.0}
    made = import_recording(files, tmp_path / "made", ImportOptions(robot=str(table)))
    assert made.fits[0].is_good


@pytest.mark.parametrize(
    ("cell", "coupled", "theta"),
    [
        ("q3 - q2 - 90°", {"joint": 2, "ratio": -1.0}, -90.0),
        ("q3-0.5*q2", {"joint": 2, "ratio": -0.5}, 0.0),
    ],
)
def test_cells_with_two_variables(cell, coupled, theta, tmp_path):
    table = tmp_path / "arm.csv"
    table.write_text(f"{HEADER}\n1,q1,300,20,-90\n2,q2,0,250,0\n3,{cell},10,40,90\n")
    joint = read_dh_table(table)[0]["joint"][2]
    assert joint["coupled"] == coupled and joint["theta_deg"] == theta
