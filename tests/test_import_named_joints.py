"""Columns with the names of the robot file's joints, markers numbered behind the axis, and quoted cells of two lines."""

import numpy as np
import pytest

from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.mapping.model import read_mapping
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.cells import whole_rows
from datasets.importers.sources.tables.text_tables import read_text_table
from import_scenes import write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.robots import robot_keys
from workbench.recordings.importing.sources.named_joints import columns_of_joints

NAMES = ["waist", "shoulder_pitch", "shoulder_roll", "elbow", "forearm_roll", "hand_pitch"]
OFFSETS = ["0 0 .2", "0 .05 .1", "0 0 .15", ".02 0 .25", "0 0 .2", ".03 0 .1"]
AXES = ["0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0"]


def urdf(folder):
    """A URDF of six axes whose joints have names without numbers."""
    joints = [
        f'<joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{offset}"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
        for k, (name, offset, axis) in enumerate(zip(NAMES, OFFSETS, AXES))
    ]
    links = [f'<link name="l{k}"/>' for k in range(len(NAMES) + 1)]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(links + joints)}</robot>')
    return path


def test_joints_of_the_robot_file_are_read_by_their_names(tmp_path):
    robot_file = urdf(tmp_path)
    robot = load_robot(robot_keys(str(robot_file), "arm"))
    random = np.random.default_rng(2)
    joints = random.uniform(-1.4, 1.4, (40, 6))
    poses = nominal_poses(robot, joints)
    points = poses[:, :3, :3] @ [20.0, -30.0, 60.0] + poses[:, :3, 3]
    points += random.normal(size=points.shape) * 0.05
    order = [3, 0, 5, 1, 4, 2]
    headers = ["x1", "y1", "z1", *(f"{NAMES[k]}_joint" for k in order)]
    cells = np.column_stack([points / 1000, joints[:, order]])
    path = write_rows(tmp_path / "t.csv", headers, cells)
    made = import_recording([path], tmp_path / "out", ImportOptions(robot=str(robot_file)))
    assert made.mapping.joints.columns == tuple(f"{name}_joint" for name in NAMES)
    assert made.mapping.point.columns == ("x1", "y1", "z1")
    assert np.allclose(made.recording.columns["q4_deg"], np.rad2deg(joints[:, 3]))


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        (["b", "x", "a_b", "a"], ("a", "b")),
        (
            ["pos.a [rad]", "pos.b [rad]", "velocity.a", "velocity.b"],
            ("pos.a [rad]", "pos.b [rad]"),
        ),
        (["left/a", "left/b", "right/a", "right/b"], ()),
        (["a", "c"], ()),
    ],
)
def test_names_stand_between_one_prefix_and_one_suffix(columns, found):
    assert columns_of_joints(columns, ["a", "b"]) == found


def test_several_markers_are_points_and_no_joints():
    names = [f"{axis}{k}" for k in (1, 2) for axis in "xyz"]
    cells = {name: np.linspace(0, k, 9) for k, name in enumerate(names)}
    sets = find_sets(RawTable("t.csv", cells, np.arange(9)))
    assert [(one.kind, one.names) for one in sets] == [
        ("point", ("x1", "y1", "z1")),
        ("point", ("x2", "y2", "z2")),
    ]


@pytest.mark.parametrize("has_plane", [True, False])
def test_a_touched_plane_is_its_column_or_is_asked_for(has_plane, tmp_path):
    random = np.random.default_rng(4)
    headers = [f"q{k} [deg]" for k in range(1, 7)] + ["plane"] * has_plane
    cells = np.column_stack([random.uniform(-90, 90, (12, 6)), *[np.ones(12)] * has_plane])
    path = write_rows(tmp_path / "t.csv", headers, cells)
    (tmp_path / "m.toml").write_text('measures = "plane-touch"\nrobot = "ur5e"\n')
    options = ImportOptions(mapping=read_mapping(tmp_path / "m.toml"), trust_data=True)
    if has_plane:
        made = import_recording([path], tmp_path / "out", options)
        assert made.recording.columns["plane"].tolist() == [1.0] * 12
    else:
        with pytest.raises(InputError, match="expected a column plane"):
            import_recording([path], tmp_path / "out", options)


def test_a_quoted_cell_may_go_on_in_the_next_line(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text('J1,note,J2\n1.5,"first\nsecond",2\n3,"plain",4\n5,"a 2"" bolt",6\n')
    table = read_text_table(path)
    assert table.columns["J2"].tolist() == [2.0, 4.0, 6.0]
    assert table.columns["note"][0] == "first second"
    assert table.lines.tolist() == [2, 4, 5]


def test_a_quotation_mark_that_nothing_closes_ends_no_row():
    lines = ['5" bolt,1\n', '"3/4,2\n', "5,3\n"]
    assert list(whole_rows(lines)) == list(enumerate(lines, 1))
