"""Rows of a spreadsheet that are no samples: statistics below the table, and remarks. They are named and left out."""

import numpy as np
import pytest

from datasets.importers.source import RawTable
from datasets.importers.sources.tables.excel import read_excel
from datasets.importers.sources.tables.summary_rows import without_summary_rows

openpyxl = pytest.importorskip("openpyxl")
NAMES = ("Nr", "J1", "J2", "X", "Y", "Z")


@pytest.fixture
def cells():
    values = np.random.default_rng(12).uniform(-900, 900, (30, 5)).round(3)
    return np.column_stack([np.arange(1.0, 31), values])


def book(path, cells, footer, remark=()):
    made = openpyxl.Workbook()
    sheet = made.active
    sheet.append(NAMES)
    for k, row in enumerate(cells.tolist()):
        sheet.append(row)
        if k == 9 and remark:
            sheet.append(remark)
    for row in [[], *footer]:
        sheet.append(row)
    made.save(path)
    (table,) = read_excel(path)
    return without_summary_rows(table)


@pytest.mark.parametrize("label", ["Mittelwert", None, 31.0])
def test_means_and_extremes_are_left_out(cells, label, tmp_path):
    rows = [cells.mean(0), cells.max(0), cells.std(0, ddof=1)]
    table = book(tmp_path / "t.xlsx", cells, [[label, *row[1:].round(3).tolist()] for row in rows])
    assert table.n == 30 and all(column.dtype.kind == "f" for column in table.columns.values())
    (sentence,) = table.warnings
    assert "is the mean, 34" in sentence and "34" in sentence and "left out" in sentence


def test_a_sum_of_one_column_is_left_out(cells, tmp_path):
    total = ["Summe", None, None, float(cells[:, 3].sum()), None, None]
    table = book(tmp_path / "t.xlsx", cells, [total])
    assert table.n == 30 and "('Summe') is the sum" in table.warnings[0]


def test_rows_of_text_are_named(cells, tmp_path):
    table = book(tmp_path / "t.xlsx", cells, [["checked by Huber"]], ["pause of 10 min"])
    assert table.n == 30
    assert (
        "rows 12 ('pause of 10 min'), 34 ('checked by Huber') hold no number" in table.warnings[0]
    )


def test_samples_at_the_end_stay(cells):
    def table(rows):
        return RawTable("t.csv", dict(zip(NAMES, rows.T)), np.arange(len(rows)))

    assert without_summary_rows(table(cells)).n == 30
    sweep = np.sort(cells, axis=0)
    rest = np.vstack([sweep, sweep[-1:]])  # a sweep that has come to rest
    assert without_summary_rows(table(rest)).n == 31
