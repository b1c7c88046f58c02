"""Cells of text among the joint readings are named, as the dates that a spreadsheet makes of numbers."""

import numpy as np
import pytest

from import_scenes import UR10, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

NAMES = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("01.Mar", "a spreadsheet makes dates of numbers such as 1.3"),
        ("n/a?", "found 'n/a?'; 2 cells"),
    ],
)
def test_the_first_cell_of_text_is_named(tmp_path, text, words):
    rows = np.random.default_rng(1).uniform(-90, 90, (30, 9)).round(2).tolist()
    rows[3][2] = rows[7][4] = text
    table = write_rows(tmp_path / "log.csv", NAMES, rows)
    with pytest.raises(InputError) as refused:
        import_recording([table], tmp_path / "made", UR10)
    assert f"log.csv, row 5, column J3: expected a number as in most rows, found '{text}'" in str(
        refused.value
    )
    assert words in str(refused.value)
    assert "2 cells of columns J3, J5 are text" in str(refused.value)
