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


def test_packed_cells_of_a_spreadsheet(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [["Nr", "A1 [deg]", "X Y Z"], [1, 2.5, "101 202 300"], [2, 3.5, "111 212 310"]]:
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    (table,) = read_sources([tmp_path / "t.xlsx"], tmp_path).tables
    assert [table.columns[name][1] for name in "XYZ"] == [111, 212, 310]
