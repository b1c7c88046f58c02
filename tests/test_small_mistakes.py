"""A joint of the other sign whose axis nearly carries the measured point is named; sound arms are not suspected."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.samples.columns import POINT
from erring_scenes import erring
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.joint_columns.small_mistakes import untested_signs
from workbench.recordings.inspection import inspect_recording

NEAR_THE_AXIS = {1: (0.4, 0.3, 60.0)}
ON_THE_AXIS = {1: (0.002, 0.0, 60.0)}


def near_axis(seed, reflectors=NEAR_THE_AXIS, **more):
    """Robot and recording of a reflector on or near the axis of the last joint."""
    return erring("external-point", seed, reflectors=reflectors, **more)


def negated(recording, name="q6_deg"):
    return replace(recording, columns={**recording.columns, name: -recording.columns[name]})


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_reversed_joint_that_hardly_moves_the_point_is_named(seed):
    robot, recording = near_axis(seed)
    found = check_plausibility(robot, negated(recording))
    assert [one.cause for one in found] == ["joint-sign"], found
    assert not found[0].certain
    assert "column q6_deg" in found[0].sentence and "opposite sign" in found[0].sentence


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_right_sign_is_not_suspected(seed):
    robot, recording = near_axis(seed)
    assert check_plausibility(robot, recording) == ()
    assert untested_signs(robot, recording) == []


def test_without_a_stated_noise_a_small_mistake_is_named_too():
    robot, recording = near_axis(1)
    found = check_plausibility(robot, negated(replace(recording, sigma_mm=None)))
    assert [one.cause for one in found] == ["joint-sign"]


def test_a_sign_that_the_data_do_not_test_is_named_by_check():
    robot, recording = near_axis(4, ON_THE_AXIS, lengths=0.002, degrees=0.0005)
    assert check_plausibility(robot, negated(recording)) == ()
    (one,) = untested_signs(robot, recording)
    assert one.correction.touches == {"q6_deg"}
    needs = [need for need in inspect_recording(recording).needs if "sign" in need.what]
    assert len(needs) == 1 and "q6_deg" in needs[0].what and not needs[0].is_required
    assert "joint 6" in needs[0].action


@pytest.mark.parametrize("measures", ["external-point", "ball-centre", "external-pose"])
def test_signs_of_a_sound_recording_are_tested(measures):
    robot, recording = erring(measures, 5)
    assert untested_signs(robot, recording) == []
    needs = inspect_recording(recording).needs
    assert not any("sign to be tested" in need.what for need in needs)


STEPS = [(1.0, "multiples of 1 mm"), (0.1, "multiples of 0.1 mm"), (0.254, "multiples of 0.01 in")]


@pytest.mark.parametrize("step_mm, words", STEPS)
def test_rounded_points_are_named_with_their_step(step_mm, words):
    robot, recording = erring("external-point", 5, n=60)
    points = {name: step_mm * np.round(recording.columns[name] / step_mm) for name in POINT}
    rounded = replace(recording, columns={**recording.columns, **points}, sigma_mm=None)
    (found,) = check_plausibility(robot, rounded)
    assert found.cause == "point-rounding" and not found.is_doubt
    assert words in found.sentence and "x_mm, y_mm and z_mm" in found.sentence
    predicted = step_mm / 2  # three coordinates of step / sqrt(12)
    assert f"{predicted:.2g} mm RMS" in found.sentence


def test_digits_that_the_noise_hides_are_no_rounding():
    """Points with two decimals of an instrument whose noise is many times larger."""
    robot, recording = erring("external-point", 5, n=60, sigma=0.05)
    points = {name: np.round(recording.columns[name], 2) for name in POINT}
    assert check_plausibility(robot, replace(recording, columns=points | _joints(recording))) == ()


def _joints(recording):
    return {name: cells for name, cells in recording.columns.items() if name not in POINT}
