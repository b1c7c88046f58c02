"""No wrong number reaches an arm: limits of corrections, of their uncertainty, of loads, temperatures and joints."""

import csv
import json
import re

import numpy as np
import pytest

from robot_model import load_robot
from robot_model.system import geometry_priors
from scenes import ABB, scene
from workbench.core.errors import InputError
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.compensation.compensate import covariates_read
from workbench.jobs.robot.compensation.confirmed_correction import largest_corrections
from workbench.jobs.robot.compensation.correction_limits import (
    Limits,
    checked,
    doubt_about,
    parameter_deviations,
)

JOINTS = ",".join(f"q{k}_deg" for k in range(1, 7))
RANGE = {f"q{k}_deg": [-100.0, 100.0] for k in range(1, 7)}
COMPLIANT = {"effect": "joint-compliance", "where": "joint-2"}
WARM = {"effect": "joint-thermal-drift", "where": "joint-3"}
COMPLIANCE = "joint-2.joint-compliance.compliance"


def solution(folder, effects=(), changes=None, sigma=1e-6, **more):
    """A solution.json of an ABB whose every parameter is known to `sigma` (rad, mm)."""
    robot = load_robot(ABB)
    values = {key: nominal for key, (nominal, _) in geometry_priors(robot).items()}
    values |= {f"base.{c}": 0.0 for c in ("x", "y", "z", "rx", "ry", "rz")} | {
        f"tool.reflector1_{c}": 0.0 for c in "xyz"
    }
    values |= {"joint-3.theta3": values["joint-3.theta3"] + 1e-3} | (changes or {})
    free = list(values)
    keys = {
        "format": "solution/1",
        "recording": "r",
        "measures": "external-point",
        "robot": ABB,
        "effects": list(effects),
        "values": values,
        "free": free,
        "covariance": (sigma**2 * np.eye(len(free))).tolist(),
        "load_centre_mm": [0, 0, 50],
        "held_out": {"rms_mm": 0.05},
        "nominal": {"rms_mm": 1.0},
        "converged": True,
        "outcome": "converged",
        "warnings": [],
        "undetermined": [],
        "provenance": {},
        "priors": {COMPLIANCE: 3e-3},
        "noise_rms_mm": 0.03,
        "fitted_range": RANGE | {"payload_kg": [0.5, 3.0]},
    }
    folder.mkdir(exist_ok=True)
    (folder / "solution.json").write_text(json.dumps(keys | more))
    return folder


def answer_of(workbench, folder, text, *words, status=1):
    """Answer, rows of corrected.csv and finished process of `workbench compensate`."""
    (folder / "targets.csv").write_text(text, encoding="utf-8")
    done = workbench(
        "compensate",
        "arm",
        "targets.csv",
        "--out",
        f"run{len(list(folder.iterdir()))}",
        "--json",
        "answer.json",
        *words,
    )
    assert done.returncode == status, done.stdout + done.stderr
    answer = json.loads((folder / "answer.json").read_text())
    with open(answer["corrected"], encoding="utf-8", newline="") as file:
        return answer, list(csv.DictReader(file)), done


# ------------------------------------------------------------------------------------------- size of the corrections


def test_a_small_correction_that_turns_the_wrist_over_is_refused(workbench, tmp_path):
    """0.3 mm of link 2's twist; where joint 5 is nearly straight, joints 4 and 6 would rotate by tens of degrees."""
    alpha = load_robot(ABB).geometry[1, 3] + 5e-4
    solution(tmp_path / "arm", changes={"joint-2.alpha2": alpha})
    targets = f"{JOINTS}\n30,20,-10,20,0.03,10\n30,20,-10,20,30,10\n"
    answer, rows, done = answer_of(workbench, tmp_path, targets)
    assert [one["row"] for one in answer["refused"]] == [1]
    assert re.search(r"changes joint [46] by \d+(\.\d)? deg, above 10 deg", str(answer["refused"]))
    assert rows[0]["q4_deg"] == "" and rows[1]["q4_deg"] != ""
    answer, rows, done = answer_of(
        workbench, tmp_path, targets, "--max-joint-change-deg", "180", status=0
    )
    assert not answer["refused"] and abs(float(rows[0]["q4_deg"]) - 20) > 10


def test_a_correction_beyond_the_limits_keeps_no_readings(workbench, tmp_path):
    """theta3 off by 2 degrees makes corrections of some 20 mm and 2 degrees."""
    solution(
        tmp_path / "arm", changes={"joint-3.theta3": load_robot(ABB).geometry[2, 0] + np.deg2rad(2)}
    )
    answer, rows, done = answer_of(workbench, tmp_path, f"{JOINTS}\n0,10,10,0,30,0\n")
    assert [one["row"] for one in answer["refused"]] == [1]
    why = answer["refused"][0]["why"]
    assert "mm exceeds 10 mm" in why and "deg exceeds 1 deg" in why
    assert answer["largest_correction_mm"] > 10 and answer[
        "largest_correction_deg"
    ] == pytest.approx(2, abs=0.01)
    assert [rows[0][f"q{k}_deg"] for k in range(1, 7)] == [""] * 6 and rows[0]["refused"] == "1"
    assert "Target 1 is refused" in " ".join(done.stdout.split())


@pytest.mark.parametrize(
    "words", [("--force",), ("--max-correction-mm", "50", "--max-correction-deg", "3")]
)
def test_wider_limits_or_force_let_it_pass(workbench, tmp_path, words):
    solution(
        tmp_path / "arm", changes={"joint-3.theta3": load_robot(ABB).geometry[2, 0] + np.deg2rad(2)}
    )
    answer, rows, _ = answer_of(
        workbench, tmp_path, f"{JOINTS}\n0,10,10,0,30,0\n", *words, status=0
    )
    assert answer["refused"] == [] and float(rows[0]["q3_deg"]) == pytest.approx(8, abs=0.01)
    assert any("--force: 1 targets" in one for one in answer["warnings"]) == (words == ("--force",))


def coupled_wrist(folder, measured_mm, more=()):
    """A solution with a coupling of the wrist that turns the tool by 1.2 deg within the recorded range."""
    coupling = {"effect": "joint-coupling", "where": "joint-5", "joint": 4}
    values = {
        "joint-5.joint-coupling.from4": 0.03,
        "joint-3.theta3": load_robot(ABB).geometry[2, 0],
    }
    return solution(folder, [coupling, *more], values, nominal={"rms_mm": measured_mm})


CONFIRMED = pytest.mark.parametrize(("measured_mm", "is_refused"), [(3.0, False), (0.1, True)])


@CONFIRMED
def test_an_exported_module_has_the_limits_of_compensate(
    workbench, tmp_path, measured_mm, is_refused
):
    coupled_wrist(tmp_path / "arm", measured_mm)
    target = [0.0, 10.0, 10.0, 60.0, 30.0, 0.0]
    text = ",".join(f"{angle:g}" for angle in target)
    answer, _, _ = answer_of(
        workbench, tmp_path, f"{JOINTS}\n{text}\n", status=1 if is_refused else 0
    )
    done = workbench("export", "arm", "--to", "python", "--out", "arm.py")
    assert done.returncode == 0, done.stdout + done.stderr
    module: dict = {"__name__": "arm"}
    exec((tmp_path / "arm.py").read_text(), module)
    readings, _ = module["corrected_readings"]([target])
    assert len(answer["refused"]) == is_refused
    assert np.isfinite(readings).all() != is_refused


@CONFIRMED
def test_larger_corrections_pass_where_the_measured_error_confirms_them(
    tmp_path, measured_mm, is_refused
):
    arm = read_solution(coupled_wrist(tmp_path / "arm", measured_mm))
    assert (largest_corrections(arm) == (10.0, 1.0)) == is_refused
    assert Limits(correction_deg=0.5).largest_correction(arm)[1] == 0.5


@pytest.mark.parametrize("where", ["base", "tool"])
def test_the_error_of_a_base_that_moved_confirms_no_correction(tmp_path, where):
    step = {"effect": "shift", "where": where, "after": 40.5}
    arm = read_solution(coupled_wrist(tmp_path / "arm", 12.0, [step]))
    assert (largest_corrections(arm) == (10.0, 1.0)) == (where == "base")


def test_only_the_implausible_rows_are_refused(workbench, tmp_path):
    """And notes with commas, line ends and formulas move no joint into another column."""
    elastic(tmp_path / "arm")
    notes = ["weld, left 5", "line\nend", "=1+1"]
    lines = [
        f'"{note}",{angles},{load}'
        for note, angles, load in zip(
            notes, ["0,10,10,0,30,0", "1,0,0,0,40,0", "2,0,0,0,40,0"], [1, 5000, 2]
        )
    ]
    answer, rows, _ = answer_of(
        workbench, tmp_path, f"note,{JOINTS},payload_kg\n" + "\n".join(lines) + "\n"
    )
    assert (
        [one["row"] for one in answer["refused"]] == [2]
        and answer["corrected_count"] == 2
        and answer["count"] == 3
    )
    assert [row["q1_deg"] == "" for row in rows] == [False, True, False]
    assert [row["note"] for row in rows] == [*notes[:2], "'=1+1"]
    np.testing.assert_allclose([float(rows[k]["q5_deg"]) for k in (0, 2)], [30, 40], atol=0.2)


def test_an_exact_arm_keeps_its_targets(workbench, tmp_path):
    solution(tmp_path / "arm")
    answer, _, _ = answer_of(
        workbench, tmp_path, f"{JOINTS}\n0,10,10,0,30,0\n10,0,0,0,40,0\n", status=0
    )
    assert answer["refused"] == [] and answer["corrected_count"] == 2
    assert 0 < answer["largest_correction_mm"] < 2 and answer[
        "largest_correction_deg"
    ] == pytest.approx(np.rad2deg(1e-3), rel=1e-3)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--max-correction-mm", "0"), ("--max-correction-deg", "-1"), ("--max-sigma-mm", "nan")],
)
def test_a_limit_that_is_none_is_a_sentence(workbench, tmp_path, option, value):
    solution(tmp_path / "arm")
    (tmp_path / "t.csv").write_text(f"{JOINTS}\n0,10,10,0,30,0\n")
    done = workbench("compensate", "arm", "t.csv", option, value)
    assert done.returncode == 2 and f"{option} {value}: expected a number above 0" in done.stderr


# ------------------------------------------------------------------------------------------------ the whole solution


def test_parameters_far_from_nominal_refuse_the_solution(workbench, tmp_path):
    """The parameters of the recording whose advice negated a joint that was right."""
    robot = load_robot(ABB)
    changes = {
        "joint-5.theta5": robot.geometry[4, 0] + np.deg2rad(13.5),
        "joint-4.d4": robot.geometry[3, 1] + 5.9,
    }
    solution(tmp_path / "arm", changes=changes)
    (tmp_path / "t.csv").write_text(f"{JOINTS}\n0,10,10,0,30,0\n")
    for words in (
        ("compensate", "arm", "t.csv"),
        ("export", "arm", "--to", "urdf", "--out", "a.urdf"),
    ):
        done = workbench(*words)
        assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1
        assert (
            "parameter joint-5.theta5 is 13.5 deg from nominal, 7.9 prior standard deviations"
            in done.stderr
        )
        assert not (tmp_path / "a.urdf").exists() and not (tmp_path / "runs").exists()
    assert workbench("export", "arm", "--to", "urdf", "--out", "a.urdf", "--force").returncode == 0


def test_many_parameters_together_refuse_the_solution(tmp_path):
    """Each three prior standard deviations off: no one alone, but never all of them."""
    priors = geometry_priors(load_robot(ABB))
    few = {key: nominal + 3 * prior for key, (nominal, prior) in list(priors.items())[:1]}
    all_of_them = {key: nominal + 3 * prior for key, (nominal, prior) in priors.items()}
    assert doubt_about(read_solution(solution(tmp_path / "few", changes=few)), Limits()) == ""
    why = doubt_about(read_solution(solution(tmp_path / "all", changes=all_of_them)), Limits())
    assert "all 30 determined parameters are 3.0 from nominal" in why


def test_an_undetermined_parameter_does_not_count(tmp_path):
    """Its value is the prior's or a matter of gauge; base and tool have no nominal value at all."""
    nominal, prior = geometry_priors(load_robot(ABB))["joint-6.theta6"]
    folder = solution(
        tmp_path / "arm",
        changes={"joint-6.theta6": nominal + 9 * prior, "base.x": 4e3, "base.rz": 2.0},
    )
    keys = json.loads((folder / "solution.json").read_text())
    assert "joint-6.theta6" in doubt_about(read_solution(folder), Limits())
    covariance = np.array(keys["covariance"])
    place = keys["free"].index("joint-6.theta6")
    covariance[place, place] = (0.9 * prior) ** 2
    (folder / "solution.json").write_text(json.dumps(keys | {"covariance": covariance.tolist()}))
    arm = read_solution(folder)
    assert doubt_about(arm, Limits()) == "" and "joint-6.theta6" not in parameter_deviations(arm)


def test_an_effect_far_beyond_its_prior_counts(tmp_path):
    for value, is_far in ((1e-4, False), (0.02, True)):
        arm = read_solution(solution(tmp_path / f"arm{is_far}", (COMPLIANT,), {COMPLIANCE: value}))
        assert (COMPLIANCE in doubt_about(arm, Limits())) == is_far


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            {"held_out": {"rms_mm": 12.0}, "nominal": {"rms_mm": 90.0}},
            "held-out RMS position error of 12 mm is above",
        ),
        (
            {"held_out": {"rms_mm": 0.05, "rotation_rms_deg": 88.0}},
            "held-out RMS orientation error of 88 deg is above",
        ),
        (
            {"held_out": {"rms_mm": 4.6}, "nominal": {"rms_mm": 9.0}},
            "153 times the stated noise of 0.03 mm",
        ),
        (
            {"converged": False, "outcome": "stopped after 50 steps"},
            "the solve stopped after 50 steps",
        ),
        ({"held_out": {"rms_mm": 1.5}}, "is not below that of the nominal arm"),
        (
            {"warnings": ["left and right are swapped"]},
            "its recording is in doubt (left and right are swapped)",
        ),
    ],
)
def test_a_doubtful_solution_is_refused_unless_forced(tmp_path, more, words):
    arm = read_solution(solution(tmp_path / "arm", **more))
    with pytest.raises(InputError) as found:
        checked(arm, "solution.json", force=False)
    assert words in str(found.value)
    assert checked(arm, "solution.json", force=True) is arm


def test_the_nominal_arm_with_estimated_frames_may_be_used(tmp_path):
    """Its held-out error is that of the nominal arm, which is no doubt; an estimated geometry is refused with the remedy."""
    level = {"held_out": {"rms_mm": 0.05}, "nominal": {"rms_mm": 0.05}}
    frames = [*(f"base.{c}" for c in ("x", "y", "z", "rx", "ry", "rz"))]
    covariance = np.zeros((6, 6)).tolist()
    written = solution(tmp_path / "nominal", **level, free=frames, covariance=covariance)
    arm = read_solution(written)
    assert arm.trusted and checked(arm, "solution.json", force=False) is arm
    with pytest.raises(InputError, match="--plan base-and-tool"):
        checked(read_solution(solution(tmp_path / "arm", **level)), "solution.json", force=False)


# -------------------------------------------------------------------------------------------------- load and the rest


def elastic(folder, **more):
    return solution(folder, (COMPLIANT,), {COMPLIANCE: 2e-5}, **more)


def warm(folder):
    ranges = RANGE | {"temperature_c": [20.0, 30.0], "payload_kg": [0.0, 0.0]}
    return solution(
        folder, (WARM,), {"joint-3.joint-thermal-drift.per_unit": 1e-5}, fitted_range=ranges
    )


@pytest.mark.parametrize(
    ("temperature", "status", "words"),
    [
        (25, 0, ""),
        (35, 0, "temperature_c is outside 20 to 30"),
        (60, 1, "temperature_c of 60"),
        (-20, 1, "temperature_c of -20"),
    ],
)
def test_a_temperature_is_extrapolated_a_little_and_no_more(
    workbench, tmp_path, temperature, status, words
):
    warm(tmp_path / "arm")
    text = f"{JOINTS},temperature_c\n0,10,10,0,30,0,{temperature}\n"
    answer, _, _ = answer_of(workbench, tmp_path, text, status=status)
    said = " ".join(answer["warnings"] + [one["why"] for one in answer["refused"]])
    assert words in said and bool(said) == bool(words)


def test_a_column_that_the_model_reads_must_be_there(workbench, tmp_path):
    """Without it hours would be multiplied with a coefficient per kelvin."""
    warm(tmp_path / "arm")
    assert covariates_read(read_solution(tmp_path / "arm")) == {"temperature_c"}
    (tmp_path / "t.csv").write_text(f"{JOINTS},time_s\n0,10,10,0,30,0,36000\n")
    done = workbench("compensate", "arm", "t.csv")
    assert done.returncode == 2 and "column temperature_c: expected this column" in done.stderr
    assert covariates_read(read_solution(solution(tmp_path / "rigid"))) == frozenset()


def test_a_load_that_bends_the_arm_must_be_stated(workbench, tmp_path):
    """Targets without the column would count as unloaded, although the recorded arm never was."""
    elastic(tmp_path / "arm")
    (tmp_path / "t.csv").write_text(f"{JOINTS}\n0,10,10,0,30,0\n")
    done = workbench("compensate", "arm", "t.csv")
    assert done.returncode == 2
    assert "column payload_kg: expected this column" in done.stderr
    assert "(0.5 to 3 in the recording)" in done.stderr


def test_targets_are_corrected_for_the_arm_as_the_recording_left_it(workbench, tmp_path):
    """A program runs later: a joint that slipped has slipped, whether the table has no times, late or early ones."""
    slipped = {"effect": "zero-shift", "where": "joint-3", "after": 500.0}
    ranges = RANGE | {"time_s": [0.0, 1000.0], "payload_kg": [0.0, 0.0]}
    key = "joint-3.zero-shift.shift"
    solution(tmp_path / "arm", (slipped,), {key: 1e-3}, fitted_range=ranges)
    row, found = "0,10,10,0,30,0", {}
    tables = {"none": f"{JOINTS}\n{row}\n"}
    tables |= {at: f"{JOINTS},time_s\n{row},{at}\n" for at in ("900", "90000", "100")}
    for name, text in tables.items():
        answer, rows, _ = answer_of(workbench, tmp_path, text, status=0)
        found[name] = float(rows[0]["q3_deg"])
        said = " ".join(answer["warnings"])
        assert ("those at the end of it (1000 s" in said) == (name == "none")
        assert ("later than the recording" in said) == (name == "90000")
    assert found["none"] == found["900"] == found["90000"]
    assert found["100"] - found["900"] == pytest.approx(np.rad2deg(1e-3), rel=0.02)


def test_several_effects_of_one_kind_at_one_joint_are_no_obstacle(tmp_path):
    waves = [
        {"effect": "transmission-harmonic", "where": "joint-2", "order": order} for order in (1, 2)
    ]
    backlash = {"effect": "backlash", "where": "joint-4"}
    names = [
        f"joint-2.transmission-harmonic.{name}{order}"
        for name in ("cos", "sin")
        for order in (1, 2)
    ]
    changes = dict.fromkeys([*names, "joint-4.backlash.half_gap"], 1e-5)
    ranges = RANGE | {
        "approach4": [-1.0, 1.0],
        "approach3": [-1.0, 1.0],
        "temperature_c": [20.0, 30.0],
    }
    arm = read_solution(
        solution(tmp_path / "arm", [*waves, backlash], changes, fitted_range=ranges)
    )
    assert covariates_read(arm) == {"approach4"}


# ------------------------------------------------------------------------------------------ joints and uncertainty


@pytest.mark.parametrize(
    ("angle", "status", "words"),
    [(35, 0, ""), (60, 0, "q1_deg is outside -30 to 30"), (150, 1, "q1_deg of 150")],
)
def test_targets_far_from_the_recorded_joint_readings_are_refused(
    workbench, tmp_path, angle, status, words
):
    ranges = RANGE | {"q1_deg": [-30.0, 30.0]}
    solution(tmp_path / "arm", fitted_range=ranges)
    answer, _, _ = answer_of(
        workbench, tmp_path, f"{JOINTS}\n{angle},10,10,0,30,0\n", status=status
    )
    said = " ".join(answer["warnings"] + [one["why"] for one in answer["refused"]])
    assert words in said and bool(said) == bool(words)


def test_a_target_that_is_too_uncertain_is_refused(workbench, tmp_path):
    solution(tmp_path / "arm", sigma=1e-3)  # a millirad of every joint: a mm at the flange
    text = f"{JOINTS}\n0,10,10,0,30,0\n"
    answer, _, _ = answer_of(workbench, tmp_path, text)
    assert (
        "the standard uncertainty of" in answer["refused"][0]["why"]
        and "exceeds 0.15 mm" in answer["refused"][0]["why"]
    )
    answer, _, _ = answer_of(workbench, tmp_path, text, "--max-sigma-mm", "5", status=0)
    assert answer["refused"] == [] and answer["sigma_rms_mm"] > 0.15


def test_no_limit_of_uncertainty_is_above_the_error_of_the_nominal_arm(tmp_path):
    arm = read_solution(solution(tmp_path / "arm", held_out={"rms_mm": 0.6}))
    assert Limits().largest_sigma_mm(arm) == 1.0
    assert Limits(sigma_mm=2.0).largest_sigma_mm(arm) == 2.0


# ---------------------------------------------------------------------------------------------- what a solution says


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    made = scene("external-point", n=60, arm=ABB, reflectors={1: (30.0, -40.0, 100.0)}).recording
    folder = tmp_path_factory.mktemp("calibrated")
    save(calibrate(made, folds=3), folder)
    return made, folder


def test_a_solution_states_what_it_was_fitted_on(calibrated):
    made, folder = calibrated
    arm = read_solution(folder)
    for name in ("q1_deg", "payload_kg", "temperature_c", "time_s", "approach2"):
        assert arm.fitted_range[name] == (made.columns[name].min(), made.columns[name].max())
    assert "x_mm" not in arm.fitted_range and "sample" not in arm.fitted_range
    assert arm.keys["noise_rms_mm"] == pytest.approx(0.02 * 3**0.5)
    assert arm.keys["priors"]["joint-2.d2"] == 3.0


def test_an_older_solution_is_read_and_the_missing_ranges_are_said(workbench, tmp_path):
    solution(tmp_path / "arm")
    keys = json.loads((tmp_path / "arm" / "solution.json").read_text())
    for name in ("fitted_range", "priors", "noise_rms_mm"):
        del keys[name]
    (tmp_path / "arm" / "solution.json").write_text(json.dumps(keys))
    answer, _, _ = answer_of(
        workbench, tmp_path, f"{JOINTS},payload_kg\n0,10,10,0,30,0,9\n", status=0
    )
    assert any("states no ranges" in one for one in answer["warnings"])


def test_a_calibration_writes_the_noise_that_its_verdict_uses(calibrated):
    arm = read_solution(calibrated[1])
    assert arm.keys["noise"] == {"rms_mm": pytest.approx(0.02 * 3**0.5), "source": "stated"}
