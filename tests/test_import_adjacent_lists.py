"""Lists in brackets that stand next to one another, as controllers print positions, and rows that end in a semicolon."""

import pytest

from datasets.importers.sources.tables.cells import split_cells
from datasets.importers.sources.tables.text_tables import read_text_table


@pytest.mark.parametrize("separator", [",", ";", " ", "\t"])
def test_a_place_between_two_lists_divides_them(separator):
    cells = split_cells("7[1.5,-2,3][0.1, 0.2, 0.3, 0.4]\n", separator)
    assert cells == ["7", "[1.5,-2,3]", "[0.1, 0.2, 0.3, 0.4]"]


def test_brackets_of_headers_stay_in_their_cell():
    assert split_cells("Position (x)(y),Time [s]", ",") == ["Position (x)(y)", "Time [s]"]


def test_a_table_of_lists(tmp_path):
    lines = [f"{k}[{k}.5,{k + 2},3][{k}, 0.25, 0.75, 1]({2 * k}; 4)" for k in range(1, 9)]
    (tmp_path / "t.txt").write_text("\n".join(lines))
    table = read_text_table(tmp_path / "t.txt")
    assert table.n == 8 and len(table.columns) == 1 + 3 + 4 + 2
    assert [cells[1] for cells in table.columns.values()] == [2, 2.5, 4, 3, 2, 0.25, 0.75, 1, 4, 4]


def test_a_semicolon_at_the_end_of_the_row_is_no_part_of_a_number(tmp_path):
    (tmp_path / "t.txt").write_text("".join(f"{k}.5, {2 * k}, -{k}.25;\n" for k in range(1, 6)))
    columns = list(read_text_table(tmp_path / "t.txt").columns.values())
    assert columns[2].tolist() == [-1.25, -2.25, -3.25, -4.25, -5.25]
