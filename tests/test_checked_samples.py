"""No command accepts a recording that another one refuses, and --trust-data overrides all of them alike."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import datasets
from conftest import ROOT
from datasets.trust import TRUST_DATA
from erring_scenes import erring
from robot_model.effects import CATALOGUE
from workbench.core.errors import InputError
from workbench.explanation.answer import diagnose
from workbench.fitting.calibration_plans.plans import geometry
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.named_rows import _is_enough
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.compare import compare
from workbench.jobs.robot.identify import identifiability
from workbench.jobs.robot.poses import choose_poses

# they take samples, but of a recording that was checked, only its joint readings, or to judge the recording
UNCHECKED = {
    "app/data/places.py",
    "app/data/prediction.py",
    "explanation/comparison/differences.py",
    "explanation/comparison/reference.py",
    "explanation/term_steps.py",
    "fitting/plausibility/robot_files/far_geometry.py",
    "fitting/verdicts/diagnosis_verdict.py",
    "jobs/robot/evaluate.py",  # checks them, and states the errors of all rows, faulty ones included
    "jobs/robot/poses.py",
    "jobs/robot/significance.py",
    "recordings/importing/calculated_points.py",
    "recordings/importing/final_check.py",
    "recordings/importing/interpretation/decisions.py",
    "recordings/inspection/needs.py",
    "report/planning/identifiability.py",
    "report/planning/poses.py",
}
COMMANDS = ("calibrate", "compare", "diagnose", "identifiability", "poses", "calibrate-large")


@pytest.fixture(scope="module")
def negated():
    """A recording whose third joint has the opposite sign."""
    robot, recording = erring("external-pose", 1, n=60)
    columns = {**recording.columns, "q3_deg": -recording.columns["q3_deg"]}
    return robot, replace(recording, columns=columns)


@pytest.mark.parametrize(
    "use",
    [
        lambda recording: calibrate(recording, folds=3),
        diagnose,
        lambda recording: compare(recording, ["default"], folds=3),
        identifiability,
        lambda recording: choose_poses(recording, 10),
    ],
    ids=["calibrate", "diagnose", "compare", "identifiability", "poses"],
)
def test_every_analysis_refuses_the_same_recording(negated, use):
    with pytest.raises(InputError) as caught:
        use(negated[1])
    sentence = str(caught.value)
    assert (
        "column q3_deg" in sentence
        and TRUST_DATA in sentence
        and sentence.endswith(".")
        and "\n" not in sentence
    )


def test_trusted_data_are_used_with_a_warning(negated):
    robot, recording = negated
    checked = check_samples(recording, trust_data=True)
    (doubt,) = checked.suspicions
    assert "column q3_deg" in doubt and f"accepted because of {TRUST_DATA}" in doubt
    made = calibrate(recording, [geometry(robot)], folds=3, trust_data=True)
    assert made.as_json()["warnings"][0] == doubt and made.suspicions == (doubt,)
    assert identifiability(recording, trust_data=True)["warnings"] == [doubt]
    assert choose_poses(recording, 10, trust_data=True).as_json()["warnings"] == [doubt]


def test_faulty_single_rows_are_a_warning_and_no_doubt_about_the_recording():
    _, recording = erring("external-pose", 1, n=60)
    x = recording.columns["x_mm"].copy()
    x[[7, 23]] += 40.0
    checked = check_samples(replace(recording, columns={**recording.columns, "x_mm": x}))
    assert checked.suspicions == ()
    assert "samples 8 and 24" in checked.warnings[0]


def _with_wrong_rows(recording, rows, size_mm=40.0):
    """Rows off by their own amounts in x, so that nothing but gross errors explains them."""
    x = recording.columns["x_mm"].copy()
    x[rows] += size_mm * np.random.default_rng(3).uniform(1, 2, len(rows))
    return replace(recording, columns={**recording.columns, "x_mm": x})


def test_a_calibration_leaves_out_the_rows_that_the_check_names():
    robot, right = erring("external-pose", 1, n=60)
    rows = np.arange(5, 60, 7)  # more than the twentieth that counts as blunders after the fit
    wrong = _with_wrong_rows(right, rows)
    clean = calibrate(right, [geometry(robot)], folds=3)
    made = calibrate(wrong, [geometry(robot)], folds=3)
    assert set(made.suspects) == set(wrong.sample_ids[rows].tolist())
    assert made.suspicions == () and made.held_out["rms_mm"] < 1.5 * clean.held_out["rms_mm"]
    said = next(text for text in made.warnings if "leaves them out" in text)
    assert "8 of 60 rows are off" in said and f"sample{'s'} {wrong.sample_ids[5]}" in said
    kept = calibrate(wrong, [geometry(robot)], folds=3, trust_data=True)
    assert kept.held_out["rms_mm"] > 10 * made.held_out["rms_mm"]


def test_never_more_than_a_quarter_of_the_rows_is_left_out():
    _, right = erring("external-pose", 1, n=60)
    checked = check_samples(_with_wrong_rows(right, np.arange(0, 60, 3)), without_wrong_rows=True)
    assert checked.left_out == () and any("rows are off" in text for text in checked.warnings)


def test_rows_of_which_no_other_of_their_target_remains_are_not_left_out():
    recording = erring("external-pose", 1, n=60)[1]
    columns = {**recording.columns, "reflector": np.r_[np.ones(54), np.full(6, 2.0)]}
    labelled = replace(recording, columns=columns)
    keep = np.arange(60) < 54
    assert not _is_enough(labelled, keep) and _is_enough(recording, keep)


def test_only_rows_that_are_fitted_are_checked(negated):
    """The last rows are in doubt, and tested only."""
    _, wrong = negated
    _, right = erring("external-pose", 1, n=60)
    late = np.arange(60) >= 40
    columns = {
        name: np.where(late, wrong.columns[name], column) for name, column in right.columns.items()
    }
    mixed = replace(right, columns=columns)
    assert check_samples(mixed, test_samples=mixed.sample_ids[late]).suspicions == ()


def test_implausible_units_are_read_with_the_option(tmp_path):
    _, recording = erring("external-point", 5, n=20)
    joints = {f"q{k}_deg": np.deg2rad(recording.columns[f"q{k}_deg"]) for k in range(1, 7)}
    folder = datasets.write(
        replace(recording, columns={**recording.columns, **joints}), tmp_path / "cell-4"
    )
    with pytest.raises(InputError, match=TRUST_DATA):
        datasets.read(folder)
    (warning,) = datasets.read(folder, trust_data=True).warnings
    assert "radians" in warning and f"accepted because of {TRUST_DATA}" in warning


def test_no_module_takes_samples_without_the_check():
    """`samples_of` gives rows that nobody looked at."""
    found = set()
    for path in (ROOT / "workbench").rglob("*.py"):
        if re.search(r"\bsamples_of\(", path.read_text(encoding="utf-8")):
            found.add(path.relative_to(ROOT / "workbench").as_posix())
    assert found == {*UNCHECKED, "fitting/checked_samples.py"}


def test_every_command_that_may_refuse_names_the_option(workbench):
    for command in (*COMMANDS, "evaluate"):
        assert TRUST_DATA in workbench(command, "--help").stdout, command


@pytest.mark.slow
def test_commands_refuse_with_status_2_and_warn_with_the_option(negated, tmp_path, workbench):
    _, recording = negated
    datasets.write(recording, tmp_path / "cell", samples="parquet")
    more = {
        "compare": ("--plan", "default"),
        "poses": ("--count", "10"),
        "calibrate": ("--no-report",),
        "diagnose": ("--no-report",),
    }
    for command in COMMANDS:
        words = (command, "cell", *more.get(command, ()), "--json", "-")
        refused = workbench(*words)
        assert refused.returncode == 2 and TRUST_DATA in refused.stderr, (command, refused.stderr)
        trusted = workbench(*words, TRUST_DATA)
        assert trusted.returncode in (0, 1), (command, trusted.stderr)
        assert any(TRUST_DATA in warning for warning in json.loads(trusted.stdout)["warnings"]), (
            command
        )
        assert TRUST_DATA in " ".join(trusted.stderr.split()), command
        if command == "calibrate":
            sentence = json.loads(trusted.stdout)["verdict"]["sentence"]
            assert "the recording is in doubt" in sentence


def test_a_jump_that_the_model_makes_is_no_doubt_about_it():
    """A tool that slipped, found and modelled, does not keep its model from being used; another jump does."""
    robot, recording = erring("external-point", 3, n=60)
    time = {"time_s": 10.0 * np.arange(60)}
    checked = check_samples(replace(recording, columns={**recording.columns, **time}))
    jumped = replace(checked, suspicions=("it moved", "other"), jumps={"it moved": (30, 31)})

    def doubts(*effects):
        return jumped.warnings_about(SimpleNamespace(effects=effects))

    assert doubts() == ("it moved", "other")
    assert doubts(CATALOGUE["joint-compliance"]("joint-2")) == ("it moved", "other")
    assert doubts(CATALOGUE["shift"]("tool", after=295.0)) == ("other",)
    assert doubts(CATALOGUE["shift"]("tool", after=100.0)) == ("it moved", "other")
