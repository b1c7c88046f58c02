"""Import of tables as laboratories keep them: grouped headers, repeated points, time zones, a robot as a DH table."""

import json
from datetime import datetime, timedelta

import numpy as np
import pytest

from datasets.importers.sources import read_sources
from datasets.importers.sources.dh_tables import read_dh_table
from datasets.importers.sources.tables.text_tables import is_unit_row, with_group_names
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.jobs.robot.simulate import simulate
from workbench.recordings.importing import ImportOptions, import_recording

SCENE = """
robot = "abb_irb120"
measures = "external-point"
samples = 40
seed = 21
sigma_mm = 0.02
[base]
xyz_mm = [1900.0, 500.0, 300.0]
rpy_deg = [2.0, -1.0, 110.0]
[tool]
xyz_mm = [-20.0, 30.0, 90.0]
[errors]
length_mm = 0.2
angle_deg = 0.05
"""
IRB120 = ImportOptions(robot="abb_irb120")
JOINTS = [f"A{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    scene = tmp_path_factory.mktemp("scene") / "scene.toml"
    scene.write_text(SCENE)
    return simulate(scene)


def degrees(truth) -> np.ndarray:
    return np.rad2deg(truth.joints)


def calculated(truth) -> np.ndarray:
    """(n, 3) mm: the nominal flange, as a controller shows it."""
    robot = load_robot("abb_irb120")
    return forward(robot, robot.mixing @ truth.joints.T).end_origin.T


def write_table(path, *lines, separator=";"):
    texts = [
        separator.join(cell if isinstance(cell, str) else f"{cell:.9g}" for cell in line)
        for line in lines
    ]
    path.write_text("\n".join(texts) + "\n", encoding="utf-8")
    return path


def check(made, truth):
    assert np.abs(np.rad2deg(made.joints - truth.joints)).max() < 1e-5
    assert np.abs(made.points - truth.points).max() < 1e-3


# ---- headers ----


def test_merged_cells_tell_the_tracker_from_the_controller(truth, tmp_path):
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Calibration of cell 3"])
    sheet.append([])
    sheet.append(["Pose", "Robot cartesian", None, None, "Axes", *[None] * 5, "Laser tracker"])
    sheet.merge_cells("B3:D3")
    sheet.append([None, "X", "Y", "Z", *JOINTS, "X", "Y", "Z"])
    sheet.append([None, *["mm"] * 3, *["°"] * 6, *["mm"] * 3])
    rows = np.column_stack([calculated(truth), degrees(truth), truth.points])
    for number, row in enumerate(rows, 1):
        sheet.append([number, *row.tolist()])
    book.save(tmp_path / "cell.xlsx")
    made = import_recording([tmp_path / "cell.xlsx"], tmp_path / "out", IRB120)
    assert made.mapping.point.columns == ("Laser tracker X", "Laser tracker Y", "Laser tracker Z")
    check(made.recording, truth)


def test_two_points_under_the_same_names_are_a_question(truth, tmp_path):
    rows = np.column_stack([calculated(truth), degrees(truth), truth.points])
    path = write_table(tmp_path / "t.csv", ["X", "Y", "Z", *JOINTS, "X", "Y", "Z"], *rows)
    with pytest.raises(InputError, match=r"found X ... Z and X \(2\) ... Z \(2\).*--map"):
        import_recording([path], tmp_path / "out", IRB120)


def test_nominal_and_actual_groups_and_their_difference(truth, tmp_path):
    nominal = truth.points + 0.5
    groups = ["", "", "", "", "", "", "Soll", "", "", "Ist", "", "", "Abweichung", "", ""]
    header = [*JOINTS, *["X", "Y", "Z"] * 2, "dX", "dY", "dZ"]
    rows = np.column_stack([degrees(truth), nominal, truth.points, truth.points - nominal])
    path = write_table(tmp_path / "t.csv", groups, header, *rows)
    made = import_recording([path], tmp_path / "out", IRB120)
    assert made.mapping.point.columns == ("Ist X", "Ist Y", "Ist Z")
    check(made.recording, truth)


def test_a_row_of_units_may_hold_time_formats_and_dashes(truth, tmp_path):
    units = ["[-]", "[hh:mm:ss]", *["[°]"] * 6, *["[mm]"] * 3]
    rows = [
        [str(k), f"14:{k:02d}:00", *(f"{v:.6f}".replace(".", ",") for v in row)]
        for k, row in enumerate(np.column_stack([degrees(truth), truth.points]))
    ]
    path = write_table(tmp_path / "t.csv", ["Nr", "Zeit", *JOINTS, "X", "Y", "Z"], units, *rows)
    made = import_recording([path], tmp_path / "out", IRB120)
    check(made.recording, truth)
    assert made.recording.columns["time_s"][1] == 60.0


@pytest.mark.parametrize(
    ("cells", "is_units"),
    [
        (["[-]", "[hh:mm:ss]", "[mm]"], True),
        (["", "HH:MM:SS.fff", "deg", ""], True),
        (["m", "s", "note"], False),
        (["[first]", "[last]"], False),
    ],
)
def test_rows_of_units(cells, is_units):
    assert is_unit_row(cells) == is_units


def test_a_title_over_a_complete_header_names_no_group():
    assert with_group_names(["A1", "X"], ["Robot", "3"]) == ["A1", "X"]
    assert with_group_names(["", "X", "X"], ["Time", "a", ""]) == ["Time", "a X", "a X"]
    assert with_group_names(["", "X", "Y"], ["Time", "", "b"]) == ["Time", "X", "b Y"]


# ---- joining ----


def test_points_in_another_order_and_measured_twice_follow_their_names(truth, tmp_path):
    names = [f"P{k}" for k in range(truth.n)]
    joints = [(name, *row) for name, row in zip(names, degrees(truth))]
    order = np.random.default_rng(4).permutation(truth.n)
    order = np.concatenate(
        [order[2:], order[5:7]]
    )  # as many rows as joint readings, two names missing
    points = [(names[k], *truth.points[k]) for k in order]
    a = write_table(tmp_path / "robot.csv", ["Point", *JOINTS], *joints)
    b = write_table(tmp_path / "tracker.csv", ["Name", "X", "Y", "Z"], *points)
    made = import_recording([a, b], tmp_path / "out", IRB120)
    assert made.mapping.join.by == "key"
    check(made.recording, truth.select(order))
    assert any("2 of 40 rows have no row in tracker.csv" in said for said in made.warnings)


@pytest.mark.parametrize("hours", [2.0, -5.5])
def test_clocks_of_two_time_zones(hours, truth, tmp_path):
    start = datetime(2024, 3, 5, 11, 30)
    seconds = 5.0 * np.arange(truth.n)
    log = np.arange(-3.0, seconds[-1] + 3.0, 0.25)
    stand = np.clip(np.round((log - 0.1) / 5.0).astype(int), 0, truth.n - 1)
    a = [
        ((start + timedelta(seconds=t)).isoformat() + "Z", *degrees(truth)[k])
        for t, k in zip(log, stand)
    ]
    shifted = [start + timedelta(hours=hours, seconds=t) for t in seconds]
    b = [(t.strftime("%d.%m.%Y %H:%M:%S"), *p) for t, p in zip(shifted, truth.points)]
    files = [
        write_table(tmp_path / "robot.csv", ["timestamp", *JOINTS], *a),
        write_table(tmp_path / "tracker.csv", ["Zeit", "X", "Y", "Z"], *b),
    ]
    made = import_recording(files, tmp_path / "out", IRB120)
    check(made.recording, truth)
    assert any(f"differ by {-hours:g} h" in said for said in made.warnings)


# ---- reports with a line for each axis ----


def pcdmis(points) -> str:
    """A dimension report: nominal values are other numbers, and a line of tolerances stands between."""
    lines = ["PART NAME : cell 3", ""]
    for k, point in enumerate(points):
        lines += [
            f"DIM LOC{k + 1}= LOCATION OF POINT P{k:03d}  UNITS=IN",
            "AX    NOMINAL       +TOL       -TOL       MEAS        DEV     OUTTOL",
        ]
        for axis, value in zip("XYZ", point / 25.4):
            lines.append(
                f"{axis}  {round(value):9.4f}  0.0100  0.0100  {value:.7f}  0.0130  0.0030 ---#"
            )
        lines += ["END OF DIMENSION", ""]
    return "\n".join(lines)


def cam2(points) -> str:
    lines = ["CAM2 Measure", "Units: Millimeters", ""]
    for k, point in enumerate(points):
        lines.append(f"Point P{k:03d}")
        lines += [f"    {axis} {value:.5f}" for axis, value in zip("XYZ", point)]
    return "\n".join(lines)


@pytest.mark.parametrize("report", [pcdmis, cam2])
def test_reports_of_pcdmis_and_cam2(report, truth, tmp_path):
    (tmp_path / "report.txt").write_text(report(truth.points[::-1]))
    names = [f"P{k:03d}" for k in range(truth.n)]
    rows = [(name, *q) for name, q in zip(names[::-1], degrees(truth))]
    joints = write_table(tmp_path / "robot.csv", ["Point", *JOINTS], *rows)
    made = import_recording([joints, tmp_path / "report.txt"], tmp_path / "out", IRB120)
    assert made.mapping.join.by == "key"
    check(made.recording, truth)


def test_a_report_whose_measured_column_is_not_named_is_refused(tmp_path):
    block = "Point P1\nX 1.0 2.0\nY 1.0 2.0\nZ 1.0 2.0\n"
    (tmp_path / "r.txt").write_text(3 * block)
    with pytest.raises(InputError, match="r.txt, row 2: expected one number for each axis"):
        read_sources([tmp_path / "r.txt"], tmp_path)


# ---- never silently wrong ----


def test_points_that_the_controller_calculated_are_refused(truth, tmp_path):
    rows = np.round(np.column_stack([degrees(truth), calculated(truth)]), 3)
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *rows)
    with pytest.raises(InputError, match="equal the nominal kinematics"):
        import_recording([path], tmp_path / "out", IRB120)
    trusting = ImportOptions(robot="abb_irb120", trust_data=True)
    made = import_recording([path], tmp_path / "out", trusting)
    assert any("equal the nominal kinematics" in said for said in made.warnings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((1, 1, -1, 1, 1, 1, 1, 1, 1), "column 'A3' has the opposite sign"),
        ((1, 1, 1, 1, 1, 1, 1, -1, 1), "left-handed"),
    ],
)
def test_a_mistake_that_explains_a_misfit_is_named(change, words, truth, tmp_path):
    rows = np.column_stack([degrees(truth), truth.points]) * change
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *rows)
    with pytest.raises(InputError, match=words):
        import_recording([path], tmp_path / "out", IRB120)


def test_placeholders_and_error_cells_are_missing_measurements(truth, tmp_path):
    cells = [[f"{v:.9g}" for v in row] for row in np.column_stack([degrees(truth), truth.points])]
    cells[3][6:] = ["-9999"] * 3
    cells[8][6:] = ["0", "0", "0"]
    cells[11][7] = "#N/A"
    cells[17][2] = "#NV"
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *cells)
    made = import_recording([path], tmp_path / "out", IRB120)
    kept = np.setdiff1d(np.arange(truth.n), [3, 8, 11, 17])
    check(made.recording, truth.select(kept))
    assert any("4 rows" in said and "rows 5, 10, 13, 19" in said for said in made.warnings)


# ---- other containers ----


def test_units_inside_the_cells(truth, tmp_path):
    def cell(value, unit):
        return f"{value:.7f}".replace(".", ",") + unit

    rows = [
        [*(cell(v, "°") for v in q), *(cell(v, " mm") for v in p)]
        for q, p in zip(degrees(truth), truth.points)
    ]
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *rows)
    check(import_recording([path], tmp_path / "out", IRB120).recording, truth)


@pytest.mark.parametrize("form", ["records", "arrays", "parquet"])
def test_json_and_parquet(form, truth, tmp_path):
    import pandas

    path = tmp_path / ("t.parquet" if form == "parquet" else "t.json")
    if form == "records":
        rows = zip(truth.joints.tolist(), truth.points.tolist())
        path.write_text(json.dumps([{"id": "a", "joints": q, "point_mm": p} for q, p in rows]))
    elif form == "arrays":
        content = {"q": truth.joints.tolist(), "p": truth.points.tolist(), "operator": "N.N."}
        path.write_text(json.dumps(content))
    else:
        table = np.column_stack([truth.joints, truth.points])
        pandas.DataFrame(table, columns=[*JOINTS, "x", "y", "z"]).to_parquet(path)
    check(import_recording([path], tmp_path / "out", IRB120).recording, truth)


@pytest.mark.parametrize(
    ("name", "text"), [("t.json", "[{"), ("t.json", '[1, "a"]'), ("t.parquet", "no parquet")]
)
def test_broken_containers_are_refused(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        read_sources([tmp_path / name], tmp_path)


# ---- a robot as a Denavit-Hartenberg table ----


def dh_rows(factor: float, length: float):
    return [
        (k + 1, factor * theta, length * d, length * a, factor * alpha)
        for k, (theta, d, a, alpha, _) in enumerate(load_robot("abb_irb120").geometry)
    ]


@pytest.mark.parametrize(
    ("header", "factor", "length"),
    [
        (["joint", "theta [deg]", "d [mm]", "a [mm]", "alpha [deg]"], 180 / np.pi, 1.0),
        (["i", "offset", "d", "r", "alpha"], 1.0, 0.001),
        (["Achse", "theta_rad", "d_in", "a_in", "alpha_rad"], 1.0, 1 / 25.4),
    ],
)
def test_a_robot_from_a_table_without_convention(header, factor, length, truth, tmp_path):
    table = write_table(tmp_path / "arm.csv", header, *dh_rows(factor, length))
    rows = np.column_stack([degrees(truth), truth.points])
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *rows)
    made = import_recording([path], tmp_path / "out", ImportOptions(robot=str(table)))
    assert made.recording.robot["convention"] == "standard"
    check(made.recording, truth)
    nominal = load_robot("abb_irb120").geometry
    np.testing.assert_allclose(load_robot(made.recording.robot).geometry, nominal, atol=1e-4)


def test_a_table_of_an_arm_that_fits_in_no_convention_is_refused(truth, tmp_path):
    rows = [(a, b, 1.3 * c, 0.8 * d, e) for a, b, c, d, e in dh_rows(180 / np.pi, 1.0)]
    table = write_table(tmp_path / "arm.csv", ["joint", "theta", "d", "a", "alpha"], *rows)
    names = [*JOINTS, "X", "Y", "Z"]
    rows = np.column_stack([degrees(truth), truth.points])
    path = write_table(tmp_path / "t.csv", names, *rows)
    with pytest.raises(InputError, match="use the robot 'abb_irb120' of the library"):
        import_recording([path], tmp_path / "out", ImportOptions(robot=str(table)))
    rows = np.column_stack([degrees(truth), np.random.default_rng(4).permutation(truth.points)])
    path = write_table(tmp_path / "t.csv", names, *rows)
    with pytest.raises(InputError, match="found none.*convention modified.*no single mistake"):
        import_recording([path], tmp_path / "out", ImportOptions(robot=str(table)))


@pytest.mark.parametrize(
    "mistake",
    [
        "sign",
        pytest.param("milliradians", marks=pytest.mark.slow),
        pytest.param("swapped", marks=pytest.mark.slow),
        "left-handed",
    ],
)
def test_a_mistake_of_the_data_is_found_under_an_open_convention(mistake, truth, tmp_path):
    """The table states no convention, so that robot and mistake are searched for jointly."""
    table = write_table(
        tmp_path / "arm.csv",
        ["joint", "theta", "d", "a", "alpha"],
        *dh_rows(180 / np.pi, 1.0),
    )
    readings, points = degrees(truth), truth.points.copy()
    if mistake == "sign":
        readings[:, 2] *= -1
    elif mistake == "milliradians":
        readings *= 1000 * np.pi / 180
    elif mistake == "swapped":
        readings[:, [3, 4]] = readings[:, [4, 3]]
    else:
        points[:, 1] *= -1
    rows = np.column_stack([readings, points])
    path = write_table(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], *rows)
    expected = {
        "sign": "'A3'.*sign",
        "milliradians": "milliradians",
        "swapped": "'A4' and 'A5'.*(swapped|exchanged|interchanged)",
        "left-handed": "left-handed",
    }
    with pytest.raises(InputError, match=expected[mistake]) as refusal:
        import_recording([path], tmp_path / "out", ImportOptions(robot=str(table)))
    assert "fits under convention standard" in str(refusal.value)
    assert "t.csv" in str(refusal.value)


@pytest.mark.parametrize(
    "header",
    [
        ["i", "alpha i-1", "a i-1", "d", "theta"],
        ["link", "alpha_prev", "a_prev_mm", "d_mm", "theta_offset"],
    ],
)
def test_cells_with_joint_variables_and_fractions_of_pi(header, tmp_path):
    path = write_table(
        tmp_path / "modified.csv",
        header,
        ["1", "0", "0", "290", "q1"],
        ["2", "-pi/2", "0", "0", "q2 - pi/2"],
        ["3", "0", "270", "0", "q3"],
    )
    (keys,) = read_dh_table(path)
    assert keys["convention"] == "modified"
    assert [joint["alpha_deg"] for joint in keys["joint"]] == [0.0, -90.0, 0.0]
    assert [joint["theta_deg"] for joint in keys["joint"]] == [0.0, -90.0, 0.0]


@pytest.mark.parametrize(
    ("header", "row", "words"),
    [
        (["joint", "d", "a", "alpha"], ["1", "290", "0", "90"], "no column theta"),
        (["theta", "d", "a", "alpha"], ["0", "290", "0", "0.3"], "without a unit"),
        (["theta", "d", "a", "alpha"], ["zero", "290", "0", "90"], "row 2, column theta"),
        (["theta", "d", "a", "alpha"], ["0", "290", "", "90"], "no column a|row 2, column a"),
        (["theta", "d", "a", "alpha"], ["0", "290", "1e999", "90"], "row 2, column a"),
    ],
)
def test_tables_that_cannot_be_an_arm_are_refused(header, row, words, tmp_path):
    path = write_table(tmp_path / "arm.csv", header, row, row)
    with pytest.raises(InputError, match=words):
        read_dh_table(path)
