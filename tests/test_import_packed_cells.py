"""Cells with several numbers, such as "101 202 300": read as several values or asked about, never as one number."""

import numpy as np
import pytest

from datasets.importers.sources.choice import read_sources
from workbench.core.errors import InputError

ANGLES = "1,5;2,5;3,5;4,5;5,5;6,5"
JOINTS = ";".join(f"A{k} [deg]" for k in range(1, 7))


def read(folder, header, cells):
    """The table of six joint readings and one more column of `cells` with this header."""
    path = folder / "t.csv"
    path.write_text("\n".join([f"{JOINTS};{header}", *(f"{ANGLES};{cell}" for cell in cells)]))
    (table,) = read_sources([path], folder).tables
    return table


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("X Y Z", ["X", "Y", "Z"]),
        ("X Y Z [mm]", ["X [mm]", "Y [mm]", "Z [mm]"]),
        ("Position (x, y, z)", ["Position x", "Position y", "Position z"]),
        ("Punkt XYZ [mm]", ["Punkt X [mm]", "Punkt Y [mm]", "Punkt Z [mm]"]),
        ("Tracker X Y Z [mm]", ["Tracker X [mm]", "Tracker Y [mm]", "Tracker Z [mm]"]),
        ("Rx/Ry/Rz", ["Rx", "Ry", "Rz"]),
        ("Roll Pitch Yaw [deg]", ["Roll [deg]", "Pitch [deg]", "Yaw [deg]"]),
    ],
)
@pytest.mark.parametrize("cells", [["101 202 300", "111 212 310"], ["101,5 -20,25 3", "1 2 3"]])
def test_a_header_that_names_three_quantities_divides_the_cells(tmp_path, header, names, cells):
    table = read(tmp_path, header, cells)
    made = np.array([table.columns[name] for name in names])
    wanted = [[float(part.replace(",", ".")) for part in cell.split()] for cell in cells]
    np.testing.assert_allclose(made.T, wanted)
    assert header not in table.columns


def test_three_groups_in_every_row_are_asked_about(tmp_path):
    match = "column Z, row 2: expected one number, or a header .* 'X Y Z'"
    with pytest.raises(InputError, match=match):
        read(tmp_path, "Z", ["101 202 300", "111 212 310"])


def test_three_groups_of_an_unknown_column_stop_nothing(tmp_path):
    assert read(tmp_path, "Zaehlerstand", ["101 202 300", "111 212 310"]).n == 2


def test_groups_of_thousands_stay_one_number(tmp_path):
    table = read(tmp_path, "Z [mm]", ["1 234,5", "999,5", "12 345"])
    np.testing.assert_allclose(table.columns["Z [mm]"], [1234.5, 999.5, 12345])
    table = read(tmp_path, "Z [mm]", ["1 234 567", "999 500", "12 345"])
    np.testing.assert_allclose(table.columns["Z [mm]"], [1234567, 999500, 12345])


ONE_QUANTITY = [
    *("Point X [mm]", "Point X", "Time s", "Time t [ms]", "Temp T", "Torque [N m]", "Kraft [N m]"),
    *("Position X [mm]", "Tracker Z", "Probe X [mm]", "Theta X", "Marker R", "X [m s]"),
]


@pytest.mark.parametrize("header", ONE_QUANTITY)
def test_a_header_of_one_quantity_keeps_thousands_in_one_number(tmp_path, header):
    table = read(tmp_path, header, ["1 234,5", "1 567,25", "2 345"])
    np.testing.assert_allclose(table.columns[header], [1234.5, 1567.25, 2345])


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("q1 q2 q3 q4 q5 q6", [f"q{k}" for k in range(1, 7)]),
        ("X Y Z W P R", list("XYZWPR")),
        ("S L U R B T", list("SLURBT")),
        ("x y z qw qx qy", ["x", "y", "z", "qw", "qx", "qy"]),
    ],
)
def test_six_components_divide_the_cells(tmp_path, header, names):
    table = read(tmp_path, header, ["1 2 3 4 5 6", "6 5 4 3 2 1,5"])
    assert [table.columns[name][0] for name in names] == [1, 2, 3, 4, 5, 6]


def test_a_quaternion_in_one_cell(tmp_path):
    table = read(tmp_path, "W X Y Z", ["1 0 0 0", "0,8 0,6 0 0"])
    assert [table.columns[name][1] for name in "WXYZ"] == [0.8, 0.6, 0, 0]


@pytest.mark.parametrize("header", ["x y", "Roll Pitch", "Pixel (x, y)"])
def test_two_components_that_may_be_thousands_are_asked_about(tmp_path, header):
    with pytest.raises(InputError, match="row 2: .*or 2 numbers; .* each in a column of its own"):
        read(tmp_path, header, ["1 234,5", "1 567,25"])
    table = read(tmp_path, header, ["12 234,5", "1567 25"])
    assert header not in table.columns


def test_nine_digits_with_a_decimal_comma_are_asked_about(tmp_path):
    with pytest.raises(InputError, match="which may be one number .* or 3 numbers"):
        read(tmp_path, "Z [mm]", ["101 202 300,5", "111 212 310,5"])


def test_packed_cells_of_a_spreadsheet(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [["Nr", "A1 [deg]", "X Y Z"], [1, 2.5, "101 202 300"], [2, 3.5, "111 212 310"]]:
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    (table,) = read_sources([tmp_path / "t.xlsx"], tmp_path).tables
    assert [table.columns[name][1] for name in "XYZ"] == [111, 212, 310]
