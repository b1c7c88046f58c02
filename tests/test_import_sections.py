"""Two lists of different width in one text file: poses of a robot, and below them points of an instrument."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources import read_sources
from workbench.recordings.importing import ImportOptions
from workbench.recordings.importing.sources.finding import find_mapping

ROWS = 12


def lists():
    """Lines of poses and of points of a reflector on the flange, as a controller and an instrument print them."""
    rng = np.random.default_rng(9)
    turned = Rotation.from_rotvec(rng.normal(size=(ROWS, 3)) * 0.5 + [np.pi, 0, 0])
    flange = rng.uniform([500, -700, 300], [1300, 700, 1100], (ROWS, 3))
    base = Rotation.from_euler("xyz", [2, -3, 71], degrees=True)
    points = base.apply(flange + turned.apply([104.0, -30, 215])) + [1200.0, 300, 40]
    poses = [
        f"Print{k}=[{p[0]:.2f},{p[1]:.2f},{p[2]:.2f}],[{','.join(f'{v:.6f}' for v in q)}]"
        for k, (p, q) in enumerate(zip(flange, turned.as_quat(scalar_first=True)), 1)
    ]
    return poses, [f"P{k}=[{','.join(f'{v:.5f}' for v in p)}]" for k, p in enumerate(points, 1)]


def written(folder, *blocks):
    path = folder / "Data.txt"
    path.write_text("\n".join(line for block in blocks for line in block) + "\n")
    return path


def test_the_list_below_is_a_table_of_its_own(tmp_path):
    poses, points = lists()
    errors = [f"[{k * 0.01:.4f} 0.2 0.3 0.]" for k in range(ROWS)]
    head = ["*** Calibration off-line ***", "started: 2023-04-18 17:42", "", "Robot input:", ""]
    blocks = (
        head,
        poses,
        ["", "Calibration input:", "", *points, ""],
        ["Errors (X, Y, Z, R):", *errors],
    )
    path = written(tmp_path, *blocks)
    found = find_mapping([path], ImportOptions(), tmp_path)
    assert found.table.n == ROWS and found.mapping.flange_rotation is not None
    seen = found.table.columns[found.mapping.point.columns[0]]
    assert np.allclose(seen, [float(line.split("[")[1].split(",")[0]) for line in points])
    assert any("the lines after row 32" in text for text in found.warnings)
    tables = read_sources([path], tmp_path).tables
    assert [table.lines[0] for table in tables] == [6, 21]


@pytest.mark.parametrize("gap", [[], [""]])
def test_the_list_above_a_wider_one_is_a_table_of_its_own(gap, tmp_path):
    poses, points = lists()
    path = written(tmp_path, ["Points:", *points], gap, ["Robot input:", *poses])
    first, second = read_sources([path], tmp_path).tables
    assert (first.file, second.file) == ("Data (1).txt", "Data (2).txt")
    assert (first.lines[0], second.lines[0]) == (2, ROWS + 3 + len(gap))
    found = find_mapping([path], ImportOptions(), tmp_path)
    assert found.table.n == ROWS and found.mapping.flange_rotation is not None
    seen = found.table.columns[found.mapping.point.columns[0]]
    assert np.allclose(seen, [float(line.split("[")[1].split(",")[0]) for line in points])


def test_lines_of_settings_above_a_table_are_no_table(tmp_path):
    poses, _ = lists()
    path = written(tmp_path, [f"# setting {k}: {k}.5" for k in range(ROWS)], [""], poses)
    (table,) = read_sources([path], tmp_path).tables
    assert table.n == ROWS and table.lines[0] == ROWS + 2


def test_a_summary_or_fewer_rows_are_no_second_table(tmp_path):
    poses, points = lists()
    path = written(tmp_path, poses, ["", "Result:", *points[:4]])
    (table,) = read_sources([path], tmp_path).tables
    assert table.n == ROWS and "after the table are not read" in table.warnings[0]


def test_blocks_of_lines_with_labels_of_any_script(tmp_path):
    """A program prints each pose in several lines, with a title and the number of poses above them."""
    lines = ["TCP 雷射校正數據", "=" * 40, "測量點數量: 4", ""]
    for k in range(4):
        lines += [
            f"測量點 {k + 1}: 姿態 - 傾斜45度",
            f"  法蘭座標: [{k}.5, -2, 3, 179.9, 0.1, {k}]",
        ]
        lines += [f"  關節角度: [{k}.25, 2, 3, 4, 5, 6]", "  雷射狀態: X=True, Y=True", ""]
    path = tmp_path / "tcp.txt"
    path.write_text("\n".join(lines), encoding="utf-8")
    (table,) = read_sources([path], tmp_path).tables
    assert table.n == 4 and list(table.columns["法蘭座標 1"]) == [0.5, 1.5, 2.5, 3.5]
    assert list(table.columns["關節角度 1"]) == [0.25, 1.25, 2.25, 3.25] and not table.warnings
