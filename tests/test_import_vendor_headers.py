"""Headers of vendors' software: which set of columns is the point, the joints, a rotation, or a spread."""

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.importers.mapping.joined_tables.time_units import with_time_units
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable
from datasets.importers.sources.choice import read_sources
from datasets.importers.sources.dh_tables import read_dh_table

ROWS = 30
JOINTS = [f"A{k}" for k in range(1, 7)]


def table(names, seed=1):
    cells = np.random.default_rng(seed).normal(scale=100, size=(ROWS, len(names)))
    return RawTable("t.csv", dict(zip(names, cells.T)), np.arange(ROWS))


def test_the_position_of_the_controller_keeps_its_rotation():
    controller = [f"$POS_ACT.{axis}" for axis in "XYZABC"]
    mapping = propose(table([*JOINTS, *controller, "LT_X", "LT_Y", "LT_Z"])).mapping
    assert mapping.point.columns == ("LT_X", "LT_Y", "LT_Z")
    assert mapping.rotation is None


def test_angles_behind_the_flange_position_are_those_of_the_flange():
    flange = ["tcp_x", "tcp_y", "tcp_z", "roll", "pitch", "yaw"]
    mapping = propose(table([*flange, "marker_x", "marker_y", "marker_z"])).mapping
    assert mapping.flange_rotation.columns == ("roll", "pitch", "yaw")
    assert mapping.rotation is None


def test_standard_deviations_of_coordinates_are_no_second_point():
    spreads = ["sX", "sY", "sZ", "Ux", "Uy", "Uz"]
    mapping = propose(table([*JOINTS, "X[mm]", "Y[mm]", "Z[mm]", *spreads])).mapping
    assert mapping.point.columns == ("X[mm]", "Y[mm]", "Z[mm]")


def test_axes_of_a_palletiser_leave_out_one_number():
    mapping = propose(table(["A1", "A2", "A3", "A4", "A6", "X", "Y", "Z"])).mapping
    assert mapping.joints.columns == ("A1", "A2", "A3", "A4", "A6")


@pytest.mark.parametrize("numbers", [(1, 2, 5, 6), (1, 2, 4), (2, 3, 4, 6)])
def test_other_numbers_are_no_axes_of_one_arm(numbers):
    names = [f"A{k}" for k in numbers]
    assert propose(table([*names, "X", "Y", "Z"])).mapping.joints is None


def test_points_with_a_letter_in_front_of_their_number_are_several_reflectors():
    names = [f"{axis}a{k}" for k in (1, 2, 3) for axis in "xyz"]
    with pytest.raises(InputError, match=r'\[point.2\] columns = \["xa2", "ya2", "za2"\]'):
        propose(table([*JOINTS, *names]))


def test_a_negative_joint_variable_of_a_dh_table_is_a_sign(tmp_path):
    thetas = ["-q1", "q2", "-q3-q2-90", "q4", "90-q5", "q6"]
    rows = "".join(f"{k},{theta},100,50,90\n" for k, theta in enumerate(thetas, 1))
    (tmp_path / "arm_standard.csv").write_text("joint,theta,d [mm],a [mm],alpha [deg]\n" + rows)
    (robot,) = read_dh_table(tmp_path / "arm_standard.csv")
    joints = robot["joint"]
    assert [joint.get("sign", 1) for joint in joints] == [-1, 1, -1, 1, -1, 1]
    assert [joint["theta_deg"] for joint in joints] == [0, 0, -90, 0, 90, 0]
    assert joints[2]["coupled"] == {"joint": 2, "ratio": -1.0}
    assert sum("coupled" in joint for joint in joints) == 1


def motion(size, step=0.01, rows=400):
    times = step * np.arange(rows)
    joints = {name: 40 * np.sin(times + k) for k, name in enumerate(JOINTS)}
    return RawTable("log.csv", {"time": times * size, **joints}, np.arange(rows))


def track(size):
    times = np.arange(0.2, 3.8, 0.4)
    points = {axis: 100 * np.cos(times + k) for k, axis in enumerate("XYZ")}
    return RawTable("track.csv", {"time": times * size, **points}, np.arange(len(times)))


@pytest.mark.parametrize(("unit", "size"), [("ms", 1e3), ("us", 1e6)])
def test_times_without_a_unit_are_those_of_a_motion(unit, size):
    tables = with_time_units([motion(size), track(size)])
    assert [one.units["time"] for one in tables] == [unit, unit]
    assert "state no unit" in tables[0].warnings[0]
    tables = with_time_units([motion(size), track(1.0)])
    assert [one.units.get("time") for one in tables] == [unit, None]


def test_times_in_seconds_and_logs_of_stops_keep_their_unit():
    stops = table(["time", *JOINTS])
    stops = RawTable("log.csv", {**stops.columns, "time": 10.0 * np.arange(ROWS)}, stops.lines)
    slow = motion(1e3, step=0.01, rows=40)
    fast = {name: 500 * cells for name, cells in slow.columns.items() if name != "time"}
    sweep = RawTable("log.csv", {"time": slow.columns["time"], **fast}, slow.lines)
    for log in (motion(1.0), stops, sweep):
        assert all(not one.units for one in with_time_units([log, track(1.0)]))
    assert not with_time_units([motion(1e3)])[0].units


def read(path, text):
    path.write_text(text)
    (made,) = read_sources([path], path.parent).tables
    return made


POINTS = np.round(np.random.default_rng(2).normal(scale=500, size=(8, 3)), 3)


def test_names_with_spaces_do_not_shift_the_columns_of_a_table_with_tabs(tmp_path):
    rows = "".join(f"Pose {k}\t{x}\t{y}\t{z}\n" for k, (x, y, z) in enumerate(POINTS))
    made = read(tmp_path / "points.txt", "Name\tX\tY\tZ\n" + rows)
    assert list(made.columns) == ["Name", "X", "Y", "Z"]
    assert np.array_equal(made.columns["X"], POINTS[:, 0])


def test_numbers_behind_an_equals_sign_with_spaces(tmp_path):
    rows = "".join(
        f'PT "SMR {k}"   X = {x}   Y = {y}   Z = {z}\n' for k, (x, y, z) in enumerate(POINTS)
    )
    made = read(tmp_path / "points.txt", rows)
    assert np.array_equal(np.stack([made.columns[axis] for axis in "XYZ"], axis=1), POINTS)


def test_attributes_of_single_children_belong_to_a_record(tmp_path):
    rows = "".join(
        f'<Rob Nr="{k}"><AIPos A1="{x}" A2="{y}"/><RIst X="{z}"/></Rob>\n'
        for k, (x, y, z) in enumerate(POINTS)
    )
    made = read(tmp_path / "rsi.xml", f"<Log>\n{rows}</Log>\n")
    assert list(made.columns) == ["Nr", "AIPos A1", "AIPos A2", "RIst X"]
    assert np.array_equal(made.columns["RIst X"], POINTS[:, 2])


def test_axes_of_one_name_are_the_point_and_rax_are_joints():
    joints = [f"rax_{k}" for k in range(1, 7)]
    mapping = propose(table(["X_Value", *joints, "PX", "PY", "PZ"])).mapping
    assert mapping.point.columns == ("PX", "PY", "PZ")
    assert mapping.joints.columns == tuple(joints)
