"""Recordings that determine little: every command ends in a result that says so, or in one sentence.

Numpy's warnings are errors here: a division by zero that happens to be caught later is still a number nobody knows.
"""

import json
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from conftest import mostly_slow
from degenerate_scenes import Case, draw, recording
from robot_model import load_robot
from robot_model.measurements import end_recordings, samples_of
from workbench.core.errors import InputError
from workbench.explanation.answer import diagnose
from workbench.files.solution_file import read_solution, solution_keys
from workbench.fitting import checked_samples
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.compare import compare
from workbench.jobs.robot.compensation.compensate import compensate
from workbench.jobs.robot.identify import identifiability
from workbench.jobs.robot.poses import CRITERIA, choose_poses
from workbench.jobs.robot.significance import significance

FAST, SLOW, A_TEST = 30, 520, 10
DIAGNOSED = 60


@pytest.fixture(autouse=True)
def numpy_warnings_are_errors():
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def not_finite(value, path="") -> list[str]:
    """Paths of all numbers in a JSON object that are not finite."""
    if isinstance(value, dict):
        return [
            found for key, inner in value.items() for found in not_finite(inner, f"{path}.{key}")
        ]
    if isinstance(value, list | tuple):
        return [found for inner in value for found in not_finite(inner, f"{path}[]")]
    return [path] if isinstance(value, float) and not math.isfinite(value) else []


def check_sentence(problem: InputError):
    text = str(problem)
    assert text.endswith(".") and "\n" not in text and 20 < len(text) < 1200, text


def check_calibration(found):
    """What is called identifiable has a finite positive sigma; what is not has none, and a reason."""
    result = found.as_json()
    assert not not_finite(result), not_finite(result)
    for row in result["parameters"]:
        if row["identifiable"]:
            assert row["std"] is not None and row["std"] > 0, row
        else:
            assert row["std"] is None and row["why"], row
    open_ones = [row for row in result["parameters"] if row["free"] and not row["identifiable"]]
    assert not open_ones or result["undetermined"] or found.solution.redundancy <= 0, open_ones


def check_compensated(made, folder):
    """Corrections of the calibrated arm's own readings are finite, with a sigma, or are not reached."""
    path = folder / "solution.json"
    path.write_text(json.dumps(solution_keys(made)), encoding="utf-8")
    arm = read_solution(path)
    rows = slice(0, 4)
    covariates = {name: column[rows] for name, column in made.recording.covariates.items()}
    found = compensate(arm, made.recording.joints[rows], covariates=covariates)
    assert np.isfinite(found.sigma_mm).all() and np.isfinite(found.correction_mm).all()
    assert (np.isfinite(found.readings).all(1) == found.reached).all()


def judge(case: Case, folder) -> list[str]:
    """What went wrong with a case, by command; three in four without the search for mistakes in the data.

    That search has tests of its own, and takes most of the time where nothing fits.
    """
    with pytest.MonkeyPatch.context() as patch:
        if case.seed % 4:
            patch.setattr(checked_samples, "check_plausibility", lambda robot, samples: ())
        return _judged(case, folder)


def _judged(case, folder):
    try:
        made = recording(case)
    except InputError as problem:
        check_sentence(problem)
        return []
    criterion = CRITERIA[case.seed // 3 % len(CRITERIA)]
    tasks = made if criterion == "task" else None
    readings = np.concatenate([end.joints for end in end_recordings(samples_of(made))])
    commands = {
        "calibrate": lambda: check_both(case, made, folder),
        "significance": lambda: significance(
            load_robot(made.robot), points=4, readings=readings
        ).as_json(),
    }
    if case.seed % 3 == 0:
        commands["identifiability"] = lambda: identifiability(made, trust_data=True)
    if case.seed % 3 == 1:
        commands["poses"] = lambda: choose_poses(
            made, 3, criterion, tasks, trust_data=True
        ).as_json()
    if case.seed % 25 == 0:
        plans = ["default", "geometry-compliance-bending"]
        commands["compare"] = lambda: compare(made, plans, folds=2, trust_data=True).as_json()
    return [found for name, run in commands.items() if (found := failure(name, run, case))]


def check_both(case, made, folder):
    found = calibrate(made, folds=2, trust_data=case.seed % 4 != 0)
    check_calibration(found)
    check_compensated(found, folder)
    return {}


def failure(name, run, case) -> str:
    """The failure of one command in words, "" where it ended as it should."""
    try:
        wrong = not_finite(run())
        return f"{name}: not finite: {wrong[:3]} {case}" if wrong else ""
    except InputError as problem:
        check_sentence(problem)
        return ""
    except Exception as problem:
        return f"{name}: {type(problem).__name__}: {problem} {case}"


@pytest.mark.parametrize("seed", mostly_slow(range(FAST), 10, 8))
def test_a_recording_that_determines_little_ends_in_a_result_or_in_a_sentence(seed, tmp_path):
    assert judge(draw(seed), tmp_path) == []


def in_parts(first: int, end: int, size: int) -> list:
    """First seeds of parts of so many seeds."""
    return list(range(first, end, size))


@pytest.mark.long
@pytest.mark.parametrize("first", in_parts(FAST, FAST + SLOW, A_TEST))
def test_hundreds_of_recordings_that_determine_little(first, tmp_path):
    assert [
        found for seed in range(first, first + A_TEST) for found in judge(draw(seed), tmp_path)
    ] == []


@pytest.mark.parametrize("first", mostly_slow(in_parts(0, DIAGNOSED, 6), 0, 1))
def test_a_diagnosis_of_such_recordings(first):
    assert [found for seed in range(first, first + 6) if (found := diagnosed(draw(seed)))] == []


def diagnosed(case: Case) -> str:
    """The failure of a diagnosis in words, "" where it ended as it should."""
    try:
        made = recording(case)
    except InputError:
        return ""
    return failure("diagnose", lambda: diagnose(made, trust_data=True).as_json(), case)


CONSTANT = Case("ball-centre", held=(3,), seed=1)
STILL_WRIST = Case("external-point", held=(3, 4, 5), targets=1, sigma_mm=1e-12, seed=2)
EXACT = {
    "one joint stands still": CONSTANT,
    "the wrist stands still, stated sigma far below rounding": STILL_WRIST,
    "all poses within a hundredth of a degree": Case("external-pose", region_deg=0.01, seed=3),
    "few poses, each five times, to the last digit": Case(
        "external-point", count=30, copies=5, identical=True, noise=0.0, seed=4
    ),
    "lengths of an arm without lengths": Case(
        "distance", arm="no length", on_axis=True, targets=1, seed=5
    ),
    "coordinates of kilometres": Case(
        "external-point", arm="nine joints", scale=1e6, sigma_mm=1e-12, seed=6
    ),
    "points on one line": Case("external-point", path="line", targets=1, on_axis=True, seed=7),
    "a touched point, hardly moved from": Case(
        "touch-point", region_deg=0.01, targets=1, sigma_mm=1e-12, seed=8
    ),
}


@pytest.mark.parametrize("name", mostly_slow(EXACT, 3))
def test_what_such_recordings_leave_undetermined_is_named(name, tmp_path):
    """Identifiability says in sentences what a constant joint, a small region or a lone reflector leaves open."""
    made = recording(EXACT[name])
    stages = identifiability(made, trust_data=True)["stages"]
    geometry = stages[0]
    assert geometry["identifiable"] < geometry["free"] and geometry["undetermined"]
    assert judge(EXACT[name], tmp_path) == []


def test_a_joint_that_stands_still_leaves_less_determined():
    """Links on both sides of it are then one: fewer parameters, and the sentences name some of theirs."""
    still, moving = (
        identifiability(recording(replace(CONSTANT, held=held)))["stages"][0] for held in ((3,), ())
    )
    assert still["identifiable"] < moving["identifiable"]
    assert any("joint 4" in words for words in still["undetermined"])


def test_a_stated_sigma_of_zero_is_a_sentence():
    """In memory too, where no reader has looked at it."""
    made = recording(Case("external-point", seed=9))
    columns = {**made.columns, "sigma_mm": np.where(np.arange(made.n) == 2, 0.0, 0.02)}
    with pytest.raises(InputError, match="standard deviation .* above 0"):
        calibrate(replace(made, columns=columns))


def test_a_diagnosis_of_three_poses_is_a_sentence():
    with pytest.raises(InputError, match="4 or more distinct poses"):
        diagnose(recording(Case("external-point", count=3, seed=5)))
