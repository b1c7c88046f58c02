"""The exported Python module refuses the targets that `workbench compensate` refuses."""

from dataclasses import replace

import numpy as np
import pytest

from export_scenes import arm_with, exported
from robot_model import load_robot
from scenes import ABB
from workbench.jobs.robot.compensation.compensate import compensate

READINGS = np.array([[0.0, 10, 10, 20, 30, 40], [20.0, -10, 15, 10, 40, 5]])
TOOL = {f"tool.{c}": 40.0 for c in "xyz"}


def arm_of(rows=(), values=None, ranges=None):
    return replace(arm_with(ABB, rows, values=TOOL | (values or {})), fitted_range=ranges)


def corrected(arm, readings, *given, **options):
    return exported(arm)["corrected_readings"](readings, *given, **options)[0]


def is_given(answer):
    """Whether each row has readings, and not only some."""
    has = np.isfinite(answer)
    assert (has.all(1) == has.any(1)).all()
    return has.all(1).tolist()


def test_a_plausible_correction_is_that_of_the_workbench():
    arm = arm_of()
    wanted = np.rad2deg(compensate(arm, np.deg2rad(READINGS)).readings)
    np.testing.assert_allclose(corrected(arm, READINGS), wanted, atol=1e-5)


@pytest.mark.parametrize("force", [False, True])
def test_targets_out_of_reach_or_limits_have_no_readings(force):
    arm = arm_of()
    module = exported(arm)
    poses = module["nominal_poses"](READINGS)
    poses[1, 0, 3] += 5000
    answer, left = module["corrected_readings"](READINGS, poses, force=force)
    assert is_given(answer) == [True, False] and left[1] > 1
    # at the two ends of joint 4 the correction leads beyond one of them
    ends = np.rad2deg(load_robot(ABB).limits[3])
    at_ends = np.repeat(READINGS[:1], 2, 0)
    at_ends[:, 3] = ends
    answer = module["corrected_readings"](at_ends, force=force)[0]
    reached = compensate(arm, np.deg2rad(at_ends)).reached
    assert is_given(answer) == reached.tolist() and sorted(reached) == [False, True]


@pytest.mark.parametrize(("key", "error"), [("joint-2.a2", 15.0), ("joint-5.theta5", 0.03)])
def test_an_implausible_correction_is_given_only_with_force(key, error):
    nominal = arm_of().values[key]
    arm = arm_of(values={key: nominal + error})
    assert is_given(corrected(arm, READINGS)) == [False, False]
    assert is_given(corrected(arm, READINGS, force=True)) == [True, True]


def test_readings_and_loads_far_outside_the_recording_are_given_only_with_force():
    ranges = {f"q{k}_deg": (-50.0, 50.0) for k in range(1, 7)} | {"payload_kg": (0.0, 2.0)}
    arm = arm_of([("joint-compliance", "joint-2", {})], ranges=ranges)
    far = READINGS.copy()
    far[1, 0] = 155.0
    none = {"payload_kg": [1.0, 1.0]}
    assert is_given(corrected(arm, far, None, none)) == [True, False]
    loads = {"payload_kg": [3.0, 9.0]}
    assert is_given(corrected(arm, READINGS, None, loads)) == [True, False]
    assert is_given(corrected(arm, far, None, loads, force=True)) == [True, True]
