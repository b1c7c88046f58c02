"""Tables with a row for each axis of a point: empty columns, names that stand once, points that were not measured."""

import numpy as np
import pytest

from datasets.importers.sources.choice import read_sources
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.recordings.importing import import_recording

POINTS = np.array([[101.5, -20.25, 3.125], [99.0, 14.5, 7.0], [88.0, 1.5, -6.5], [1.0, 2.0, 3.5]])
TITLE = '"Inspection report" "12.4"'


def lines_of(points, row: str):
    """Lines in which `row` is filled with the name of the point, the axis and the value."""
    return [
        row.format(name=f"Bolt {k + 1}", axis=axis, value=f"{value:.10g}", once=name)
        for k, point in enumerate(points)
        for axis, value, name in zip("XYZ", point, (f"Bolt {k + 1}", "", ""))
    ]


def read(folder, lines):
    path = folder / "report.txt"
    path.write_text("\n".join(lines) + "\n")
    (table,) = read_sources([path], folder).tables
    return table


@pytest.mark.parametrize("separator", ["\t", ";", ",", "|"])
@pytest.mark.parametrize(
    "header, row",
    [
        ("Name,Control,Nominal,Measured,Dev", "{name},{axis},,{value},"),
        ("Name,Control,Nominal,Measured,Dev", "{name},{axis},,{value}"),
        ("Name,Control,Nominal,Measured,Dev", "{once},{axis},,{value},"),
        ("Name,Control,Nominal,Measured,Dev", "{name},{axis},0.5,{value},0.1"),
        ("Control,Name,Meas,Tol", "{axis},{once},{value},"),
    ],
)
def test_a_row_for_each_axis(tmp_path, separator, header, row):
    lines = [TITLE, header, *lines_of(POINTS, row)]
    table = read(tmp_path, [line.replace(",", separator) for line in lines])
    np.testing.assert_array_equal(np.stack([table.columns[a] for a in "XYZ"], axis=1), POINTS)
    assert table.columns["Name"].tolist() == [f"Bolt {k}" for k in range(1, 5)]


def test_rows_of_other_controls_are_left_out(tmp_path):
    lines = lines_of(POINTS, "{name}\t{axis}\t\t{value}\t")
    for place in (12, 9, 6, 3):
        lines.insert(place, "Bolt\t3D distance\t\t0.5\t")
    table = read(tmp_path, [TITLE, "Name\tControl\tNominal\tMeasured\tDev", *lines])
    np.testing.assert_array_equal(table.columns["Y"], POINTS[:, 1])


def test_a_point_that_was_not_measured_keeps_its_row(tmp_path):
    lines = lines_of(POINTS, "{name}\t{axis}\t\t{value}\t")
    lines[3:6] = [f"Bolt 2\t{axis}\t\t\t" for axis in "XYZ"]
    table = read(tmp_path, [TITLE, "Name\tControl\tNominal\tMeasured\tDev", *lines])
    assert np.isnan(table.columns["X"]).tolist() == [False, True, False, False]


def test_a_table_with_a_column_for_each_axis_is_none(tmp_path):
    table = read(tmp_path, ["Name;X;Y;Z;Axis", *(f"p{k};{k};2;3;X" for k in range(12))])
    assert list(table.columns) == ["Name", "X", "Y", "Z", "Axis"] and table.n == 12


def test_points_join_a_joint_log_by_their_names(tmp_path):
    """The report holds the points in another order; names of one kind and row numbers of the other join them."""
    truth = simulated(tmp_path, SCENE)
    order = np.random.default_rng(3).permutation(truth.n)
    report = ["Name\tControl\tNominal\tMeasured\tDev"]
    for k in order:
        report += [f"stop {k + 1}\t{a}\t\t{v:.10g}\t" for a, v in zip("XYZ", truth.points[k])]
    (tmp_path / "report.txt").write_text("\n".join(report) + "\n")
    numbers = np.arange(1, truth.n + 1)[:, None]
    header = ["nr", *(f"J{k}" for k in range(1, 7))]
    log = write_rows(tmp_path / "log.csv", header, np.column_stack([numbers, degrees(truth)]))
    made = import_recording([log, tmp_path / "report.txt"], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)
    assert made.mapping.join.by == "key"
