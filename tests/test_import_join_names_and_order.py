"""Joins of tables: names of the columns of three files, and times of rows that are joined by their order."""

import numpy as np
import pytest

from datasets.importers.mapping.joined_tables.joining import join_tables
from datasets.importers.mapping.model import Join
from datasets.importers.source import RawTable

ROWS = 8
TIMES = 1.7e9 + 20.0 * np.arange(ROWS)


def table(file, **columns):
    return RawTable(
        file,
        {name: np.asarray(cells, float) for name, cells in columns.items()},
        np.arange(1, ROWS + 1),
    )


def test_columns_of_three_files_have_the_name_of_their_own_file():
    cells = np.arange(ROWS) * 1.5
    tables = [table(f"{name}.csv", X=cells, Y=cells + 1) for name in ("first", "second")]
    joined, _, _ = join_tables([*tables, table("third.csv", Y=cells, Z=cells)], Join("index"))
    names = ["first: X", "first: Y", "second: X", "second: Y", "third: Y", "Z"]
    assert list(joined.columns) == names
    assert list(joined.columns["third: Y"]) == list(cells)


def test_three_files_without_headers():
    cells = {"column 1": np.arange(ROWS) * 2.5}
    wide = {**cells, "column 2": cells["column 1"]}
    tables = [table("a.txt", **cells), table("b.txt", **cells), table("c.txt", **wide)]
    joined, _, _ = join_tables(tables, Join("index"))
    assert list(joined.columns) == ["a: column 1", "b: column 1", "c: column 1", "c: column 2"]


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (TIMES + 1.5, ""),
        (TIMES - 1.6e9, ""),  # a clock that counts from its own start
        (TIMES + 3600.0 + 0.7, "differ by 1 h, which is taken for a time zone"),
        (TIMES[::-1], 'write [join] by = "time"'),
        (np.r_[TIMES[1:], TIMES[0]], "in 1 of 8 rows"),
    ],
)
def test_times_of_rows_that_are_joined_by_their_order(times, words):
    robot = table("robot.csv", time=TIMES, A1=np.arange(ROWS) * 3.5)
    tracker = table("tracker.csv", time=times, X=np.arange(ROWS) * 4.5)
    joined, used, sentences = join_tables([robot, tracker], Join())
    assert used.by == "index" and joined.n == ROWS
    assert len(sentences) == bool(words) and words in " ".join(sentences)
    assert join_tables([robot, tracker], Join("index"))[2] == ()
