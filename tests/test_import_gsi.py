"""GSI files of Leica instruments, in which each word of a line is a quantity with its unit."""

import numpy as np
import pytest

from datasets.importers.sources.geodetic_words import is_gsi, read_gsi
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording


def word(code: int, unit: int, count: float, digits: int) -> str:
    return f"{code}..0{unit}{'-' if count < 0 else '+'}{abs(round(count)):0{digits}d}"


def line(number: int, words, digits: int) -> str:
    star = "*" if digits == 16 else ""
    return f"{star}11{number:04d}+{f'P{number}':0>{digits}} {' '.join(words)} \n"


@pytest.mark.parametrize("digits, unit, mm", [(8, 0, 1.0), (8, 6, 0.1), (16, 8, 0.01)])
def test_coordinates_in_the_units_of_their_words(tmp_path, digits, unit, mm):
    points = np.array([[1234.56, -98.7, 3.0], [-2500.0, 410.26, -1.5]])
    text = (
        f"{'*' if digits == 16 else ''}110001+{'ST1':0>{digits}} {word(88, unit, 1500, digits)}\n"
    )
    for number, point in enumerate(points, 2):
        words = [word(81 + k, unit, v / mm, digits) for k, v in enumerate(point)]
        text += line(number, words, digits)
    path = tmp_path / "points.gsi"
    path.write_text(text)
    assert is_gsi(path)
    (table,) = read_gsi(path)
    found = np.stack([table.columns[name] for name in "XYZ"], 1)
    assert np.abs(found - points).max() <= 0.51 * mm
    assert table.units == {"X": "mm", "Y": "mm", "Z": "mm"}
    assert table.columns["Point"].tolist() == ["P2", "P3"]
    assert table.lines.tolist() == [2, 3]


@pytest.mark.parametrize(
    "unit, count, angle", [(2, 12345678, 111.111102), (3, 12345678, 123.45678), (4, 1230360, 12.51)]
)
def test_angles_in_gon_degrees_and_minutes(tmp_path, unit, count, angle):
    words = [word(21, unit, count, 8), word(22, unit, count, 8), word(31, 0, 2500, 8)]
    path = tmp_path / "points.txt"
    path.write_text(line(1, words, 8))
    (table,) = read_gsi(path)
    assert table.columns["Azimuth"][0] == pytest.approx(angle, abs=1e-9)
    assert table.columns["Zenith"][0] == pytest.approx(angle, abs=1e-9)
    assert table.columns["Distance"][0] == 2500.0


def test_an_unknown_unit_is_named_with_its_line(tmp_path):
    path = tmp_path / "points.gsi"
    path.write_text(line(1, [word(81, 5, 1, 8), word(82, 0, 1, 8), word(83, 0, 1, 8)], 8))
    with pytest.raises(InputError, match=r"points.gsi, line 1.*81\.\.05"):
        read_gsi(path)


def test_lines_of_stations_alone_are_refused(tmp_path):
    path = tmp_path / "points.gsi"
    path.write_text(line(1, [word(88, 0, 1500, 8)], 8))
    with pytest.raises(InputError, match="81, 82 and 83"):
        read_gsi(path)


def test_other_text_is_no_gsi(tmp_path):
    path = tmp_path / "points.txt"
    path.write_text("110001 12.5 13.5 14.5\n")
    assert not is_gsi(path)


@pytest.mark.parametrize("is_polar", [False, True])
def test_points_of_a_gsi_file_and_joints_of_a_table(tmp_path, is_polar):
    truth = simulated(tmp_path, SCENE)
    x, y, z = truth.points.T
    if is_polar:
        azimuth = np.rad2deg(np.arctan2(x, y)) % 360  # clockwise from north
        zenith = np.rad2deg(np.arctan2(np.hypot(x, y), z))
        distance = np.linalg.norm(truth.points, axis=1)
        counts = [(21, 3, azimuth * 1e5), (22, 3, zenith * 1e5), (31, 8, distance * 100)]
    else:
        counts = [(81 + k, 8, 100 * cells) for k, cells in enumerate((x, y, z))]
    rows = [
        [word(code, unit, cells[k], 16) for code, unit, cells in counts] for k in range(truth.n)
    ]
    points = tmp_path / "tracker.gsi"
    points.write_text("".join(line(k, words, 16) for k, words in enumerate(rows, 1)))
    joints = write_rows(tmp_path / "j.csv", [f"J{k}" for k in range(1, 7)], degrees(truth))
    made = import_recording([joints, points], tmp_path / "out", UR10)
    assert made.fits[0].rms_mm < 0.1
    found, expected = (points - points[0] for points in (made.recording.points, truth.points))
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.linalg.norm(expected, axis=1), abs=0.1)
