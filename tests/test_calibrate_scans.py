"""`calibrate` and `evaluate` of points on balls: a scan is one sample, numbered as its pose, with an error of its own."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.recording import SCATTER
from profile_scenes import profile_recording
from robot_model import load_robot
from robot_model.measurements.ball_surface import numbers_of_scans
from workbench.core.solution import Stage
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.planning.experiment import next_experiment
from workbench.files.solution_file import read_solution, solution_keys
from workbench.fitting.ball_scans import as_scans
from workbench.fitting.calibration_plans.plans import geometry
from workbench.fitting.cross_validation import carrying_samples
from workbench.fitting.plausibility.rows.change_points import _neighbours
from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
from workbench.fitting.verdicts.noise_report import Findings, report
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.evaluate import evaluate
from workbench.report.calibration.errors import POSITION, position_kind


@pytest.fixture(scope="module")
def calibrated():
    return calibrate(profile_recording(40, 60, 31))


def test_a_scan_is_one_sample_of_a_calibration(calibrated):
    answer = calibrated.as_json()
    assert answer["samples"] == answer["held_out"]["samples"] == 40
    assert answer["measures"] == solution_keys(calibrated)["measures"] == "ball-surface"
    assert calibrated.recording.sample_ids.tolist() == list(range(1, 41))


def test_clean_profiles_keep_the_geometry_alone(calibrated):
    assert [stage.name for stage in calibrated.stages if stage.earned] == ["geometry"]


def test_the_held_out_error_is_that_of_new_poses(calibrated, tmp_path):
    """The scatter of the points makes sqrt(3 / 60) of 0.02 mm in a scan, in the recording and in the new poses."""
    save(calibrated, tmp_path)
    new = evaluate(read_solution(tmp_path), profile_recording(40, 60, 32))
    assert new.recording.n == 40
    error = new.as_json()["error"]["rms_mm"]
    assert calibrated.held_out["rms_mm"] == pytest.approx(error, rel=0.3)
    assert error < 0.01


def test_the_verdict_compares_with_the_scatter_within_scans(calibrated):
    noise = calibrated.noise.findings.within_scans
    assert noise == pytest.approx(0.02 * np.sqrt(3 / 62), rel=0.1)
    verdict = calibration_verdict(calibrated.held_out, calibrated.noise)
    assert "scatter of the points within the scans" in verdict.sentence
    assert "diagnose" not in verdict.sentence


def test_an_unmodelled_effect_in_profiles_is_above_the_scatter():
    def error(joints):
        out = np.zeros_like(joints)
        out[:, 2] = 4e-4 * np.cos(7 * joints[:, 2])
        return out

    found = calibrate(profile_recording(40, 60, 33, error=error), plan=_geometry)
    sentence = calibration_verdict(found.held_out, found.noise).sentence
    assert "errors of the arm's poses" in sentence and "run `workbench diagnose`" in sentence


def _geometry(chain):
    return (geometry(chain.robot),)


def _geometry_stage():
    return geometry(load_robot("ur5"))


def test_named_points_stand_for_their_scans():
    recording = profile_recording(24, 40, 34)
    numbers = numbers_of_scans(recording)
    test = recording.sample_ids[np.isin(numbers, [3, 9, 17])][::5]
    found = calibrate(recording, plan=_geometry, test_samples=test.tolist())
    held_out = found.recording.sample_ids[np.isfinite(found.held_out_residual[0])]
    assert held_out.tolist() == [3, 9, 17]


def test_the_stated_noise_of_points_is_compared_with_their_scatter():
    recording = profile_recording(12, 40, 35)
    assert not as_scans(replace(recording, sigma_mm=0.02)).warnings
    (sentence,) = as_scans(replace(recording, sigma_mm=0.1)).warnings
    assert "stated noise of a point is 0.1 mm" in sentence
    shown = float(sentence.split("scatter by ")[1].split(" mm")[0])
    assert shown == pytest.approx(0.02, rel=0.1)
    scatter = as_scans(recording).columns[SCATTER]
    assert scatter == pytest.approx(0.02 * np.sqrt(3 / 43), rel=0.25)


def test_few_samples_that_carry_the_held_out_error_are_named():
    residual = np.full((3, 20), 0.01)
    residual[:, [4]] = 1.0
    assert carrying_samples(residual).tolist() == [4]
    assert not len(carrying_samples(np.full((3, 20), 0.01)))
    found = Findings(None, None, None, 0.01, 0.01, 30.0, None, 0.01, 1000.0, 20)
    held_out = {"rms_mm": 0.3, "median_mm": 0.017, "samples": 20, "carried_by": [5]}
    sentence = calibration_verdict(held_out, report(found)).sentence
    assert "1 of 20 samples (sample 5) makes half" in sentence and "0.017 mm" in sentence


def test_a_change_within_a_scan_is_at_its_nearest_end():
    recording = profile_recording(12, 40, 36)
    order = np.arange(recording.n)
    first = int(np.flatnonzero(recording.columns["pose"] == 8)[0])
    assert _neighbours(recording, order, first + 3) == (7, 8)
    assert _neighbours(recording, order, first - 3) == (7, 8)


def test_scans_of_a_robot_without_poses_are_numbered_in_order():
    recording = profile_recording(6, 20, 37)
    columns = {name: cells for name, cells in recording.columns.items() if name != "pose"}
    numbers = numbers_of_scans(replace(recording, columns=columns))
    assert numbers.tolist() == recording.columns["pose"].astype(int).tolist()


def test_few_poses_without_a_finding_ask_for_more():
    bench = bench_of(profile_recording(12, 60, 38))
    sentence = next_experiment(bench, (), bench.problem(), 1.0).sentence
    assert "12 poses leave 9 degrees of freedom" in sentence and "None is needed" not in sentence
    bench = bench_of(profile_recording(40, 60, 38))
    assert "None is needed" in next_experiment(bench, (), bench.problem(), 1.0).sentence


def test_the_weights_of_a_given_plan_are_next_to_its_effects():
    """A shift of the ball that the plan states is no error of the poses, which would drop its parameters."""
    moved = np.where(np.arange(40)[:, None] < 20, 0.0, [0.3, -0.2, 0.25])
    shift = ("shift", "base", {"after": 19.5})
    stages = (_geometry_stage(), Stage("shift", "it moved", effects=(shift,), free=("*",)))
    found = calibrate(profile_recording(40, 60, 39, moved=moved), plan=stages)
    assert found.fit["rms_mm"] < 0.006


def test_the_error_of_a_scan_is_no_3d_distance():
    assert position_kind("ball-surface").quantity == position_kind("ball-scan").quantity
    assert "3-D" not in position_kind("ball-surface").quantity
    assert position_kind("external-point") == POSITION
