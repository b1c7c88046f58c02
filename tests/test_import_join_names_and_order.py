"""Joins of tables: names of the columns of three files, and times of rows that are joined by their order."""

import numpy as np
import openpyxl
import pytest

from datasets.importers.mapping.joined_tables.joining import join_tables
from datasets.importers.mapping.model import Join
from datasets.importers.source import RawTable
from target_scenes import quaternions, target_scene
from workbench.recordings.importing import ImportOptions
from workbench.recordings.importing.sources.finding import find_mapping

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


def poses_of_two_tables():
    """Cells (n, 7) of flange poses and of target poses, position and quaternion."""
    flange, seen, _ = target_scene(1, count=20)
    return {
        name: np.c_[poses[:, :3, 3], quaternions(poses)]
        for name, poses in (("camera", seen), ("robot", flange))
    }


HEADERS = "x_mm,y_mm,z_mm,qx,qy,qz,qw"


def read_positions(found):
    """First coordinates that are read as those of the flange and of the target."""
    groups = found.mapping.flange_point, found.mapping.point
    return [found.table.columns[group.columns[0]] for group in groups]


def test_files_of_one_name_in_two_folders_are_two_sets(tmp_path):
    cells = poses_of_two_tables()
    paths = []
    for name in cells:
        paths.append(tmp_path / name / "poses.csv")
        paths[-1].parent.mkdir()
        np.savetxt(paths[-1], cells[name], delimiter=",", header=HEADERS, comments="")
    found = find_mapping(paths, ImportOptions(), tmp_path)
    for read, name in zip(read_positions(found), ("robot", "camera")):
        assert np.allclose(read, cells[name][:, 0])
    assert "robot/poses: x_mm" in found.table.columns


def test_sheets_of_a_workbook_are_two_sets(tmp_path):
    book = openpyxl.Workbook()
    book.remove(book.active)
    cells = poses_of_two_tables()
    for name, rows in cells.items():
        sheet = book.create_sheet(name)
        sheet.append(HEADERS.split(","))
        for row in rows.tolist():
            sheet.append(row)
    book.save(tmp_path / "book.xlsx")
    found = find_mapping([tmp_path / "book.xlsx"], ImportOptions(), tmp_path)
    for read, name in zip(read_positions(found), ("robot", "camera")):
        assert np.allclose(read, cells[name][:, 0])


def test_three_files_of_one_name_keep_all_columns(tmp_path):
    rng = np.random.default_rng(0)
    headers = {
        "arm": ",".join(f"q{k}_deg" for k in range(1, 7)) + ",x",
        "tracker": "x [mm],y [mm],z [mm],x",
        "sensor": "temperature_c,x",
    }
    paths = []
    for name, header in headers.items():
        paths.append(tmp_path / name / "data.csv")
        paths[-1].parent.mkdir()
        cells = rng.uniform(-90, 90, (20, len(header.split(","))))
        np.savetxt(paths[-1], cells, delimiter=",", header=header, comments="")
    found = find_mapping(paths, ImportOptions(robot="ur10"), tmp_path)
    assert {"arm/data: x", "tracker/data: x"} <= set(found.table.columns)
    assert found.mapping.point.columns == ("x [mm]", "y [mm]", "z [mm]")


def test_two_tables_of_each_session_share_a_column_in_all_sessions(tmp_path):
    """The folder of a session is no part of the names of its columns, which all sessions have."""
    rng = np.random.default_rng(0)
    headers = {"arm": ",".join(["note", *(f"q{k}_deg" for k in range(1, 7))])}
    headers["tracker"] = "note,x [mm],y [mm],z [mm]"
    paths = []
    for day in ("monday", "tuesday"):
        (tmp_path / day).mkdir()
        for name, header in headers.items():
            paths.append(tmp_path / day / f"{name}.csv")
            cells = rng.uniform(-90, 90, (20, len(header.split(","))))
            np.savetxt(paths[-1], cells, delimiter=",", header=header, comments="")
    found = find_mapping(paths, ImportOptions(robot="ur10"), tmp_path)
    assert found.table.n == 40
    assert {"arm: note", "tracker: note"} <= set(found.table.columns)
