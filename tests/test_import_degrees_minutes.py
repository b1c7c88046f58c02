"""Angles with minutes and seconds in their decimals, and as text."""

import numpy as np
import pytest

from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.units import degrees_of, may_be_dms
from datasets.importers.user_tables import read_targets
from import_scenes import (
    SCENE,
    UR10,
    assert_same_rows,
    degrees,
    pose_scene,
    simulated,
    write_rows,
)
from workbench.recordings.importing import import_recording

HEADER = [*(f"J{k}" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def digits(angles: np.ndarray, with_seconds: bool = True) -> np.ndarray:
    """12 deg 30 min 45 s as 12.3045, rounded to seconds or to minutes."""
    parts = np.round(np.abs(angles) * (3600 if with_seconds else 60)).astype(int)
    seconds = parts if with_seconds else 60 * parts
    made = seconds // 3600 + seconds // 60 % 60 / 100 + seconds % 60 / 10000
    return np.sign(angles) * made


def test_digits_are_minutes_and_seconds():
    angles = np.array([12.3045, -0.0030, 89.5959, 5.0, -120.30])
    expected = [12 + 30 / 60 + 45 / 3600, -30 / 3600, 89 + 59 / 60 + 59 / 3600, 5.0, -120.5]
    assert np.allclose(degrees_of(angles, "dms"), expected, atol=1e-9)


@pytest.mark.parametrize(
    "values, is_possible",
    [
        (digits(np.linspace(-170, 170, 60)), True),
        (np.linspace(-170, 170, 60).round(4), False),
        (np.arange(-90.0, 90.0), False),  # whole degrees are the same in both notations
        (np.arange(-90.0, 90.0, 0.5), False),
    ],
)
def test_decimals_above_59_are_decimal_degrees(values, is_possible):
    assert may_be_dms(values) == is_possible


@pytest.mark.parametrize("with_seconds", [True, False])
def test_the_robot_decides_for_minutes(tmp_path, truth, with_seconds):
    angles = digits(degrees(truth), with_seconds)
    rows = np.hstack([angles, truth.points])
    made = import_recording([write_rows(tmp_path / "t.csv", HEADER, rows)], tmp_path / "out", UR10)
    assert made.mapping.joints.unit == "dms"
    assert_same_rows(made.recording, truth, joints=0.51 / (3600 if with_seconds else 60))


def test_decimal_degrees_whose_digits_allow_minutes_stay_decimal(tmp_path):
    many = simulated(tmp_path, pose_scene("ur10", 1200, 31, "share_of_limits = 0.4"))
    angles = degrees(many).round(2)
    rows = np.flatnonzero((np.abs(angles) % 1 < 0.595).all(axis=1))
    assert len(rows) > 30 and may_be_dms(angles[rows])
    path = write_rows(tmp_path / "t.csv", HEADER, np.hstack([angles, many.points])[rows])
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.mapping.joints.unit == "deg"


def test_text_with_signs_of_minutes_and_seconds(tmp_path, truth):
    def text(angle: float) -> str:
        seconds = round(abs(angle) * 3600)
        sign = "-" if angle < 0 else ""
        return f"{sign}{seconds // 3600}°{seconds // 60 % 60:02d}'{seconds % 60:02d}''"

    rows = [
        [*map(text, angles), *point] for angles, point in zip(degrees(truth), truth.points.tolist())
    ]
    made = import_recording([write_rows(tmp_path / "t.csv", HEADER, rows)], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth, joints=0.51 / 3600)


def test_targets_with_minutes_are_read_with_the_mapping_of_the_recording(tmp_path):
    """Corrected readings are decimal degrees, and their headers state it."""
    angles = np.array([[12.3045, -0.003, 10.0], [-120.30, 89.5959, 0.0]])
    path = write_rows(tmp_path / "t.csv", ["A1", "A2", "A3 [deg]"], angles)
    group = Group(("A1", "A2", "A3 [deg]"), ("dms", "dms", "deg"), None)
    (table,) = read_targets(path, [False] * 3, Mapping(joints=group))
    assert np.allclose(table.columns["q1_deg"], [12.5125, -120.5])
    assert np.allclose(table.columns["q2_deg"], [-30 / 3600, 89 + 59 / 60 + 59 / 3600])
    assert table.columns["q3_deg"].tolist() == [10.0, 0.0]
    assert [name for name, _ in table.origin.joints] == ["A1 [deg]", "A2 [deg]", "A3 [deg]"]
