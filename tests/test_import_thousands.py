"""Separators of thousands that are also separators of cells."""

import numpy as np
import pytest

from datasets.importers.sources.tables.text_tables import read_text_table

VALUES = np.array([[2968.41, 275.975], [2404.024, 1123.778], [3257.54, 489.285], [812.3, 697.035]])


@pytest.mark.parametrize("separator", ["\t", ";", "|"])
@pytest.mark.parametrize("large", [1, 2, 3, 4])
def test_spaces_of_thousands_do_not_divide_cells(separator, large, tmp_path):
    """Most lines have equally many spaces, which would give more columns than the separator."""
    rows = [VALUES[1] if k % 25 < large else VALUES[0] for k in range(40)]
    lines = [separator.join(["Nr", "X", "Y", "Z"]), separator.join(["", "mm", "mm", "mm"])]
    for k, row in enumerate(rows):
        cells = [f"{value:,.3f}".replace(",", " ") for value in (*row, 5000.0 + k)]
        lines.append(separator.join([str(k + 1), *cells]))
    path = tmp_path / "points.txt"
    path.write_text("\n".join([*lines, ""]))
    table = read_text_table(path)
    assert list(table.columns) == ["Nr", "X", "Y", "Z"]
    np.testing.assert_allclose(table.columns["X"], [row[0] for row in rows])
    np.testing.assert_allclose(table.columns["Z"], 5000.0 + np.arange(40))
