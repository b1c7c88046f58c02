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


def changed(recording, name, values):
    return replace(recording, columns={**recording.columns, name: values})


@pytest.mark.parametrize("name", ["x_mm", "y_mm", "z_mm"])
def test_an_overflow_of_one_coordinate_is_named_with_its_jump(name):
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    period = np.ptp(recording.columns[name]) / 3
    values = (recording.columns[name] + period / 2) % period - period / 2
    found = wrong_coordinate_suspicion(robot, changed(recording, name, values))
    assert found.cause == "overflow"
    assert f"column {name}" in found.sentence and "jump by multiples of" in found.sentence


def test_a_coordinate_in_another_order_of_rows_is_named():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    values = np.random.default_rng(0).permutation(recording.columns["y_mm"])
    found = wrong_coordinate_suspicion(robot, changed(recording, "y_mm", values))
    assert found.cause == "coordinate-values" and "column y_mm" in found.sentence


def test_sound_points_and_wrong_joints_name_no_coordinate():
    robot, recording = erring("external-point", 3, n=70, reflectors=TARGET)
    assert wrong_coordinate_suspicion(robot, recording) is None
    joint = changed(recording, "q2_deg", -recording.columns["q2_deg"])
    assert wrong_coordinate_suspicion(robot, joint) is None


def test_a_jump_divides_all_deviations():
    assert jump_of(np.array([0.0, 1.0, 655.4, 0.5, -655.2, 1311.0])) == pytest.approx(
        655.4, abs=1.5
    )
    assert jump_of(np.array([0.0, 1.0, 655.4, 300.0, -655.2, 1311.0])) == 0.0
