"""The global test of a calibration: what is loud, what is calm, and what says nothing."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from noise_scenes import SIGMA, XYZ, geometry_of, heavy, normal, recorded
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded as of_elastic_arm
from workbench.core.errors import InputError
from workbench.core.least_squares.adjustment_tests import VarianceTest, change_test
from workbench.files.solution_file import solution_keys
from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
from workbench.fitting.verdicts.noise_report import ALARM, NONE, NOTICE, Findings, report


def with_columns(recording, **columns):
    return replace(recording, columns={**recording.columns, **columns})


def blunders(points, rng):
    rows = rng.choice(points.shape[1], points.shape[1] // 10, replace=False)
    points[:, rows] += rng.normal(0, 10, (3, len(rows)))
    return points


def moved(points, rng):
    points[:, points.shape[1] // 2 :] += np.array([[4.0], [-3.0], [5.0]])
    return points


def shuffled(points, rng):
    return points[:, rng.permutation(points.shape[1])]


def metres(points, rng):
    return points * np.array([[1.0], [1.0], [1e-3]])


def rounded(recording):
    return with_columns(
        recording, **{f"q{k}_deg": np.round(recording.columns[f"q{k}_deg"]) for k in range(1, 7)}
    )


def gon(recording):
    return with_columns(recording, q3_deg=recording.columns["q3_deg"] / 0.9)


FAULTS = {
    "instrument moved midway": lambda: recorded(1, change=moved),
    "readings rounded to degrees": lambda: rounded(recorded(2)),
    "shuffled points": lambda: recorded(3, change=shuffled),
    "one joint in gon": lambda: gon(recorded(4)),
    "z in metres": lambda: recorded(5, change=metres),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_recording_is_never_silent(fault):
    try:
        made = geometry_of(FAULTS[fault]())
    except InputError:
        return  # refused before the fit: loud enough
    answer = made.as_json()
    assert answer["warnings"], (
        "a fit that is hundreds of times worse than the noise ends without a warning"
    )
    assert answer["noise"]["factor"] > 20 and answer["noise"]["level"] == ALARM
    verdict = calibration_verdict(made.held_out, made.noise)
    assert verdict.residual_over_noise > 20 and "times the noise" in verdict.sentence
    assert verdict.passed is False and "Do not use this result" in verdict.sentence
    assert solution_keys(made)["warnings"], "`compensate` trusts it"


def test_a_tenth_of_blunders_is_named_by_sample_number():
    wrong = recorded(0, change=blunders)
    shift = np.stack([wrong.columns[k] - recorded(0).columns[k] for k in XYZ])
    truth = set(wrong.sample_ids[np.abs(shift).max(0) > 0].tolist())
    made = geometry_of(wrong)
    findings = made.noise.findings
    named = {*findings.outlying, *findings.left_out}
    assert named <= truth and len(named) >= len(truth) - 1
    assert findings.test.factor < 1.2, "the rows that are named are left out, and the others agree"
    assert any("leaves them out" in text for text in made.warnings)


def test_at_most_twelve_samples_are_named_in_a_sentence():
    made = geometry_of(recorded(6, n=200, change=blunders))
    (sentence,) = [text for text in made.noise.warnings if "left out of the fit as faulty" in text]
    assert f"and {len(made.noise.findings.left_out) - 12} more" in sentence
    report_of_outlying = report(replace(made.noise.findings, outlying=tuple(range(1, 21))))
    (sentence,) = [t for t in report_of_outlying.warnings if "do not agree with the others" in t]
    assert "and 8 more" in sentence


def test_a_single_lost_beam_is_left_out_and_said():
    def lost(points, rng):
        points[:, 7] += 5
        return points

    answer = geometry_of(recorded(7, change=lost)).as_json()
    assert answer["suspect_samples"] == [8]
    assert any("left out of the fit as faulty: number 8" in text for text in answer["warnings"])
    assert answer["noise"]["level"] == NOTICE


def test_noise_stated_three_times_too_small_is_a_finding_of_its_own():
    answer = geometry_of(recorded(8, times=3.0)).as_json()
    assert answer["noise"]["factor"] == pytest.approx(3, rel=0.15)
    assert answer["noise"]["stated_mm"] == SIGMA
    assert answer["noise"]["from_residuals_mm"] == pytest.approx(3 * SIGMA, rel=0.25)
    (warning,) = answer["warnings"]
    assert "Either the noise is stated too small" in warning and "gear orders" in warning
    assert answer["noise"]["level"] == NOTICE


def test_noise_stated_three_times_too_large_is_said_too():
    (warning,) = geometry_of(recorded(9, times=1 / 3)).as_json()["warnings"]
    assert "the noise is stated too large" in warning


def repeated(times, effect=0.0):
    """20 poses, six times each, with noise of `times` sigma and a joint error of `effect` rad that is not modelled."""
    base = recorded(10, n=40, times=0.0)
    rows = np.repeat(np.arange(40), 5)
    several = base.select(rows)
    rng = np.random.default_rng(3)
    points = {k: several.columns[k] + times * SIGMA * rng.standard_normal(200) for k in XYZ}
    q2 = several.columns["q2_deg"]
    wrong = np.rad2deg(effect) * np.sin(3 * np.deg2rad(q2))
    one = {k: np.ones(200) for k in several.columns if k.startswith(("payload", "approach"))}
    sample = np.arange(1.0, 201.0)
    return with_columns(
        several, sample=sample, repeat=rows.astype(float), q2_deg=q2 + wrong, **points, **one
    )


def test_repeats_that_scatter_more_than_stated_prove_the_statement_wrong():
    answer = geometry_of(repeated(3.0)).as_json()
    assert answer["noise"]["from_repeats_mm"] == pytest.approx(3 * SIGMA, rel=0.1)
    assert any("State sigma_mm = 0.0" in text for text in answer["warnings"])
    assert any("scatter by as much" in text for text in answer["warnings"])


def test_repeats_that_scatter_as_stated_prove_an_unmodelled_effect():
    answer = geometry_of(repeated(1.0, effect=5e-4)).as_json()
    assert answer["noise"]["from_repeats_mm"] == pytest.approx(SIGMA, rel=0.1)
    assert any("rest comes from unmodelled effects" in text for text in answer["warnings"])
    assert not any("State sigma_mm" in text for text in answer["warnings"])


def test_copies_of_a_row_are_no_replicates():
    several = repeated(1.0)
    copied = with_columns(
        several, **{k: several.columns[k][several.columns["repeat"].astype(int) * 5] for k in XYZ}
    )
    assert geometry_of(copied).noise.findings.replicates is None


def test_an_unmodelled_joint_error_is_distinguished_from_wrong_noise():
    clean = recorded(11, n=160)
    q2 = clean.columns["q2_deg"]
    wrong = with_columns(clean, q2_deg=q2 + np.rad2deg(3e-4) * np.sin(2 * np.deg2rad(q2)))
    noise = geometry_of(wrong).noise
    assert "the joint angles" in noise.findings.structure.depends_on
    assert noise.level == NOTICE and "unmodelled effects" in noise.sentence


def test_the_discrepancy_is_what_the_model_leaves_beyond_the_noise():
    clean = recorded(11, n=160)
    assert geometry_of(clean).noise.discrepancy_rms == 0.0
    assert geometry_of(recorded(8, times=3.0)).noise.discrepancy_rms == 0.0, "noise stated wrongly"
    q2 = clean.columns["q2_deg"]
    wrong = with_columns(clean, q2_deg=q2 + np.rad2deg(1e-3) * np.sin(3 * np.deg2rad(q2)))
    fit = geometry_of(wrong)
    left = fit.noise.findings.residual_rms
    assert fit.noise.discrepancy_rms == pytest.approx(np.sqrt(3 * (left**2 - SIGMA**2)))
    assert fit.noise.discrepancy_rms > 5 * SIGMA
    assert geometry_of(repeated(3.0)).noise.discrepancy_rms == 0.0, "replicates scatter as much"
    assert geometry_of(repeated(1.0, effect=5e-4)).noise.discrepancy_rms > 2 * SIGMA


def test_a_drifting_instrument_is_seen_in_the_order_of_the_samples():
    def drifting(points, rng):
        return points + 0.3 * np.linspace(0, 1, points.shape[1]) ** 2 * np.array(
            [[1.0], [1.0], [0.0]]
        )

    noise = geometry_of(recorded(12, n=160, change=drifting)).noise
    assert "the order of the samples" in noise.findings.structure.depends_on
    assert noise.level == NOTICE


@pytest.mark.parametrize("seed", range(3))
def test_a_tool_that_slips_by_two_sigma_is_seen_in_the_order_of_the_samples(seed):
    """In the frame of the flange: in that of the instrument the step changes its direction with every pose."""
    move = np.random.default_rng(seed).normal(size=3)
    step = CATALOGUE["shift"]("tool", after=630.0)
    values = [*0.07 * move / np.linalg.norm(move), 0, 0, 0]
    structure = geometry_of(of_elastic_arm(seed, [step], values, n=90)).noise.findings.structure
    assert "the order of the samples" in structure.depends_on


@pytest.mark.parametrize("law", ["normal", "heavy"])
def test_the_change_test_keeps_its_level_and_finds_place_and_share_of_a_step(law):
    rng = np.random.default_rng(4)
    draw = rng.standard_normal if law == "normal" else partial(rng.standard_t, 4)
    clean = [change_test(draw(size=(12, 80))).p_value for _ in range(400)]
    assert np.mean(np.array(clean) < 0.01) <= 0.015 and min(clean) > 1e-4
    values = rng.standard_normal((3, 200))
    values[0, 60:] += 2.0
    found = change_test(values)
    assert abs(found.place - 60) <= 3 and found.p_value < 1e-9
    assert found.share == pytest.approx(0.84 / 1.84 / 3, rel=0.3)


def test_a_calm_finding_leaves_the_solution_usable_and_an_alarm_does_not():
    calm = geometry_of(recorded(8, times=3.0))
    assert calm.noise.warnings and solution_keys(calm)["warnings"] == []


def test_without_stated_noise_the_sentence_asks_for_it_and_nothing_warns():
    made = geometry_of(replace(recorded(13), sigma_mm=None))
    assert made.noise.level == NONE and "Write sigma_mm" in made.noise.sentence
    answer = made.as_json()["noise"]
    assert answer["stated_mm"] is None and answer["factor"] is None
    json.dumps(answer, allow_nan=False)


def test_without_stated_noise_an_implausible_fit_is_an_alarm_all_the_same():
    made = geometry_of(replace(recorded(3, change=shuffled), sigma_mm=None))
    assert made.noise.level == ALARM


def test_orientations_are_compared_with_their_own_stated_noise():
    made = recorded(15, n=60, measures="external-pose")
    rng = np.random.default_rng(0)
    turned = Rotation.from_rotvec(np.deg2rad(0.02) * rng.standard_normal((60, 3)))
    before = Rotation.from_quat(np.stack([made.columns[f"q{c}"] for c in "xyzw"], 1))
    quaternions = dict(zip(("qx", "qy", "qz", "qw"), (turned * before).as_quat().T))
    right = with_columns(made, **quaternions, sigma_deg=np.full(60, 0.02))
    calibration = geometry_of(right)
    assert calibration.noise.warnings == ()
    verdict = calibration_verdict(calibration.held_out, calibration.noise)
    assert (
        verdict.parts[1].noise == pytest.approx(np.sqrt(3) * 0.02)
        and "agrees" in verdict.parts[1].sentence
    )
    wrong = geometry_of(with_columns(right, sigma_deg=np.full(60, 0.005)))
    (warning,) = wrong.noise.warnings
    assert warning.startswith("Orientations: the RMS residual is 4")


def test_a_coarse_instrument_is_no_implausible_arm():
    coarse = replace(recorded(14, times=200.0), sigma_mm=200 * SIGMA)
    made = geometry_of(coarse)
    assert made.fit["rms_mm"] > 0.005 * made.noise.findings.reach
    assert made.noise.level == NONE


SEEDS = [pytest.param(5, marks=pytest.mark.slow), pytest.param(34, marks=pytest.mark.long)]


@pytest.mark.parametrize("seeds", SEEDS)
def test_clean_recordings_raise_no_false_alarm(seeds):
    """Six recordings a seed of arms off their data sheet; half with normal noise, half with t noise of 5 degrees."""
    kinds = [("external-point", 80), ("ball-centre", 120), ("external-pose", 60)]
    alarms = []
    for measures, n in kinds:
        for law in (normal, heavy):
            for seed in range(seeds):
                made = geometry_of(recorded(seed, n=n, law=law, measures=measures, arm=seed % 3))
                if made.noise.warnings:
                    alarms.append((measures, law.__name__, seed, made.noise.warnings))
    assert len(alarms) <= 0.01 * 6 * seeds, alarms


@pytest.mark.parametrize("measures", ["external-point", "ball-centre", "external-pose"])
def test_a_clean_recording_agrees_with_its_noise(measures):
    made = geometry_of(recorded(1, n=100, measures=measures))
    assert made.as_json()["warnings"] == [] and made.noise.level == NONE
    assert made.noise.findings.test.factor == pytest.approx(1, abs=0.15)
    verdict = calibration_verdict(made.held_out, made.noise)
    assert verdict.passed is None and "agrees with the noise" in verdict.sentence


def test_too_few_poses_do_not_agree_with_the_noise():
    """Eight poses fit within the noise because the model has as many parameters; unseen poses do not."""
    made = geometry_of(recorded(3, n=9))
    assert made.fit["rms_mm"] < 1.5 * np.sqrt(3) * SIGMA
    verdict = calibration_verdict(made.held_out, made.noise)
    assert verdict.residual_over_noise > 3
    assert "agrees" not in verdict.sentence
    assert "too few poses for this model: fit " in verdict.sentence


def test_too_few_poses_are_named_without_a_stated_noise():
    made = geometry_of(replace(recorded(3, n=12), sigma_mm=None))
    assert made.noise.findings.stated is None
    assert "too few poses" in calibration_verdict(made.held_out, made.noise).sentence


def test_held_out_orientations_are_tested_themselves():
    made = recorded(15, n=60, measures="external-pose")
    calibration = geometry_of(with_columns(made, sigma_deg=np.full(60, 0.02)))
    worse = calibration.held_out | {"rotation_rms_deg": 1.2}
    sentence = calibration_verdict(worse, calibration.noise).parts[1].sentence
    assert "agrees" not in sentence and "held out 1.2 deg" in sentence


def of_held_out(**errors):
    """Report on a fit that agrees with a noise of 0.05 mm on a reach of 1 m, with errors on left-out poses."""
    test = VarianceTest(1.0, 90.0, 0.5, 0.5)
    return report(Findings(0.05, test, None, 0.05, 0.05, 90.0, None, 0.087, 1000.0, 40, **errors))


@pytest.mark.parametrize(
    "errors, words",
    [
        ({"held_out_rms": 7.3}, "7.3 mm RMS off"),
        ({"held_out_rms": 0.1, "held_out_deg": 54.0, "fit_deg": 0.2}, "54 deg RMS off"),
    ],
)
def test_left_out_poses_far_beyond_fit_and_noise_are_an_alarm(errors, words):
    made = of_held_out(**errors)
    assert made.level == ALARM and words in made.alarms[0]
    verdict = calibration_verdict({"rms_mm": errors["held_out_rms"]}, made)
    assert verdict.passed is False and "Do not use this result" in verdict.sentence


@pytest.mark.parametrize(
    "errors", [{"held_out_rms": 1.9}, {"held_out_rms": 0.1, "held_out_deg": 1.5, "fit_deg": 1.4}]
)
def test_left_out_poses_with_the_errors_of_few_poses_are_no_alarm(errors):
    assert of_held_out(**errors).level == NONE
