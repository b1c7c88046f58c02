"""`workbench evaluate`: a finished model predicts a recording that it was not fitted to."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
import workbench as wb
from import_scenes import pose_scene, simulated
from profile_scenes import profile_recording
from robot_model.effects.drift import BaseDrift
from robot_model.effects.elastic import JointCompliance
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.evaluate import Evaluated, evaluate
from workbench.jobs.robot.evaluate_sentences import refit_sentences
from workbench.jobs.robot.session_clock import on_session_clock


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
    np.testing.assert_allclose(found.to_frame()["distance_mm"], distances)


def test_a_noise_that_the_diagnosis_found_is_that_of_recordings_that_state_the_same(runs, tmp_path):
    stated = wb.evaluate(runs / "run", str(runs / "second"), no_report=True).verdict
    keys = json.loads((runs / "run" / "solution.json").read_text())
    (tmp_path / "solution.json").write_text(json.dumps(keys | {"noise_factor": 3.0}))
    found = wb.evaluate(tmp_path, str(runs / "second"), no_report=True).verdict
    assert "times 3 as the diagnosis found" in found.sentence
    assert 2 < found.noise / stated.noise < 3.01


def test_an_instrument_that_was_moved_is_said_and_refitted_on_request(runs):
    fixed = wb.evaluate(runs / "run", str(runs / "moved"), no_report=True)
    assert fixed.error.rms_mm > 100
    assert "has moved since, or errors of the model" in fixed.warnings[0]
    assert "repeat with --refit base-and-tool" in fixed.verdict.sentence
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
        evaluate(read_solution(runs / "run"), replace(other, columns=columns))


def test_an_unknown_refit_is_refused(runs, capsys):
    assert run(["evaluate", str(runs / "run"), str(runs / "second"), "--refit", "arm"]) == 2
    assert "base-and-tool" in capsys.readouterr().err


MODEL = {"effects": [], "values": {}, "free": [], "covariance": [], "probability": 0.5}


@pytest.mark.parametrize(
    "block, words",
    [
        ({}, "key considered.recorded_rms_mm: expected a value, found none"),
        ([1, 2], "key considered: expected the models"),
        ({"models": [{"effects": []}], "recorded_rms_mm": 0.0}, "key considered.values: expected"),
        (
            {"models": [MODEL | {"probability": 2.0}], "recorded_rms_mm": 0.0},
            "considered: expected",
        ),
        ({"models": [MODEL | {"free": ["a"]}], "recorded_rms_mm": 0.0}, "considered: expected"),
    ],
)
def test_a_broken_block_of_considered_terms_is_named(runs, tmp_path, block, words):
    keys = json.loads((runs / "run" / "solution.json").read_text())
    (tmp_path / "solution.json").write_text(json.dumps(keys | {"considered": block}))
    with pytest.raises(InputError, match=words):
        wb.evaluate(tmp_path / "solution.json", str(runs / "second"), no_report=True)


def test_one_moved_by_less_than_twice_the_noise_does_not_agree_with_it(runs):
    """A verdict by a test and not by a ratio: 0.04 mm of shift in 30 poses with a noise of 0.02 mm a coordinate."""
    arm, second = read_solution(runs / "run"), datasets.read(runs / "second")
    assert "agrees with the noise" in evaluate(arm, second, "base").verdict().sentence
    sigma = float(np.mean(second.sigma))
    columns = dict(second.columns) | {"x_mm": second.columns["x_mm"] + 2.5 * sigma}
    found = evaluate(arm, replace(second, columns=columns))
    assert "agrees with the noise" not in found.verdict().sentence
    assert any("has moved since" in said for said in found.warnings)


def test_a_share_of_the_noise_that_acts_like_a_move_is_no_move(runs):
    """Positions without noise, all off by a third of it: the F test knows only that another base leaves nothing."""
    arm, second = read_solution(runs / "run"), datasets.read(str(runs / "second"))
    sigma = float(np.sqrt(np.mean(np.square(second.sigma_mm))))

    def warnings_with(offset):
        predicted = second.points + evaluate(arm, second).residual[:3].T + [offset, 0.0, 0.0]
        columns = dict(second.columns) | dict(zip(("x_mm", "y_mm", "z_mm"), predicted.T))
        return " ".join(evaluate(arm, replace(second, columns=columns)).warnings)

    assert "has moved since" not in warnings_with(sigma / 3)
    assert "has moved since" in warnings_with(10 * sigma)


def test_uncertainty_of_the_calibration_is_no_move_where_no_noise_is_stated(tmp_path):
    """Other profiles of the same ball, almost without noise: base and tool take up a part of what is uncertain."""
    datasets.write(profile_recording(n=40, each=100, seed=3), tmp_path / "measured")
    other = profile_recording(n=40, each=90, seed=53, sigma=1e-4)
    assert other.sigma is None
    wb.calibrate(str(tmp_path / "measured"), out=str(tmp_path / "run"), folds=3, no_report=True)
    arm = read_solution(tmp_path / "run")
    assert not any("has moved since" in text for text in evaluate(arm, other).warnings)
    columns = dict(other.columns) | {"x_mm": other.columns["x_mm"] + 0.2}
    found = evaluate(arm, replace(other, columns=columns))
    assert any("estimated on this recording" in text for text in found.warnings)


def test_orientations_do_not_outweigh_positions_without_a_stated_noise(runs):
    """With a sigma of 1 mm for positions the RMS with base and tool estimated was 18 % larger."""
    arm, second = read_solution(runs / "run"), datasets.read(str(runs / "second"))
    stated = evaluate(arm, second).refitted[:3]
    unknown = evaluate(arm, replace(second, sigma_mm=None)).refitted[:3]
    assert np.sqrt(np.mean(unknown**2)) == pytest.approx(np.sqrt(np.mean(stated**2)), rel=1e-3)


def test_few_samples_cannot_pass_by_fitting_base_and_tool(runs):
    arm, second = read_solution(runs / "run"), datasets.read(runs / "second")
    with pytest.raises(InputError, match="expected at least 5 poses, found 2: base and tool have"):
        evaluate(arm, second.select(np.arange(2)), "base-and-tool")
    few = evaluate(arm, second.select(np.arange(6)), "base-and-tool").verdict()
    rms = evaluate(arm, second.select(np.arange(6)), "base-and-tool")
    raw = np.sqrt(np.mean(rms.distances**2))
    left = 18 - rms.estimated
    assert few.parts[0].residual == pytest.approx(raw * np.sqrt(18 / left))


def test_another_robot_a_missing_load_and_metres_are_refused(runs):
    arm, second = read_solution(runs / "run"), datasets.read(runs / "second")
    with pytest.raises(InputError, match="expected the nominal geometry of the arm"):
        evaluate(arm, replace(second, robot={"builtin": "ur10e"}))
    loaded = replace(arm, fitted_range=dict(arm.fitted_range) | {"payload_kg": (0.0, 5.0)})
    elastic = replace(loaded, effects=(*arm.effects, JointCompliance("joint-2")))
    with pytest.raises(InputError, match="expected column payload_kg"):
        evaluate(elastic, second)
    scaled = {name: second.columns[name] / 1000 for name in ("x_mm", "y_mm", "z_mm")}
    with pytest.raises(InputError, match="hold m"):
        evaluate(arm, replace(second, columns=dict(second.columns) | scaled))


def test_a_load_that_the_calibration_did_not_have_is_said(runs):
    arm, second = read_solution(runs / "run"), datasets.read(runs / "second")
    columns = dict(second.columns) | {"payload_kg": np.full(second.n, 4.0)}
    found = evaluate(arm, replace(second, columns=columns))
    assert any("payload_kg (4 to 4, calibrated 0 to 0)" in said for said in found.warnings)


def test_the_fitted_recording_is_not_called_unseen(runs):
    arm = read_solution(runs / "run")
    fitted = evaluate(arm, datasets.read(runs / "first"))
    assert "The calibration was fitted to this recording" in fitted.warnings[0]
    assert "on the fitted recording" in fitted.verdict().sentence
    other = evaluate(arm, datasets.read(runs / "second"))
    assert not any("was fitted to" in said for said in other.warnings)
    assert "on a recording that was not fitted" in other.verdict().sentence


def test_samples_that_a_calibration_left_out_are_not_fitted(runs, tmp_path):
    """One file, of which every other pose was fitted: the rest is held out, the whole is partly fitted."""
    first = datasets.read(runs / "first")
    even = first.sample_ids[::2]
    words = {"fit_samples": even, "test_samples": first.sample_ids[1::2], "no_report": True}
    wb.calibrate(str(runs / "first"), out=str(tmp_path / "run"), folds=3, **words)
    arm = read_solution(tmp_path / "run")
    assert arm.fitted_samples.tolist() == [[k, k] for k in even]
    unseen = evaluate(arm, first.select(np.arange(1, 60, 2)))
    assert not unseen.is_fitted_data
    assert unseen.as_json()["error"]["rms_mm"] == pytest.approx(arm.held_out_mm, abs=1e-6)
    assert "fitted to 30 of these 60 samples" in evaluate(arm, first).warnings[0]
    assert evaluate(arm, first.select(np.arange(0, 60, 2))).is_fitted_data


def drifting(arm, end):
    """The arm with a base that moved by -1 to 1 mm from 0 to `end` on the clock of the calibration."""
    drift = BaseDrift("base", start=0, end=end, order=1)
    values = {p.key: float(p.key.endswith(".x_t1")) for p in drift.parameters(None)}
    return replace(arm, effects=(*arm.effects, drift), values={**arm.values, **values})


def moved_mm(changed, arm, recording, **options):
    """(n,) mm by which a change of the arm moves the predictions."""
    change = evaluate(changed, recording, **options).residual - evaluate(arm, recording).residual
    return np.linalg.norm(change[:3], axis=0)


def without_times(recording):
    return replace(recording, columns={k: v for k, v in recording.columns.items() if k != "time_s"})


def test_a_drift_of_the_calibration_is_not_repeated_on_a_later_recording(runs):
    """A base that moved by -1 to 1 mm during the calibration is 1 mm away in every row measured after it."""
    arm = read_solution(runs / "run")
    first, second = (without_times(datasets.read(runs / name)) for name in ("first", "second"))
    expected = np.abs(np.linspace(-1, 1, 60))
    moving = drifting(arm, 59)
    np.testing.assert_allclose(moved_mm(moving, arm, first), expected, atol=1e-6)
    np.testing.assert_allclose(moved_mm(moving, arm, second), 1.0, atol=1e-6)
    assert any("as measured after those" in said for said in evaluate(moving, second).warnings)
    assert not any("as measured after" in said for said in evaluate(moving, first).warnings)


def test_base_and_tool_are_estimated_and_effects_of_the_base_are_not(runs):
    """A drift of 1 mm that the recording does not have stays in the residual, whatever the pose of the base."""
    arm = read_solution(runs / "run")
    first = without_times(datasets.read(runs / "first"))
    plain, moving = (evaluate(one, first, "base-and-tool") for one in (arm, drifting(arm, 59)))
    assert plain.estimated == moving.estimated == moving.most_estimated == 12
    left = np.linalg.norm(moving.refitted[:3] - plain.refitted[:3], axis=0)
    assert np.sqrt((left**2).mean()) > 0.3
    np.testing.assert_array_equal(moving.residual, moving.refitted)


def test_a_part_of_the_calibrated_recording_keeps_its_instants(runs):
    """Every third sample, in another order, was measured where the complete recording has it."""
    arm = read_solution(runs / "run")
    first = without_times(datasets.read(runs / "first"))
    chosen = np.arange(57, -1, -3)
    expected = np.abs(np.linspace(-1, 1, 60))[chosen]
    part = first.select(chosen)
    np.testing.assert_allclose(moved_mm(drifting(arm, 59), arm, part), expected, atol=1e-6)
    # numbers of samples that are not the rows: 101, 102, ... after 1, 2, ...
    runs_of = np.array([[101.0, 130.0], [1.0, 30.0]])
    numbers = {"sample": np.array([130.0, 101.0, 1.0, 30.0])}
    named = replace(first.select(np.arange(4)), columns=first.columns | numbers)
    clock = on_session_clock(replace(arm, recorded_samples=runs_of), named).columns["row"]
    np.testing.assert_array_equal(clock, [29, 0, 30, 59])


def test_times_of_a_clock_that_was_started_again_are_warned_of(runs):
    """Times from 0 on are those of one clock until --later says that all samples came after the calibration."""
    arm = read_solution(runs / "run")
    first, second = (datasets.read(runs / name) for name in ("first", "second"))
    last = float(first.columns["time_s"].max()) if "time_s" in first.columns else 590.0
    arm = replace(arm, fitted_range={**arm.fitted_range, "time_s": (0.0, last)})
    moving = drifting(arm, last)
    again = second.columns | {"time_s": np.linspace(0, last, second.n)}
    again = replace(second, columns=again)
    expected = np.abs(np.linspace(-1, 1, second.n))
    np.testing.assert_allclose(moved_mm(moving, arm, again), expected, atol=1e-6)
    assert any("repeat with --later" in said for said in evaluate(moving, again).warnings)
    assert not any("--later" in said for said in evaluate(arm, again).warnings)
    np.testing.assert_allclose(moved_mm(moving, arm, again, later=True), 1.0, atol=1e-6)
    assert not any("--later" in said for said in evaluate(moving, again, later=True).warnings)
    after = replace(again, columns=again.columns | {"time_s": last + 10 + np.arange(second.n)})
    np.testing.assert_allclose(moved_mm(moving, arm, after), 1.0, atol=1e-6)
    assert not any("--later" in said for said in evaluate(moving, after).warnings)


def test_times_say_nothing_to_a_model_that_counts_rows(runs):
    arm = read_solution(runs / "run")
    arm = replace(arm, fitted_range={k: v for k, v in arm.fitted_range.items() if k != "time_s"})
    second = datasets.read(runs / "second")
    timed = replace(second, columns=second.columns | {"time_s": np.arange(float(second.n))})
    np.testing.assert_allclose(moved_mm(drifting(arm, 59), arm, timed), 1.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("refit", ["none", "base", "base-and-tool"])
def test_the_expected_error_is_that_of_a_right_model(tmp_path, refit):
    """Mean of (error / expected)^2 over six arms: 1 within 0.3, for any number of parameters estimated again."""
    ratios = []
    for seed in range(200, 206):
        home = tmp_path / str(seed)
        home.mkdir()
        scene = pose_scene("ur10", 90, seed).replace("external-pose", "external-point")
        every = simulated(home, scene)
        datasets.write(replace(every.select(np.arange(50)), name="first"), home / "first")
        wb.calibrate(str(home / "first"), out=str(home / "run"), folds=3, no_report=True)
        second = every.select(np.arange(50, 90))
        verdict = evaluate(read_solution(home / "run"), second, refit).verdict()
        ratios.append(verdict.residual / verdict.noise)
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.3)


def test_a_calibration_that_is_worse_than_the_nominal_arm_is_said():
    rng = np.random.default_rng(3)
    nominal, refitted = 0.1 * rng.normal(size=(3, 40)), 0.3 * rng.normal(size=(3, 40))
    (worse,) = refit_sentences(refitted, nominal, fits_better=False)
    assert "worse than the nominal one" in worse
    (better,) = refit_sentences(nominal, refitted, fits_better=True)
    assert better.endswith("repeat with --refit base-and-tool.")


def test_errors_by_joint_have_no_row_of_a_joint_at_rest():
    columns = {"q1_deg": np.zeros(6), "q2_deg": np.array([0.0, 0, 0, 9, 9, 9])}
    recording = SimpleNamespace(columns=columns)
    distances = np.array([1.0, 1, 1, 2, 2, 2])
    (row,) = Evaluated.by_joint(SimpleNamespace(recording=recording, distances=distances))
    assert row["joint"] == "q2_deg"
    assert row["rms_mm"] == [None, 1.0, 2.0]
