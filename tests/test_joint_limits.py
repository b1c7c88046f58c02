"""Readings beyond nominal limits are measurements: they are used, and a warning says where they are."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import datasets
from conftest import ROOT
from erring_scenes import erring
from good_recordings import write_good
from scenes import CRAIG
from workbench.commands.sensor.handeye import command
from workbench.commands.shared import flow
from workbench.core.errors import InputError
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.identify import identifiability
from workbench.jobs.sensor import hand_eye

FREE = (-1000.0, 1000.0)
ARM = CRAIG | {"gravity": [0.0, 0.0, -1.0]}


@pytest.fixture
def limited(tmp_path):
    """`limited(limits of each joint, changes of columns)`: a recording, written and read again."""

    def made(limits, theta2_deg=-90.0, **columns):
        robot, recording = erring("external-point", 4, n=60, arm=ARM)
        joints = [row | {"limits_deg": list(pair)} for row, pair in zip(ARM["joint"], limits)]
        joints[1] |= {"theta_deg": theta2_deg}
        columns = {**recording.columns, **columns}
        limited = replace(recording, robot=ARM | {"joint": joints}, columns=columns)
        return robot, datasets.read(datasets.write(limited, tmp_path / "cell-4"))

    return made


def readings(name):
    return erring("external-point", 4, n=60, arm=ARM)[1].columns[name]


def test_a_reading_slightly_beyond_its_limit_is_a_warning(limited):
    q2 = readings("q2_deg")
    low, high = q2.min() - 1, np.sort(q2)[-2] - 3
    robot, recording = limited([FREE, (low, high), *[FREE] * 4])
    (warning,) = recording.warnings
    row = int(q2.argmax()) + 2
    for word in (
        "cell-4/samples.csv",
        f"row {row}",
        "q2_deg",
        "2 readings",
        "used as they are",
        "limits",
    ):
        assert word in warning
    made = calibrate(recording, [geometry(robot)], folds=3)
    assert made.recording.n == 60 and warning in made.as_json()["warnings"]
    assert made.suspicions == ()
    assert warning in identifiability(recording)["warnings"]


def test_limits_that_are_respected_are_not_mentioned(limited):
    assert limited([(-200.0, 200.0)] * 6)[1].warnings == ()


def test_a_column_within_its_limits_with_the_opposite_sign_is_refused_by_the_fit(limited):
    right = readings("q2_deg") - 40
    limits = float(right.min() - 2), float(right.max() + 2)
    assert -right.min() > limits[1]
    robot, recording = limited([FREE, limits, *[FREE] * 4], theta2_deg=-130.0, q2_deg=-right)
    assert "with the opposite sign all readings would be within them" in recording.warnings[0]
    with pytest.raises(InputError, match=r"column q2_deg"):
        calibrate(recording, [geometry(robot)], folds=3)


def with_a_wild_cell(folder):
    """The folder of a recording, row 8 of which reads 1700 degrees at joint 2."""
    table = folder / "samples.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    cells = lines[7].split(",")
    cells[2] = "1700"
    lines[7] = ",".join(cells)
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_readings_far_beyond_the_limits_are_read(tmp_path):
    """One wild cell stops nobody from reading the other rows; the fit shows that it is an outlier."""
    (warning,) = datasets.read(with_a_wild_cell(write_good(tmp_path / "cell-4"))).warnings
    assert (
        "row 8" in warning
        and "q2_deg" in warning
        and "1700" in warning
        and "-190 to 190" in warning
    )


def test_handeye_repeats_what_reading_found(tmp_path, monkeypatch):
    """The warning stands before those of the calibration, which is replaced here."""
    folder = with_a_wild_cell(write_good(tmp_path / "cell-4", "ball-surface"))
    monkeypatch.setattr(hand_eye, "calibrate", lambda *given: None)
    monkeypatch.setattr(hand_eye, "save", lambda made, where: None)
    monkeypatch.setattr(hand_eye, "as_json", lambda made, tolerances: {"warnings": ["own"]})
    answers = []

    def run(command, subject, out, json, work, show):
        answers.append(work(SimpleNamespace(partial=None), print))

    monkeypatch.setattr(flow, "run", run)
    command(str(folder), no_report=True)
    first, last = answers[0]["warnings"]
    assert "row 8" in first and last == "own"


@pytest.mark.parametrize("name", ["camera", "handeye", "scan", "scanner"])
def test_every_command_of_sensors_repeats_what_reading_found(name):
    source = (ROOT / "workbench" / "commands" / "sensor" / f"{name}.py").read_text(encoding="utf-8")
    assert "datasets.read(recording" in source and "with_reading_warnings(" in source
