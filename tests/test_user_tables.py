"""Tables of targets and points that a user names: the same forms as those of the import, and never a silent guess."""

from types import SimpleNamespace

import numpy as np
import pytest

from robot_model import load_robot
from scenes import SLIDING
from workbench.core.errors import InputError
from workbench.files.points import read_points
from workbench.files.targets import as_csv, corrected_columns, read_programme

ROBOT = load_robot({"builtin": "ur10"}, "test")
READINGS = [[10.5, -90, 20, -5, 30.25, 1], [11, -80, 25, -6, 31.5, 2]]
NATIVE = [f"q{k}_deg" for k in range(1, 7)]
STATED = [f"A{k} [deg]" for k in range(1, 7)]
OPEN = [f"A{k}" for k in range(1, 7)]


def table(folder, header, rows, separator=";", comma=True, name="targets.csv"):
    cells = [[f"{value:g}".replace(".", "," if comma else ".") for value in row] for row in rows]
    lines = [separator.join(row) for row in [header, *cells]]
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("header", [NATIVE, STATED])
@pytest.mark.parametrize(
    ("separator", "comma"), [(";", True), ("\t", True), (";", False), (",", False)]
)
def test_separators_and_decimal_signs_of_targets(tmp_path, header, separator, comma):
    path = table(tmp_path, header, READINGS, separator, comma)
    found = read_programme(path, ROBOT)
    np.testing.assert_allclose(found.readings, np.deg2rad(READINGS))
    assert found.poses is None and found.table.rows.tolist() == [2, 3]


def test_other_columns_of_targets_are_kept(tmp_path):
    path = table(tmp_path, [*NATIVE, "payload_kg"], [[*row, 2.5] for row in READINGS])
    text = path.read_text().splitlines()
    lines = [f"{text[0]};Name", f"{text[1]};P1", f"{text[2]};P2"]
    path.write_text("\n".join(lines))
    found = read_programme(path, ROBOT)
    assert found.covariates["payload_kg"].tolist() == [2.5, 2.5]
    assert found.table.columns["Name"].tolist() == ["P1", "P2"]


def test_quoted_decimal_commas_of_our_own_columns(tmp_path):
    path = tmp_path / "t.csv"
    rows = [",".join(f'"{value}"'.replace(".", ",") for value in row) for row in READINGS]
    path.write_text("\n".join([",".join(NATIVE), *rows]))
    np.testing.assert_allclose(read_programme(path, ROBOT).readings, np.deg2rad(READINGS))


def test_an_excel_table_of_targets(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [STATED, *READINGS]:
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    found = read_programme(tmp_path / "t.xlsx", ROBOT)
    np.testing.assert_allclose(found.readings, np.deg2rad(READINGS))


@pytest.mark.parametrize(("separator", "comma"), [(";", True), (",", False)])
def test_poses_in_metres(tmp_path, separator, comma):
    header = ["X [m]", "Y [m]", "Z [m]", "qw", "qx", "qy", "qz"]
    rows = [[0.5, 0.25, 0.3, 1, 0, 0, 0], [0.6, 0.2, 0.3, 0, 1, 0, 0]]
    path = table(tmp_path, header, rows, separator, comma)
    found = read_programme(path, ROBOT)
    np.testing.assert_allclose(found.poses[:, :3, 3], [[500, 250, 300], [600, 200, 300]])
    np.testing.assert_allclose(found.poses[1, :3, :3], np.diag([1, -1, -1]), atol=1e-12)
    assert found.anywhere


def test_a_unit_that_nothing_states_is_asked_for(tmp_path):
    path = table(tmp_path, OPEN, READINGS)
    with pytest.raises(InputError, match=r'A1, .*expected a unit.*\[joints\] columns = \["A1"'):
        read_programme(path, ROBOT)
    mapping = tmp_path / "map.toml"
    mapping.write_text(f'format = "import/1"\n[joints]\ncolumns = {OPEN}\nunit = "gon"\n')
    found = read_programme(path, ROBOT, mapping)
    np.testing.assert_allclose(found.readings, np.deg2rad(0.9 * np.array(READINGS)))


def test_a_rotation_convention_that_nothing_states_is_asked_for(tmp_path):
    header = ["X [mm]", "Y [mm]", "Z [mm]", "A", "B", "C"]
    path = table(tmp_path, header, [[500, 200, 300, 10, 20, 30], [500, 210, 300, 10, 20, 35]])
    with pytest.raises(InputError, match="expected rotations whose convention is stated"):
        read_programme(path, ROBOT)
    mapping = tmp_path / "map.toml"
    group = 'columns = ["A", "B", "C"]\nunit = "deg"\nconvention = "intrinsic ZYX"'
    mapping.write_text(f'format = "import/1"\n[flange_rotation]\n{group}\n')
    found = read_programme(path, ROBOT, mapping)
    from scipy.spatial.transform import Rotation

    wanted = Rotation.from_euler("ZYX", [10, 20, 30], degrees=True).as_matrix()
    np.testing.assert_allclose(found.poses[0, :3, :3], wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "q1_deg;q2_deg;q3_deg\n1,5;2;x\n2;3;4\n3;4;5\n",
            "row 2, column q3_deg: expected a number",
        ),
        ("q1_deg;q2_deg;q3_deg\n1,5;2;3\n2;3;4\n", "6 columns of joint readings"),
        ("q1_deg;q1_deg;q3_deg\n1,5;2;3\n2;3;4\n", "column q1_deg: expected every column once"),
        ("foo;bar\n1,5;2\n2;3\n", "not recognised: foo, bar"),
        (";".join(NATIVE) + "\n1;2;3;4;5;6\n1;2;;4;5;6\n", "row 3, column q3_deg: expected a fin"),
        (";".join(NATIVE) + "\n1;2;3;4;5;6\n1;2;3\n", "row"),
    ],
)
def test_wrong_tables_of_targets_are_a_sentence(tmp_path, text, message):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_programme(path, ROBOT)


def test_points_of_a_registration(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("Punkt;X [m];Y [m];Z [m]\nA;1,5;2;3\nB;2,5;2;3\n")
    names, points = read_points(path)
    assert names == ["A", "B"]
    np.testing.assert_allclose(points, [[1500, 2000, 3000], [2500, 2000, 3000]])
    path.write_text("X;Y;Z\n1,5;2;3\n2,5;2;3\n")
    with pytest.raises(InputError, match=r'as in "X \[mm\]", or add --unit'):
        read_points(path)


SLIDES = load_robot(SLIDING, "test")  # joints 2 and 4 slide
TWO_ROWS = "\n10;100;20;120;30;40\n11;115;21;125;31;41,5\n"


def slide_table(folder, second, first="deg"):
    units = [first, second, first, second, first, first]
    names = [f"A{k} [{unit}]" if unit else f"A{k}" for k, unit in enumerate(units, 1)]
    path = folder / "t.csv"
    path.write_text(";".join(names) + TWO_ROWS)
    return path


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1), ("m", 1000), ("in", 25.4)])
def test_lengths_of_slides(tmp_path, unit, factor):
    readings = read_programme(slide_table(tmp_path, unit), SLIDES).readings
    np.testing.assert_allclose(readings[:, [1, 3]], factor * np.array([[100, 120], [115, 125]]))


def test_a_slide_in_degrees_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"A2 \[deg\]: expected a unit of length, .*found deg"):
        read_programme(slide_table(tmp_path, "deg"), SLIDES)
    path = tmp_path / "native.csv"
    path.write_text(",".join(NATIVE) + "\n10,100,20,120,30,40\n")
    with pytest.raises(InputError, match="column q2_deg: expected mm, since this joint slides"):
        read_programme(path, SLIDES)


def test_a_rotary_joint_in_millimetres_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"A1 \[mm\]: expected a unit of angle, .*found mm"):
        read_programme(slide_table(tmp_path, "mm", "mm"), ROBOT)


def test_slides_without_a_unit_are_asked_for_a_length(tmp_path):
    toml = r'unit = \["deg", "mm", "deg", "mm", "deg", "deg"\]'
    match = rf"columns A2, A4: expected a unit, .*\(mm, m, in, cm\).*A2 \[mm\].*{toml}"
    with pytest.raises(InputError, match=match):
        read_programme(slide_table(tmp_path, ""), SLIDES)
    with pytest.raises(InputError, match=r"\(deg, rad, gon; mm, m, in, cm\)"):
        read_programme(slide_table(tmp_path, "", ""), SLIDES)
    columns = [f"A{k}" for k in range(1, 7)]
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        f'format = "import/1"\n[joints]\ncolumns = {columns}\nunit = ["deg","m","deg","m","deg","deg"]\n'
    )
    readings = read_programme(slide_table(tmp_path, "", ""), SLIDES, mapping).readings
    np.testing.assert_allclose(readings[0, [1, 3]], [100_000, 120_000])


def test_a_mapping_with_a_column_that_the_targets_do_not_have_is_refused(tmp_path):
    names = [f"A{k}" for k in range(1, 7)]
    (tmp_path / "t.csv").write_text("A1,A2,A3,B4,A5,A6\n1,2,3,4,5,6\n2,3,4,5,6,7\n")
    mapping = tmp_path / "map.toml"
    mapping.write_text(f'format = "import/1"\n[joints]\ncolumns = {names}\nunit = "deg"\n')
    with pytest.raises(InputError, match=r"--map, key joints.columns: .* found A4, which is not"):
        read_programme(tmp_path / "t.csv", load_robot("ur10"), mapping)


def test_the_mapping_of_a_measurement_reads_targets_without_the_point(tmp_path):
    names = [f"A{k}" for k in range(1, 7)]
    (tmp_path / "t.csv").write_text("A1,A2,A3,A4,A5,A6\n1,2,3,4,5,6\n2,3,4,5,6,7\n")
    mapping = tmp_path / "map.toml"
    point = '[point]\ncolumns = ["X", "Y", "Z"]\nunit = "mm"\n'
    joints = f'[joints]\ncolumns = {names}\nunit = "deg"\n'
    mapping.write_text(f'format = "import/1"\n{joints}{point}')
    programme = read_programme(tmp_path / "t.csv", load_robot("ur10"), mapping)
    assert np.allclose(np.rad2deg(programme.readings[1]), [2, 3, 4, 5, 6, 7])


def corrected(path, mapping=None):
    """Columns of corrected.csv where every reading is corrected by 1 deg."""
    programme = read_programme(path, ROBOT, mapping)
    count = len(programme.readings)
    found = SimpleNamespace(
        readings=programme.readings + np.deg2rad(1.0),
        reached=np.ones(count, bool),
        **{name: np.zeros(count) for name in RESULTS},
    )
    return corrected_columns(programme, ROBOT, found)


RESULTS = (
    "correction_mm",
    "left_mm",
    "position_left_mm",
    "rotation_left_deg",
    "sigma_mm",
    "uncertainty_mm",
    "expanded_uncertainty_mm",
)


def test_corrected_targets_keep_the_columns_and_units_of_the_user(tmp_path):
    header = ["Nr", *(f"Achse {k} [gon]" for k in range(1, 7)), "Last [lb]"]
    path = table(tmp_path, header, [[k, *row, 2] for k, row in enumerate(READINGS, 1)])
    made = corrected(path)
    assert list(made)[:8] == header
    np.testing.assert_allclose(made["Achse 3 [gon]"], [20 + 1 / 0.9, 25 + 1 / 0.9])
    assert made["Last [lb]"].tolist() == [2, 2] and "q1_deg" not in made


def test_a_row_of_units_goes_into_the_headers_of_corrected_targets(tmp_path):
    path = tmp_path / "t.csv"
    rows = [",".join(f"{value}" for value in row) for row in READINGS]
    path.write_text("\n".join([",".join(OPEN), ",".join(["gon"] * 6), *rows]))
    made = corrected(path)
    assert list(made)[:6] == [f"A{k} [gon]" for k in range(1, 7)]
    np.testing.assert_allclose(made["A1 [gon]"], [10.5 + 1 / 0.9, 11 + 1 / 0.9])
    written = tmp_path / "again.csv"
    written.write_text(as_csv(made))
    again = read_programme(written, ROBOT)
    np.testing.assert_allclose(again.readings[:, 0], np.deg2rad([10.45, 10.9]), rtol=1e-8)


def test_corrected_poses_get_readings_in_degrees(tmp_path):
    header = ["X [m]", "Y [m]", "Z [m]", "qw", "qx", "qy", "qz"]
    path = table(tmp_path, header, [[0.5, 0.25, 0.3, 1, 0, 0, 0]])
    made = corrected(path)
    assert list(made)[:13] == [*header, *NATIVE] and made["X [m]"].tolist() == [0.5]
