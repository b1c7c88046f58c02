"""Mistakes of daily work in recordings that the other tables do not use: the cause is named, and no sound one is doubted."""

from dataclasses import replace

import numpy as np
import pytest

import user_error_changes as changes
from robot_model import load_robot
from test_user_errors import assert_right_cause
from user_errors_further import FURTHER, WHOLE, unused
from workbench.fitting.plausibility import check_plausibility

NAMED = {mistake.name: mistake for mistake in (*FURTHER, *WHOLE)}
POINTS = "ur5e external-point"
OF_GROUPS = (
    "another tool in every second block",
    "first 40 % in radians",
    "one measured axis frozen",
    "x and y swapped in the last 40 %",
)


def recording_with(name: str):
    return NAMED[name].make(unused(POINTS))


@pytest.mark.parametrize("name", ["minus signs of one joint lost", "positions rounded to 0.1 mm"])
def test_a_mistake_of_many_rows_is_named(name):
    assert_right_cause(NAMED[name], unused(POINTS))


def test_lost_signs_are_stated_with_the_column():
    wrong = recording_with("minus signs of one joint lost")
    (found,) = check_plausibility(load_robot(wrong.robot), wrong)
    column = changes.inner(wrong, 0)
    assert f"opposite sign in column {column}" in found.sentence
    assert "no value of the other sign" in found.sentence
    rows = set(np.flatnonzero(unused(POINTS).columns[column] < -1))
    assert rows <= set(found.rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_GROUPS)
def test_a_group_of_rows_with_a_mistake_in_common_is_named(name):
    assert_right_cause(NAMED[name], unused(POINTS))


@pytest.mark.parametrize("change", WHOLE, ids=lambda change: change.name)
def test_a_change_that_is_no_mistake_raises_no_alarm(change):
    recording = change.make(unused(POINTS))
    assert check_plausibility(load_robot(recording.robot), recording) == ()


def test_gross_errors_have_no_common_motion():
    from workbench.fitting.plausibility.fitting import fit_recording
    from workbench.fitting.plausibility.rows.row_groups import another_frame

    sound = unused(POINTS)
    rows = np.arange(0, sound.n, 12)
    points = sound.points.copy()
    points[rows] += np.random.default_rng(5).normal(size=(len(rows), 3)) * 40
    wrong = replace(sound, columns={**sound.columns, **dict(zip(changes.POINT, points.T))})
    robot = load_robot(wrong.robot)
    assert another_frame(robot, wrong, fit_recording(robot, wrong), rows, 0.3) is None


def test_readings_with_one_component_of_the_wrong_sign_have_a_correction():
    from workbench.fitting.plausibility.hypotheses.point_corrections import point_corrections

    sound = unused("kuka_kr10 external-pose")
    wrong = changes.changed(sound, qz=-sound.columns["qz"])
    signs = [one for one in point_corrections(wrong) if one.cause == "quaternion-sign"]
    assert len(signs) == 6
    corrected = [one.apply(load_robot(wrong.robot), wrong)[1].columns for one in signs]
    names = ("qw", "qx", "qy", "qz")
    right = [all(np.array_equal(c[n], sound.columns[n]) for n in names) for c in corrected]
    assert right.count(True) == 1


def test_a_joint_at_rest_in_most_rows_is_not_the_reason_of_a_few_outliers():
    from workbench.fitting.plausibility.fitting import fit_recording, row_mismatch
    from workbench.fitting.plausibility.rows.outliers import Outliers, outlier_reason

    sound = unused(POINTS)
    first = np.where(np.arange(sound.n) < 20, sound.columns["q1_deg"], sound.columns["q1_deg"][20])
    robot, resting = load_robot(sound.robot), changes.changed(sound, q1_deg=first)
    fit = fit_recording(robot, resting)
    mismatch = row_mismatch(robot, resting, fit)
    few = Outliers(np.array([30, 60, 90, 120]), mismatch, 0.05)
    assert outlier_reason(robot, resting, fit, few).cause != "stuck-encoder"
    many = Outliers(np.arange(25, sound.n), mismatch, 0.05)
    assert outlier_reason(robot, resting, fit, many).cause == "stuck-encoder"
