"""Hand-eye data as scripts write them: numbered names, one marker in a list, names of parts and of frames in headers."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources.numbered_records import numbered_records
from datasets.importers.sources.records import read_record_tables
from datasets.importers.sources.storage import read_storage
from workbench.recordings.importing import ImportOptions
from workbench.recordings.importing.sources.finding import find_mapping

CAMERA = Rotation.from_euler("xyz", [4, -7, 88], degrees=True)
BOARD = Rotation.from_euler("xyz", [170, 5, 30], degrees=True)


def pairs(count=14, noise_mm=0.2):
    """Origins (n, 3) m and rotations of a flange, and those of a fixed board in a camera on it."""
    rng = np.random.default_rng(5)
    turned = Rotation.from_rotvec(rng.normal(size=(count, 3)) * 0.4 + [np.pi, 0, 0])
    origins = rng.normal(size=(count, 3)) * [90, 110, 60] + [640, -80, 510]
    seen = (turned * CAMERA).inv()
    places = seen.apply(np.array([600.0, 20, 5]) - origins - turned.apply([35.0, -20, 80]))
    places += rng.normal(size=places.shape) * noise_mm
    turns = seen * BOARD * Rotation.from_rotvec(rng.normal(size=(count, 3)) * 1e-3)
    return origins / 1000, turned, places / 1000, turns


def numbers_of(paths, folder, poses, places):
    """The table of the files; its columns of flange and target hold the poses (n, k) and the positions (n, 3)."""
    found = find_mapping(paths, ImportOptions(), folder)
    mapping, columns = found.mapping, found.table.columns
    assert mapping.measures == "target-pose"
    flange = (*mapping.flange_point.columns, *mapping.flange_rotation.columns)
    assert np.allclose(np.column_stack([columns[name] for name in flange]), poses)
    seen = np.column_stack([columns[name] for name in mapping.point.columns])
    assert np.allclose(seen, places)
    return found.table


def yaml_of(name, order, rows):
    return "".join(f"{name}_{k}:\n" + "".join(f"- {v:.9f}\n" for v in rows[k]) for k in order)


def test_lists_under_numbered_names_are_rows_in_the_order_of_their_numbers(tmp_path):
    origins, turned, places, turns = pairs()
    flange = np.hstack([origins, turned.as_quat()])
    target = np.hstack([places, turns.as_quat()])
    rng = np.random.default_rng(1)
    paths = [tmp_path / "ee2base.yaml", tmp_path / "marker2camera.yaml"]
    for path, name, rows in zip(paths, ("ee2base", "marker"), (flange, target)):
        path.write_text(yaml_of(name, rng.permutation(len(rows)), rows))
    numbers_of(paths, tmp_path, flange, places)


def test_one_marker_in_a_list_belongs_to_its_record(tmp_path):
    origins, turned, places, turns = pairs()
    poses = np.hstack([1000 * origins, turned.as_euler("xyz", degrees=True)])
    records = [
        {
            "record_id": k,
            "timestamp": f"20260131_1818{k:02d}",
            "robot_coords": list(pose),
            "aruco_markers": [
                {
                    "id": 0,
                    "translation_mm": list(1000 * place),
                    "rotation_vector": list(turn),
                    "corners": [[[401.0 + k, 26.0], [449.0, 27.0], [444.0, 75.0], [398.0, 75.0]]],
                }
            ],
        }
        for k, (pose, place, turn) in enumerate(zip(poses, places, turns.as_rotvec()), 1)
    ]
    path = tmp_path / "record.json"
    path.write_text(json.dumps(records, indent=1))
    table = numbers_of([path], tmp_path, poses, 1000 * places)
    assert table.columns["timestamp"][1] == "20260131_181802"


def test_records_without_a_marker_are_left_out():
    record = {"pose": [1.0, 2, 3, 4, 5, 6], "markers": [{"t": [1.0, 2, 3]}]}
    gap = {"pose": [1.5, 2, 3, 4, 5, 6], "markers": []}
    table = read_record_tables(Path("record.json"), [record, gap, record, record])[0]
    assert table.n == 4 and np.isnan(table.columns["markers t 1"]).tolist() == [0, 1, 0, 0]


def test_headers_name_frame_quantity_and_object(tmp_path):
    origins, turned, places, turns = pairs()
    rows = np.hstack([origins, turned.as_rotvec(), places, turns.as_quat()])
    head = "stamp_sec,B_tcp_x,B_tcp_y,B_tcp_z,B_tcp_rx,B_tcp_ry,B_tcp_rz,C_p_O_x,C_p_O_y,C_p_O_z,"
    head += "C_q_O_x,C_q_O_y,C_q_O_z,C_q_O_w"
    lines = [
        ",".join([f"{1.7e9 + 7 * k:.3f}", *(f"{value:.9f}" for value in row)])
        for k, row in enumerate(rows)
    ]
    path = tmp_path / "samples.csv"
    path.write_text("\n".join([head, *lines]) + "\n")
    numbers_of([path], tmp_path, rows[:, :6], places)


def _storage(path, body):
    path.write_text("%YAML:1.0\n---\n" + body)
    return read_storage(path).tables[0]


def test_file_storage_of_vectors_in_lists_and_of_numbered_sequences(tmp_path):
    rows = np.round(np.random.default_rng(2).normal(size=(9, 6)), 6)

    def items(vectors):
        return "".join(
            "   - !!opencv-matrix\n      rows: 3\n      cols: 1\n      dt: d\n"
            f"      data: [ {v[0]}, {v[1]}, {v[2]} ]\n"
            for v in vectors
        )

    body = f"Rotation_Vec:\n{items(rows[:, 3:])}Translation_Vec:\n{items(rows[:, :3])}"
    board = _storage(tmp_path / "board.yml", body)
    cells = [cells for name, cells in board.columns.items() if name != "number"]
    assert np.allclose(np.column_stack(cells), rows)
    lines = [f"pose{k}: [ {', '.join(map(str, row))} ]\n" for k, row in enumerate(rows, 1)]
    robot = _storage(tmp_path / "robot.yml", "unit: mm\n" + "".join(lines))
    cells = [robot.columns[f"pose {k}"] for k in range(1, 7)]
    assert np.allclose(np.column_stack(cells), rows)


@pytest.mark.parametrize(
    "content",
    [
        {f"q{k}": list(range(6)) for k in range(1, 7)},  # six joints of six samples
        {f"q{k}": list(range(40)) for k in range(1, 7)},
        {"joint1": {"a": 1}, "joint2": {"a": 2}, "joint3": {"a": 3}, "flange": {"a": 4}},
        {f"arm{k}": {"q": [1.0] * 9, "x": [2.0] * 9} for k in range(4)},
        {"pose1": [1, 2], "pose2": [1, 2, 3], "pose3": [1, 2]},
        {"a1": "x", "a2": "y", "a3": "z"},
    ],
)
def test_columns_under_numbered_names_are_no_rows(content):
    assert numbered_records(content, "pose") is None


def test_numbers_alone_name_records():
    content = {str(k): {"p_cam": [1.0, 2, 3], "pose": [0.0] * 7} for k in (2, 0, 1)}
    records = numbered_records(content, "calib")
    assert [record["number"] for record in records] == [0, 1, 2] and "p_cam" in records[0]
    rows = numbered_records({str(k): [1.0, 2, 3] for k in range(5)}, "calib")
    assert rows[0] == {"number": 0, "calib": [1.0, 2, 3]}


def columns_of(content) -> dict:
    """Columns by name of the one table of a JSON value."""
    (table,) = read_record_tables(Path("poses.json"), content)
    return table.columns


def test_a_record_without_one_of_the_names_has_a_gap_there():
    records = {f"pose{k}": {"p": [k, 2.0, 3.0], "q": [0.0, 0.0, 0.0, 1.0]} for k in range(1, 7)}
    del records["pose4"]["q"]
    columns = columns_of(records)
    assert columns["p 1"].tolist() == [1, 2, 3, 4, 5, 6]
    assert np.flatnonzero(np.isnan(columns["q 4"])).tolist() == [3]


def test_lists_next_to_numbered_poses_are_columns_of_their_rows():
    poses = {f"T{k}": np.eye(4).tolist() for k in (3, 1, 2, 4, 5)}
    columns = columns_of(poses | {"joints": [[k, 0.5] for k in (30, 10, 20, 40, 50)]})
    assert columns["number"].tolist() == [1, 2, 3, 4, 5]
    assert columns["joints 1"].tolist() == [10, 20, 30, 40, 50]


def test_numbered_lists_as_long_as_those_of_a_point_are_columns():
    content = {f"q{k}": [1.0, 2.0, 3.0, 4.0 + k] for k in range(1, 7)}
    columns = columns_of(content | {name: [7.0, 8.0, 9.0, 1.0] for name in "xyz"})
    assert columns["q6"].tolist() == [1, 2, 3, 10] and columns["x"].tolist() == [7, 8, 9, 1]


def test_the_pose_of_a_tool_is_no_column_next_to_numbered_poses():
    poses = {f"pose{k}": [k, 2.0, 3.0, 0.1, 0.2, 0.3] for k in range(1, 9)}
    assert len(numbered_records(poses | {"tool": [0.0, 0, 100, 0, 0, 0]}, "pose")) == 8


def test_two_lists_that_differ_in_a_separator_do_not_replace_one_another():
    first = {f"pose{k}": [k, 1.0] for k in range(1, 6)}
    second = {f"pose_{k}": [k, 2.0] for k in range(1, 6)}
    assert numbered_records(first | second, "pose") is None
    assert len(numbered_records(first, "pose")) == 5


def test_dimensions_of_joints_do_not_hide_the_list_of_samples():
    dimensions = {f"joint{k}": {"a": 1.0, "d": 2.0} for k in range(1, 7)}
    samples = [{"x": float(k), "y": 1.0} for k in range(20)]
    assert columns_of(dimensions | {"samples": samples})["x"].tolist() == list(range(20))
