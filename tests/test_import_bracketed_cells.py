"""Lists of numbers in brackets, and numbers with a word in front: cells of logs and of lines that programs print."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources.tables.cells import labels_of, split_cells
from datasets.importers.sources.tables.text_tables import read_text_table
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.recordings.importing import import_recording


@pytest.mark.parametrize(
    "line, separator, cells",
    [
        ("a.png p[0.1, -0.2, 0.3]", " ", ["a.png", "p[0.1, -0.2, 0.3]"]),
        ("7,[1.0,2.0],ok", ",", ["7", "[1.0,2.0]", "ok"]),
        ("7;(1,5; 2,5);ok", ";", ["7", "(1,5; 2,5)", "ok"]),
        ('"a b",{1 2 3},4', ",", ["a b", "{1 2 3}", "4"]),
        ('7,"[1, 2, 3]",8', ",", ["7", "[1, 2, 3]", "8"]),
        ("X (mm, base),Y (mm, base)", ",", ["X (mm", "base)", "Y (mm", "base)"]),
        ("7,[1.0,2.0", ",", ["7", "[1.0", "2.0"]),
        ("run 12: speed=5 q=[1, 2]", " ", ["run", "12", "5", "[1, 2]"]),
        ("A:1,B:2,C: 3", ",", ["A:1", "B:2", "3"]),
    ],
)
def test_brackets_around_numbers_hold_a_cell_together(line, separator, cells):
    assert split_cells(line, separator) == cells


def test_a_line_without_the_second_bracket_takes_no_time():
    line = "[" + ",".join(["1"] * 20000)
    assert len(split_cells(line, ",")) == 20000


def test_words_in_front_of_numbers_are_labels():
    assert labels_of("pose 1: {1, 2} speed=5 2.5 mm", " ") == ["", "pose", "", "speed", "", ""]
    assert labels_of("x: 1.5;y=2", ";") == ["x", "y"]


def test_rows_name_their_numbers_where_no_header_does(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(
        "// log of the cell, second shift\n" + "run 1 x=1.5 y=2.5\nrun 2 x=3.5 y=4.5\n" * 2
    )
    table = read_text_table(path)
    assert list(table.columns) == ["column 1", "run", "x", "y"]
    np.testing.assert_array_equal(table.columns["y"], [2.5, 4.5, 2.5, 4.5])


def test_a_word_of_one_row_is_no_label(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("good 1 2.5 3.5\nbad 2 4.5 5.5\nbad 3 4.0 5.0\n")
    assert list(read_text_table(path).columns) == [f"column {k}" for k in range(1, 5)]


def test_a_column_of_lists_alone(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text("TCP pose\np[0.1, 0.2, 0.3, 0.0, 1.5, 0.1]\np[0.2, 0.2, 0.3, 0.1, 1.5, 0.1]\n")
    table = read_text_table(path)
    assert list(table.columns) == [f"TCP pose {k}" for k in range(1, 7)]
    np.testing.assert_array_equal(table.columns["TCP pose 1"], [0.1, 0.2])


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def listed(values) -> str:
    return "[" + ", ".join(f"{v:.10g}" for v in values) + "]"


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
def test_joint_readings_and_poses_in_brackets(truth, tmp_path, separator):
    """One line a sample: readings in rad, the point and rotation vector as UR writes poses, in m and rad."""
    vectors = Rotation.from_quat(
        np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1)
    ).as_rotvec()
    rows = [separator.join(["nr", "joints", "tracker_pose"])]
    for k in range(truth.n):
        pose = [*(truth.points[k] / 1000), *vectors[k]]
        rows.append(separator.join([str(k + 1), listed(truth.joints[k]), "p" + listed(pose)]))
    path = tmp_path / "lines.txt"
    path.write_text("\n".join(rows) + "\n")
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.mapping.rotation.convention == "rotation vector"
    assert_same_rows(made.recording, truth)


@pytest.mark.parametrize(
    ("name", "point"),
    [("stop {}: {{{}}} v=5", "S{:03d}"), ("P{}: {{{}}}", "P{}"), ("P{} = [{}]", "P{}")],
)
def test_a_log_that_labels_its_rows_is_joined_by_them(truth, tmp_path, name, point):
    """The log names each row ("stop 7:") but not its joints; the rows of the tracker are in another order."""
    log = tmp_path / "log.txt"
    stops = [name.format(k + 1, listed(row)[1:-1]) for k, row in enumerate(degrees(truth))]
    log.write_text("\n".join(stops) + "\n")
    order = np.random.default_rng(2).permutation(truth.n)
    rows = [[point.format(k + 1), *truth.points[k]] for k in order]
    path = write_rows(tmp_path / "tracker.csv", ["Point", "X", "Y", "Z"], rows)
    made = import_recording([log, path], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)
    (said,) = [text for text in made.warnings if "in different orders" in text]
    assert "and Point" in said
