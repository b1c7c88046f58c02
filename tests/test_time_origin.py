"""The clock of tables: a recording counts from its first row, and states the moment of that row."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import datasets
from datasets.importers.user_tables import read_targets
from import_scenes import degrees, pose_scene, simulated, write_rows
from workbench.files.targets import Programme
from workbench.jobs.robot import session_clock
from workbench.jobs.robot.session_clock import (
    clock_warning,
    on_session_clock,
    seconds_between,
    targets_on_session_clock,
)
from workbench.recordings.importing import ImportOptions, import_recording

SCENE = pose_scene("staubli_tx60", 24, 3, "share_of_limits = 0.4")
FIRST, LATER = "2026-09-14T08:12:05", "2026-09-14T10:00:00"


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("clock"), SCENE)


def imported(folder, truth, header, times):
    """The recording of one table with joint readings in degrees, points in mm and a column of times."""
    rows = [
        [time, *angles, *point]
        for time, angles, point in zip(times, degrees(truth), truth.points.round(5))
    ]
    names = [header, *(f"A{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    table = write_rows(folder / "table.csv", names, rows)
    return import_recording([table], folder / "made", ImportOptions(robot="staubli_tx60"))


@pytest.mark.parametrize(
    ("header", "times", "origin"),
    [
        ("time [s]", 5000.0 + 20 * np.arange(24), 5000.0),
        ("Zeit [ms]", 5e6 + 2e4 * np.arange(24), 5000.0),
        ("time", [f"2026-09-14 08:{12 + k:02d}:05" for k in range(24)], FIRST),
    ],
)
def test_an_import_states_the_moment_of_its_first_row(header, times, origin, truth, tmp_path):
    imported(tmp_path, truth, header, list(times))
    made = datasets.read(tmp_path / "made")
    assert made.time_origin == origin and made.columns["time_s"].min() == 0


def arm(origin):
    """What the clock needs of a calibrated arm that was measured from 0 to 3000 s, with a drift of its base."""
    drift = SimpleNamespace(reads=("time",), title="base-drift at base", port="frame")
    return SimpleNamespace(
        keys={"time_origin": origin},
        fitted_range={"time_s": (0.0, 3000.0)},
        rows=24,
        effects=(drift,),
        acting_effects=(),
        free=(),
        considered=None,
    )


@pytest.mark.parametrize(
    ("origins", "first"),
    [
        ((1000.0, 5000.0), 4000.0),
        ((FIRST, LATER), 6475.0),
        ((None, 5000.0), 0.0),
        ((FIRST, 5.0), 0.0),
    ],
)
def test_a_later_recording_is_evaluated_on_the_clock_of_the_calibration(origins, first, truth):
    times = {"time_s": 20.0 * np.arange(24)}
    later = replace(truth, columns=truth.columns | times, time_origin=origins[1])
    found = on_session_clock(arm(origins[0]), later).columns["time_s"]
    np.testing.assert_allclose(found, first + times["time_s"])
    assert ("started again" in clock_warning(arm(origins[0]), later)) == (first == 0)


def test_dates_within_the_calibration_are_no_clock_that_was_started_again(truth):
    times = {"time_s": 20.0 * np.arange(24)}
    within = replace(truth, columns=truth.columns | times, time_origin="2026-09-14T08:20:00")
    assert clock_warning(arm(FIRST), within) == ""
    numeric = replace(within, time_origin=0.0)
    assert "started again" in clock_warning(arm(0.0), numeric)


def test_a_time_stamp_and_a_number_have_no_difference():
    assert seconds_between(FIRST, 5.0) is None and seconds_between(None, 5.0) is None
    assert seconds_between(3, 5.5) == 2.5


@pytest.mark.parametrize(
    ("header", "times", "origin", "expected"),
    [
        ("time [s]", [7000.0, 7010.0], 5000.0, [2000.0, 2010.0]),
        ("Zeit [ms]", [7e6, 7.01e6], 5000.0, [2000.0, 2010.0]),
        ("time [s]", [2000.0, 2010.0], None, [2000.0, 2010.0]),
        ("Datum", ["2026-09-14 08:12:15", "2026-09-14 08:12:25"], FIRST, [10.0, 20.0]),
    ],
)
def test_targets_have_their_times_on_the_clock_of_the_calibration(
    header, times, origin, expected, tmp_path, monkeypatch
):
    placed, said = targets_on_session_clock(
        arm(origin), programme_of(header, times, tmp_path, monkeypatch)
    )
    np.testing.assert_allclose(placed.covariates["time_s"], expected)
    assert not said


def programme_of(header, times, folder, monkeypatch):
    """Targets with a column of times, of a model that reads it."""
    monkeypatch.setattr(session_clock, "covariates_read", lambda arm: frozenset({"time_s"}))
    monkeypatch.setattr(session_clock, "considered_covariates", lambda arm: frozenset())
    names = [header, *(f"A{k} [deg]" for k in range(1, 7))]
    path = write_rows(folder / "targets.csv", names, [[t, *np.arange(6.0)] for t in times])
    table = read_targets(path, [False] * 6)[0]
    times_read = {"time_s": table.columns["time_s"]}
    return Programme(table, np.zeros((len(times), 6)), None, times_read)


@pytest.mark.parametrize(
    ("header", "cells", "origin"),
    [("time", ["2026-09-14T08:12:15", "2026-09-14T08:12:25"], "2026-09-14T08:12:15")]
    + [("time [s]", [40.0, 50.0], 40.0), ("Zeit [ms]", [4e4, 5e4], 40.0)],
)
def test_targets_with_our_joint_columns_may_have_any_column_of_times(
    header, cells, origin, tmp_path
):
    names = [*(f"q{k}_deg" for k in range(1, 7)), header]
    path = write_rows(tmp_path / "targets.csv", names, [[*range(6), cell] for cell in cells])
    table = read_targets(path, [False] * 6)[0]
    assert table.columns["time_s"].tolist() == [0.0, 10.0] and table.time_origin == origin
    assert table.columns["q6_deg"].tolist() == [5.0, 5.0]


def test_targets_on_a_clock_that_the_recording_lacks_are_later_than_it(tmp_path, monkeypatch):
    """Dates cannot be compared with the seconds of a stop watch: the program runs after the recording anyhow."""
    programme = programme_of("time", ["2026-09-14 08:12:15"], tmp_path, monkeypatch)
    placed, (sentence,) = targets_on_session_clock(arm(5000.0), programme)
    assert placed.covariates["time_s"].tolist() == [3000.0]
    assert "no times on the clock of the recording" in sentence
