"""The exported MJCF model under a recorded load: where it hangs, and where the simulation comes to rest."""

from dataclasses import replace

import numpy as np
import pytest

from export_scenes import arm_with, readings_of
from scenes import ABB
from workbench.core.errors import InputError
from workbench.files.exports.mjcf import left_out, mjcf
from workbench.files.exports.mjcf_check import check_mjcf
from workbench.jobs.robot.compensation.compensate import actual_poses

RANGES = {f"q{k}_deg": (-40.0, 40.0) for k in range(1, 7)} | {"payload_kg": (0.0, 3.0)}
ROWS = [
    ("joint-compliance", "joint-2", {}),
    ("joint-compliance", "joint-3", {}),
    ("joint-compliance", "joint-5", {}),
    ("first-moment", "tool", {}),
]
VALUES = {
    "joint-2.joint-compliance.compliance": 3e-5,
    "joint-3.joint-compliance.compliance": 5e-5,
    "joint-5.joint-compliance.compliance": 1e-4,
    "tool.first-moment.mx": -9.0,
    "tool.first-moment.my": -12.0,
    "tool.first-moment.mz": -21.0,
}


def arm_with_tool(kg):
    """An arm with a tool of `kg` whose fitted first moment is far from what its mass can make."""
    arm = replace(arm_with(ABB, ROWS, values=VALUES), fitted_range=RANGES)
    return replace(arm, robot=replace(arm.robot, payload_mass=kg))


@pytest.mark.parametrize("kg", [0.0, 0.05, 2.0])
def test_a_recorded_load_hangs_where_it_was_recorded(kg):
    pytest.importorskip("mujoco", reason="needs MuJoCo")
    from mujoco_statics import flange_at_rest

    arm = arm_with_tool(kg)
    text = mjcf(arm)
    readings = readings_of(arm.robot, 6)
    columns = {"payload_kg": np.linspace(0.0, 3.0, 6)}
    wanted = actual_poses(arm, readings, columns)
    found = flange_at_rest(text, readings, columns["payload_kg"])
    # a hundredth of the load's deflection; the load at the shifted centre of the tool made half of it
    loaded = wanted - actual_poses(arm, readings)
    allowed = 1e-3 + 0.01 * np.linalg.norm(loaded[:, :3, 3], axis=1).max()
    assert np.abs(found - wanted)[:, :3, 3].max() < allowed
    assert not left_out(arm)
    check_mjcf(arm, text)


def test_a_load_at_another_place_is_not_written():
    arm = arm_with_tool(0.05)
    elsewhere = replace(arm, load_centre=arm.load_centre + [0, 0, 200.0])
    with pytest.raises(RuntimeError, match="load"):
        check_mjcf(arm, mjcf(elsewhere))


def test_a_spring_that_is_too_soft_does_not_pass_the_simulation():
    pytest.importorskip("mujoco", reason="needs MuJoCo")
    arm = arm_with_tool(0.05)
    text = mjcf(arm)
    softer = mjcf(replace(arm, values=arm.values | {"joint-2.joint-compliance.compliance": 6e-5}))
    check_mjcf(arm, text)
    with pytest.raises(RuntimeError, match="MuJoCo at rest is"):
        check_mjcf(arm, softer)


def test_a_negative_compliance_is_refused_with_the_term_to_leave_out():
    rows = [("bearing-compliance", "joint-3", {})]
    arm = arm_with(ABB, rows, values={"joint-3.bearing-compliance.tilt": -5.8e-6})
    with pytest.raises(InputError, match="--without joint-3.bearing-compliance"):
        mjcf(arm)
