"""`workbench evaluate`: a finished model predicts a recording that it was not fitted to."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
import workbench as wb
from import_scenes import pose_scene, simulated
from workbench.commands.cli import run
from workbench.core.errors import InputError


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A calibration of 60 poses, and folders with 30 other poses: as measured, and after the tracker was moved."""
    home = tmp_path_factory.mktemp("evaluate")
    every = simulated(home, pose_scene("ur10", 90, 4))
    fitted, other = every.select(np.arange(60)), every.select(np.arange(60, 90))
    datasets.write(replace(fitted, name="first"), home / "first")
    datasets.write(replace(other, name="second"), home / "second")
    datasets.write(moved(other), home / "moved")
    wb.calibrate(str(home / "first"), out=str(home / "run"), folds=3, no_report=True)
    return home


def moved(recording):
    """The recording in the frame of a tracker that was placed elsewhere."""
    turn = Rotation.from_euler("xyz", [1, 2, -30], degrees=True)
    points = turn.apply(recording.points) + [100.0, 50.0, -20.0]
    columns = dict(recording.columns) | dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    names = ("qw", "qx", "qy", "qz")
    w, x, y, z = (recording.columns[name] for name in names)
    turned = (turn * Rotation.from_quat(np.stack([x, y, z, w], 1))).as_quat().T
    columns |= dict(zip(names, (turned[3], *turned[:3])))
    return replace(recording, name="moved", columns=columns)


def test_unseen_poses_are_predicted_as_well_as_held_out_ones(runs):
    found = wb.evaluate(runs / "run", str(runs / "second"), no_report=True)
    held_out = wb.load(runs / "run").held_out.rms_mm
    assert found.refit == "none"
    assert 0.6 * held_out < found.error.rms_mm < 1.5 * held_out
    assert found.nominal.rms_mm > 3 * found.error.rms_mm
    assert found.error.rms_mm < found.error.p95_mm <= found.error.max_mm
    assert len(found.by_joint) == 6
    (said,) = found.warnings
    assert said.startswith("Beyond the range of the calibration: q5_deg (-250.3 to 232.2")


def test_residuals_are_those_of_the_stated_errors(runs, tmp_path):
    found = wb.evaluate(runs / "run", str(runs / "second"), out=tmp_path / "run")
    with open(tmp_path / "run" / "residuals.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    distances = np.array([float(row["distance_mm"]) for row in rows])
    assert len(rows) == 30
    assert np.sqrt(np.mean(distances**2)) == pytest.approx(found.error.rms_mm)
    assert (tmp_path / "run" / "report.html").is_file()


def test_an_instrument_that_was_moved_is_said_and_refitted_on_request(runs):
    fixed = wb.evaluate(runs / "run", str(runs / "moved"), no_report=True)
    assert fixed.error.rms_mm > 100
    assert "has moved since. Repeat with --refit base" in fixed.warnings[0]
    refitted = wb.evaluate(runs / "run", str(runs / "moved"), refit="base", no_report=True)
    same = wb.evaluate(runs / "run", str(runs / "second"), refit="base", no_report=True)
    assert refitted.error.rms_mm == pytest.approx(same.error.rms_mm, rel=1e-4)
    assert not any("has moved" in said for said in refitted.warnings)


def test_exit_status_1_where_the_tolerance_is_exceeded(runs, tmp_path, capsys):
    words = ["evaluate", str(runs / "run"), str(runs / "second"), "--no-report", "--tolerance"]
    assert run([*words, "0.001mm", "--out", str(tmp_path / "a")]) == 1
    assert "exceeds the tolerance" in capsys.readouterr().out.replace("\n", " ")
    assert run([*words, "5mm", "--out", str(tmp_path / "b")]) == 0


def test_a_recording_of_another_arm_is_refused(runs):
    with pytest.raises(InputError, match="joints"):
        other = simulated(runs, pose_scene("ur10", 12, 1))
        columns = {k: v for k, v in other.columns.items() if k != "q6_deg"}
        from workbench.files.solution_file import read_solution
        from workbench.jobs.robot.evaluate import evaluate

        evaluate(read_solution(runs / "run"), replace(other, columns=columns))


def test_an_unknown_refit_is_refused(runs, capsys):
    assert run(["evaluate", str(runs / "run"), str(runs / "second"), "--refit", "arm"]) == 2
    assert "base-and-tool" in capsys.readouterr().err


@pytest.mark.parametrize(
    "block, words",
    [
        ({}, "key considered.effects: expected a value, found none"),
        ([1, 2], "key considered: expected the effects, free keys and covariance"),
        ({"effects": [], "free": ["a"], "covariance": [[1.0]]}, "key considered: expected"),
    ],
)
def test_a_broken_block_of_considered_terms_is_named(runs, tmp_path, block, words):
    keys = json.loads((runs / "run" / "solution.json").read_text())
    (tmp_path / "solution.json").write_text(json.dumps(keys | {"considered": block}))
    with pytest.raises(InputError, match=words):
        wb.evaluate(tmp_path / "solution.json", str(runs / "second"), no_report=True)
