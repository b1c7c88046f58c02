"""Import of every kind of source, each read from a file that the test writes."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import read_mapping
from datasets.importers.sources import read_sources
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, tracker, write_rows
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.board_images.notation import board_keys


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def test_excel_with_titles_german_headers_and_inches(truth, tmp_path):
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Messprotokoll", "Halle 3"])
    sheet.append([])
    header = [f"Achse {k} [°]" for k in range(1, 7)]
    sheet.append(["Nr", *header, "Messpunkt X (Zoll)", "Messpunkt Y (Zoll)", "Messpunkt Z (Zoll)"])
    for k, (q, p) in enumerate(zip(degrees(truth), truth.points / 25.4)):
        sheet.append([k + 1, *q.tolist(), *p.tolist()])
    book.save(tmp_path / "messung.xlsx")
    made = import_recording([tmp_path / "messung.xlsx"], tmp_path / "out", UR10)
    assert made.recording.measures == "external-point"
    assert_same_rows(made.recording, truth)


def test_spatial_analyzer_export_with_comments_and_stated_units(truth, tmp_path):
    lines = [
        "// SpatialAnalyzer export",
        "// Units: Inches",
        "// Collection, Group, Point, X, Y, Z",
    ]
    for k, p in enumerate(truth.points / 25.4):
        lines.append(f"A, robot points, p{k}, {p[0]:.9f}, {p[1]:.9f}, {p[2]:.9f}")
    (tmp_path / "sa.txt").write_text("\n".join(lines))
    joints = write_rows(tmp_path / "joints.csv", [f"J{k}" for k in range(1, 7)], degrees(truth))
    made = import_recording([joints, tmp_path / "sa.txt"], tmp_path / "out", UR10)
    assert made.mapping.point.unit == "in"
    assert_same_rows(made.recording, truth)


def test_decimal_comma_unit_row_and_footer(truth, tmp_path):
    lines = ["J1;J2;J3;J4;J5;J6;X;Y;Z", "rad;rad;rad;rad;rad;rad;m;m;m"]
    for q, p in zip(truth.joints, truth.points / 1000):
        lines.append(";".join(f"{v:.10f}".replace(".", ",") for v in (*q, *p)))
    lines.append("Ende der Messung")
    (tmp_path / "t.csv").write_text("\n".join(lines), encoding="cp1252")
    made = import_recording([tmp_path / "t.csv"], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)
    assert made.mapping.joints.unit == "rad"
    assert any("after the table" in sentence for sentence in made.warnings)


def test_rows_with_empty_cells_are_left_out_and_named(truth, tmp_path):
    rows = [[f"{v:.9g}" for v in (*q, *p)] for q, p in zip(degrees(truth), truth.points)]
    rows[4][7] = ""
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    path = write_rows(tmp_path / "t.csv", header, rows)
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.recording.n == truth.n - 1
    assert any("rows 6" in sentence for sentence in made.warnings)


def test_tables_are_joined_by_the_names_of_the_points(truth, tmp_path):
    order = np.random.default_rng(1).permutation(truth.n)
    names = [f"P{k}" for k in range(truth.n)]
    joints = [(names[k], *degrees(truth)[k]) for k in range(truth.n)]
    points = [(names[k], *truth.points[k]) for k in order[:30]]
    a = write_rows(tmp_path / "robot.csv", ["Name", *(f"J{k}" for k in range(1, 7))], joints)
    b = write_rows(tmp_path / "tracker.csv", ["Point", "X", "Y", "Z"], points)
    made = import_recording([a, b], tmp_path / "out", UR10)
    assert made.mapping.join.by == "key"
    assert_same_rows(made.recording, truth.select(order[:30]))


def test_rtde_log_is_interpolated_at_the_times_of_the_tracker(truth, tmp_path):
    times = np.arange(truth.n) * 2.0 + 5.0
    log_times = np.arange(0.0, times[-1] + 5, 0.02)
    q = truth.joints
    # the arm stands still for one second around each measurement
    knots = np.ravel([times - 0.5, times + 0.5], order="F")
    stands = np.repeat(q, 2, axis=0)
    log = np.stack([np.interp(log_times, knots, stands[:, j]) for j in range(6)], axis=1)
    header = [
        "timestamp",
        *(f"actual_q_{k}" for k in range(6)),
        *(f"target_q_{k}" for k in range(6)),
    ]
    rows = np.column_stack([log_times, log, log + 0.3])
    a = write_rows(tmp_path / "rtde.csv", header, rows, " ")
    b = write_rows(
        tmp_path / "t.csv", ["Time [s]", "X", "Y", "Z"], np.column_stack([times, truth.points])
    )
    made = import_recording([a, b], tmp_path / "out", UR10)
    assert made.mapping.join.by == "time"
    assert_same_rows(made.recording, truth, joints=1e-4)


def kuka(q):
    body = "\n".join(
        f"DECL E6AXIS XP{k}={{A1 {a[0]:.6f},A2 {a[1]:.6f},A3 {a[2]:.6f},A4 {a[3]:.6f},A5 {a[4]:.6f},A6 {a[5]:.6f},E1 0.0}}"
        for k, a in enumerate(q, 1)
    )
    return "points.dat", f"&ACCESS RVP\nDEFDAT points\n{body}\nENDDAT\n"


def abb(q):
    body = "\n".join(
        f"  CONST jointtarget j{k}:=[[{','.join(f'{v:.6f}' for v in a)}],[9E9,9E9,9E9,9E9,9E9,9E9]];"
        for k, a in enumerate(q, 1)
    )
    return "points.mod", f"MODULE points\n{body}\nENDMODULE\n"


def fanuc(q):
    body = "\n".join(
        f"P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\tJ1= {a[0]:.6f} deg,\tJ2= {a[1]:.6f} deg,\tJ3= {a[2]:.6f} deg,\n"
        f"\tJ4= {a[3]:.6f} deg,\tJ5= {a[4]:.6f} deg,\tJ6= {a[5]:.6f} deg\n}};"
        for k, a in enumerate(q, 1)
    )
    return "points.ls", f"/PROG POINTS\n/POS\n{body}\n/END\n"


@pytest.mark.parametrize("maker", [kuka, abb, fanuc])
def test_joint_positions_of_a_robot_program(maker, truth, tmp_path):
    name, text = maker(degrees(truth))
    (tmp_path / name).write_text(text)
    points = tracker(tmp_path / "tracker.csv", truth)
    made = import_recording([tmp_path / name, points], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


def test_poses_of_robot_programs_have_the_conventions_of_their_makers(tmp_path):
    turn = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True)
    w, p, r = turn.as_euler("xyz", degrees=True)
    x, y, z, s = turn.as_quat()
    (tmp_path / "k.dat").write_text(
        "DECL E6POS XP1={X 100.0,Y 2.0,Z 3.0,A 30.0,B 20.0,C 10.0,S 2,T 1}\n"
    )
    (tmp_path / "a.mod").write_text(
        f"CONST robtarget p1:=[[100,2,3],[{s},{x},{y},{z}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];"
    )
    (tmp_path / "f.ls").write_text(
        f"P[1]{{\n GP1:\n UF : 0, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = 100.0 mm, Y = 2.0 mm, Z = 3.0 mm,\n"
        f" W = {w} deg, P = {p} deg, R = {r} deg\n}};"
    )
    from datasets.importers.mapping.candidates import rotation_candidates
    from datasets.importers.mapping.proposal import propose

    for name in ("k.dat", "a.mod", "f.ls"):
        table = read_sources([tmp_path / name], tmp_path).tables[0]
        mapping = propose(table, has_images=True).mapping
        (reading,) = rotation_candidates(mapping.flange_rotation, table)
        assert np.allclose(reading.matrices(table)[0], turn.as_matrix(), atol=1e-9), name
        assert mapping.flange_point.unit == "mm"


def test_targets_inside_the_moves_of_a_kuka_program(truth, tmp_path):
    moves = []
    for k, a in enumerate(degrees(truth)):
        cells = ", ".join(f"A{j} {value:.6f}" for j, value in enumerate(a, 1))
        moves.append(f"PTP {{{'E6AXIS: ' if k % 2 else ''}{cells}}} C_PTP")
    (tmp_path / "run.src").write_text("\n".join(["DEF run()", *moves, "END"]))
    points = tracker(tmp_path / "tracker.csv", truth)
    made = import_recording([tmp_path / "run.src", points], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


def poses_of(truth) -> np.ndarray:
    poses = np.tile(np.eye(4), (truth.n, 1, 1))
    quaternions = np.stack([truth.columns[f"q{c}"] for c in "xyzw"], axis=1)
    poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    poses[:, :3, 3] = truth.points
    return poses


def test_matlab_file_with_joints_in_rad_and_poses_in_m(truth, tmp_path):
    from scipy.io import savemat

    poses = poses_of(truth)
    poses[:, :3, 3] /= 1000
    savemat(tmp_path / "d.mat", {"q": truth.joints, "T_tracker": poses.transpose(1, 2, 0)})
    made = import_recording([tmp_path / "d.mat"], tmp_path / "out", UR10)
    assert made.recording.measures == "external-pose"
    assert_same_rows(made.recording, truth)


def write_matlab_73(path, variables):
    """As MATLAB writes version 7.3: HDF5 behind a head of 512 bytes, arrays with their axes in reverse order."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            made = file.create_dataset(name, data=np.asarray(value).T)
            kind = b"char" if made.dtype.kind == "u" else b"double"
            made.attrs["MATLAB_class"] = np.bytes_(kind)
        file.create_dataset("#refs#/a", data=np.arange(36.0))
    with path.open("r+b") as file:
        head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon May 13 14:03:00 2024 HDF5 schema 1.00 ."
        file.write(head.ljust(116) + bytes(8) + b"\x00\x02IM")


def test_matlab_file_of_version_73_with_a_structure(truth, tmp_path):
    poses = poses_of(truth)
    poses[:, :3, 3] /= 1000
    variables = {
        "robot/q": truth.joints,
        "T_tracker": poses.transpose(1, 2, 0),
        "note": np.frombuffer(b"a long note with more than 36 letters in it", np.uint8)[None],
    }
    write_matlab_73(tmp_path / "d.mat", variables)
    made = import_recording([tmp_path / "d.mat"], tmp_path / "out", UR10)
    assert made.recording.measures == "external-pose"
    assert_same_rows(made.recording, truth)


def test_a_damaged_matlab_file_of_version_73_is_refused(truth, tmp_path):
    path = tmp_path / "d.mat"
    write_matlab_73(path, {"q": truth.joints})
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match="d.mat: expected a MATLAB file, found a damaged one"):
        import_recording([path], tmp_path / "out", UR10)


def test_opencv_storage_with_joints_and_points(truth, tmp_path):
    import cv2

    storage = cv2.FileStorage(str(tmp_path / "d.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("joints", degrees(truth))
    poses = poses_of(truth)
    for k, pose in enumerate(poses):
        storage.write(f"tracker_{k}", pose)
    storage.release()
    made = import_recording([tmp_path / "d.yml"], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


def test_numpy_archive(truth, tmp_path):
    np.savez(tmp_path / "d.npz", joint=truth.joints, pose=poses_of(truth))
    made = import_recording([tmp_path / "d.npz"], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


def test_kalibr_target_becomes_a_board(tmp_path):
    path = tmp_path / "target.yaml"
    path.write_text(
        "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"
    )
    (tmp_path / "a.csv").write_text("x,y\n1,2\n3,4\n")
    board = read_sources([path, tmp_path / "a.csv"], tmp_path).board
    assert board == {"kind": "chessboard", "columns": 6, "rows": 7, "square_mm": 60.0}


def test_kalibr_aprilgrid_becomes_a_board(tmp_path):
    """The spacing of Kalibr is a share of the side of a tag."""
    path = tmp_path / "target.yaml"
    path.write_text(
        "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 5\ntagSize: 0.055\ntagSpacing: 0.3\n"
    )
    (tmp_path / "a.csv").write_text("x,y\n1,2\n3,4\n")
    board = read_sources([path, tmp_path / "a.csv"], tmp_path).board
    assert board == {
        "kind": "aprilgrid",
        "columns": 6,
        "rows": 5,
        "square_mm": 71.5,
        "marker_mm": 55.0,
    }
    assert board == board_keys("aprilgrid 6x5 71.5mm 55mm")


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("circles 4x11 0.5in asymmetric", {"square_mm": 12.7, "asymmetric": True}),
        ("circles 4x11 .7 in asymmetric on tool", {"square_mm": 17.78, "fixed_to": "tool"}),
        ("Charuco 7×5 3cm 22 mm DICT_5X5_250", {"square_mm": 30.0, "marker_mm": 22.0}),
        ("checkerboard 11x8 0.005 m", {"kind": "chessboard", "square_mm": 5.0}),
        ("chessboard 11x8 500 mil", {"square_mm": 12.7}),
    ],
)
def test_lengths_of_a_board_have_a_unit(text, keys):
    found = board_keys(text)
    assert {key: found[key] for key in keys} == keys


def test_a_board_without_a_unit_is_refused_with_those_that_are_known():
    with pytest.raises(InputError, match="lengths in mm, m, in, cm"):
        board_keys("chessboard 11x8 5")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\n", "key 'tagSize'"),
        ("target_type: 'arucogrid'\ntagCols: 6\n", "checkerboard, circlegrid or aprilgrid"),
    ],
)
def test_a_target_that_is_incomplete_or_unknown_is_refused(text, words, tmp_path):
    (tmp_path / "target.yaml").write_text(text)
    with pytest.raises(InputError, match=words):
        read_sources([tmp_path / "target.yaml"], tmp_path)


def write_bag(writer, store, header, truth):
    """Joint states at 50 Hz while the arm stands at each pose, and one point per pose."""
    types = store.types
    state, point = types["sensor_msgs/msg/JointState"], types["geometry_msgs/msg/PointStamped"]
    joints = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
    points = writer.add_connection("/tracker/point", point.__msgtype__, typestore=store)
    names = [
        "elbow_joint",
        "shoulder_lift_joint",
        "shoulder_pan_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    order = [2, 1, 0, 3, 4, 5]  # ROS sorts the names of the joints
    none = np.array([], float)
    for k, (q, p) in enumerate(zip(truth.joints, truth.points / 1000)):
        for step in range(50):
            stamp = int((100 + 2 * k + 0.02 * step) * 1e9)
            message = state(header(stamp, ""), names, q[order], none, none)
            yield joints, stamp, message
        stamp = int((100 + 2 * k + 0.5) * 1e9)
        yield points, stamp, point(header(stamp, "tracker"), types["geometry_msgs/msg/Point"](*p))


def test_ros2_bag_with_joint_states_and_points(truth, tmp_path):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    time = store.types["builtin_interfaces/msg/Time"]

    def header(stamp, frame):
        return store.types["std_msgs/msg/Header"](time(stamp // 10**9, stamp % 10**9), frame)

    with Writer(tmp_path / "bag", version=9) as writer:
        for connection, stamp, message in write_bag(writer, store, header, truth):
            writer.write(connection, stamp, store.serialize_cdr(message, connection.msgtype))
    made = import_recording([tmp_path / "bag"], tmp_path / "out", UR10)
    assert made.mapping.join.by == "time"
    assert made.recording.n == truth.n
    assert_same_rows(made.recording, truth, joints=1e-4)


def test_ros1_bag_with_joint_states_and_points(truth, tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    time = store.types["builtin_interfaces/msg/Time"]

    def header(stamp, frame):
        return store.types["std_msgs/msg/Header"](0, time(stamp // 10**9, stamp % 10**9), frame)

    with Writer(tmp_path / "run.bag") as writer:
        for connection, stamp, message in write_bag(writer, store, header, truth):
            writer.write(connection, stamp, store.serialize_ros1(message, connection.msgtype))
    made = import_recording([tmp_path / "run.bag"], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth, joints=1e-4)


def test_only_columns_that_nothing_was_read_from_are_unused(truth, tmp_path):
    """The column of times became time_s of the recording; the remark did not become anything."""
    header = [
        *(f"J{k} [deg]" for k in range(1, 7)),
        "X [mm]",
        "Y [mm]",
        "Z [mm]",
        "t [s]",
        "remark",
    ]
    times = 10.0 * np.arange(truth.n)
    numbers = np.column_stack([degrees(truth), truth.points, times])
    rows = [(*row, f"point {k}") for k, row in enumerate(numbers)]
    made = import_recording([write_rows(tmp_path / "t.csv", header, rows)], tmp_path / "out", UR10)
    np.testing.assert_allclose(made.recording.columns["time_s"], times)
    assert made.unused == ("remark",)


@pytest.mark.parametrize("kind", ["ply", "xyz", "pcd"])
def test_clouds_of_a_ball_with_joint_readings(kind, tmp_path):
    import open3d

    from workbench.recordings.templates.examples import ball_centre

    truth = ball_centre({"builtin": "ur10"})
    truth = truth.select(truth.ball == 1)
    rng = np.random.default_rng(2)
    files = []
    for k, centre in enumerate(truth.points):
        directions = rng.normal(size=(600, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        toward = directions @ (-centre / np.linalg.norm(centre)) > 0.3
        points = (
            centre + 15.0 * directions[toward] + 0.01 * rng.normal(size=(toward.sum(), 3))
        ) / 1000
        path = tmp_path / f"scan-{k}.{kind}"
        if kind == "xyz":
            np.savetxt(path, points)
        else:
            cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
            open3d.io.write_point_cloud(str(path), cloud)
        files.append(path)
    rows = [(*q, path.name) for q, path in zip(np.rad2deg(truth.joints), files)]
    table = write_rows(tmp_path / "poses.csv", [*(f"J{k}" for k in range(1, 7)), "scan"], rows)
    options = ImportOptions(robot="ur10", ball_radius_mm=15.0)
    made = import_recording([*files, table], tmp_path / "out", options)
    assert made.recording.measures == "ball-centre"
    assert np.abs(made.recording.points - truth.points).max() < 0.02


def test_propose_edit_and_repeat_with_a_mapping(truth, tmp_path, capsys):
    np.savetxt(
        tmp_path / "plain.csv", np.column_stack([degrees(truth), truth.points]), delimiter=","
    )
    mapping = tmp_path / "map.toml"
    joints = ", ".join(f'"column {k}"' for k in range(1, 7))
    mapping.write_text(
        f'measures = "external-point"\nrobot = "ur10"\n[joints]\ncolumns = [{joints}]\n'
        '[point]\ncolumns = ["column 7", "column 8", "column 9"]\n'
    )
    out = tmp_path / "out"
    answer = tmp_path / "a.json"
    command = ["import", str(tmp_path / "plain.csv"), "--map", str(mapping), "--out", str(out)]
    assert run([*command, "--json", str(answer)]) == 0
    result = json.loads(answer.read_text())
    assert (
        result["mapping"]["joints"]["unit"] == "deg" and result["mapping"]["point"]["unit"] == "mm"
    )
    assert result["conventions"][0]["rms_mm"] < 0.1 and result["questions"] == []
    again = read_mapping(out / "import.toml")
    assert again.joints.unit == "deg"
    repeat = ["import", str(tmp_path / "plain.csv"), "--map", str(out / "import.toml")]
    assert run([*repeat, "--out", str(tmp_path / "out2")]) == 0
    assert (tmp_path / "out2" / "samples.csv").read_text() == (out / "samples.csv").read_text()
    assert run([*repeat, "--propose", str(tmp_path / "p.toml")]) == 0
    assert read_mapping(tmp_path / "p.toml").point.columns[0] == "column 7"
    capsys.readouterr()


@pytest.mark.parametrize(
    ("header", "kind", "label", "unit"),
    [
        ("Achse 3 [°]", "joint", "3", "deg"),
        ("actual_q_0", "qindex", "0", None),
        ("shoulder_lift_joint [rad]", "joint", "2", "rad"),
        ("panda_joint7", "joint", "7", None),
        ("Tracker X (Zoll)", "xyz", "x", "in"),
        ("pos_z_mm", "xyz", "z", "mm"),
        ("Drehung um Y [gon]", "turn", "y", "gon"),
        ("pose.orientation.w", "turn", "w", None),
        ("R12", "matrix", "12", None),
        ("Temperatur [°C]", "temperature_c", "", "c"),
        ("Zeitstempel", "time", "", None),
        ("humidity", "", "", None),
    ],
)
def test_headers_are_understood(header, kind, label, unit):
    found = read_header(header)
    assert (found.kind, found.label, found.unit) == (kind, label, unit)
