"""One coordinate that does not belong to the joint readings is named, and a number format that overflows."""

from dataclasses import replace

import numpy as np
import pytest

from erring_scenes import erring
from workbench.fitting.plausibility.joint_columns.single_coordinate import (
    jump_of,
    wrong_coordinate_suspicion,
)

TARGET = {1: (60.0, 40.0, 90.0)}
GOOD_MM = 0.5


def changed(recording, name, values):
    return replace(recording, columns={**recording.columns, name: values})


@pytest.mark.parametrize("name", ["x_mm", "y_mm", "z_mm"])
def test_an_overflow_of_one_coordinate_is_named_with_its_jump(name):
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    period = np.ptp(recording.columns[name]) / 3
    values = (recording.columns[name] + period / 2) % period - period / 2
    found = wrong_coordinate_suspicion(robot, changed(recording, name, values), GOOD_MM)
    assert found.cause == "overflow"
    assert f"column {name}" in found.sentence and "jump by multiples of" in found.sentence


def test_a_coordinate_in_another_order_of_rows_is_named():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    values = np.random.default_rng(0).permutation(recording.columns["y_mm"])
    found = wrong_coordinate_suspicion(robot, changed(recording, "y_mm", values), GOOD_MM)
    assert found.cause == "coordinate-values" and "column y_mm" in found.sentence


def test_sound_points_and_wrong_joints_name_no_coordinate():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    assert wrong_coordinate_suspicion(robot, recording, GOOD_MM) is None
    joint = changed(recording, "q2_deg", -recording.columns["q2_deg"])
    assert wrong_coordinate_suspicion(robot, joint, GOOD_MM) is None


def test_a_jump_divides_all_deviations():
    assert jump_of(np.array([0.0, 1.0, 655.4, 0.5, -655.2, 1311.0])) == pytest.approx(
        655.4, abs=1.5
    )
    assert jump_of(np.array([0.0, 1.0, 655.4, 300.0, -655.2, 1311.0])) == 0.0
    assert jump_of(np.array([0.0, 1.0, 655.4, 656.1])) == pytest.approx(655.4, abs=1.5)


def test_jumps_that_leave_the_values_in_a_wide_range_are_no_overflow():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    is_raised = np.random.default_rng(2).random(recording.n) < 0.5
    values = recording.columns["z_mm"] + np.ptp(recording.columns["z_mm"]) * is_raised
    found = wrong_coordinate_suspicion(robot, changed(recording, "z_mm", values), GOOD_MM)
    assert found.cause == "coordinate-values"
    assert "jump by multiples of" in found.sentence and "overflow" not in found.sentence


def test_points_at_one_height_fit_no_joint_reading_and_are_not_wrong():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    noise = np.random.default_rng(2).normal(0, 0.02, recording.n)
    level = changed(recording, "z_mm", 300 + noise)
    assert wrong_coordinate_suspicion(robot, level, GOOD_MM) is None
    off = changed(recording, "z_mm", 300 + 100 * noise)
    assert "column z_mm" in wrong_coordinate_suspicion(robot, off, GOOD_MM).sentence
