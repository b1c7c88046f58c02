"""Why a target has no readings: the joint that is named for slides, seven axes, and targets without readings."""

import numpy as np

from export_scenes import arm_with
from scenes import ABB
from test_fewer_joints import SCARA, TOOL, _joint, calibrated
from workbench.jobs.robot.compensation import unattainable
from workbench.jobs.robot.compensation.compensate import (
    actual_poses,
    compensate,
    negligible_mm,
    nominal_poses,
)
from workbench.jobs.robot.compensation.singularity import singular_joint
from workbench.jobs.robot.compensation.unattainable import _explained, unattainable_targets

SEVEN = {
    "name": "seven",
    "convention": "distal",
    "joint": [
        _joint(0, -90, d=340),
        _joint(0, 90),
        _joint(0, 90, d=400),
        _joint(0, -90),
        _joint(0, -90, d=400),
        _joint(0, 90),
        _joint(0, 0, d=126),
    ],
}


def arm_of(robot):
    values = {f"tool.reflector1_{axis}": value for axis, value in zip("xyz", TOOL)}
    return arm_with(robot, (), 3, values)


def moved_out(pose, centre, length):
    """The poses (1, 4, 4) `length` mm farther from a point."""
    away = pose[0, :3, 3] - centre
    out = pose.copy()
    out[0, :3, 3] += length * away / np.linalg.norm(away)
    return out


def test_a_slide_is_not_taken_for_a_singular_joint():
    """Millimetres per millimetre are not millimetres per radian."""
    arm, bent = calibrated(SCARA), np.array([0.3, 1.0, 100.0, 0.5])
    assert _explained(arm, 0, bent, nominal_poses(arm.robot, bent[None])[0], {}).joint is None


def test_the_elbow_of_seven_axes_is_named():
    """The motion that seven axes leave to themselves is not the one that is missing."""
    arm, stretched = arm_of(SEVEN), np.array([[0.3, 0.8, 0.2, 0.001, 0.4, 0.7, 0.1]])
    wanted = moved_out(nominal_poses(arm.robot, stretched), [0, 0, 340], 2.0)
    found = compensate(arm, stretched, wanted)
    (one,) = unattainable_targets(arm, stretched, found, None)
    assert one.joint == 4 and one.distance_mm < 3


def test_a_target_far_away_needs_no_calibrated_model(monkeypatch):
    arm, bent = arm_of(SEVEN), np.array([[0.3, 0.8, 0.2, 0.7, 0.4, 0.7, 0.1]])
    far = moved_out(nominal_poses(arm.robot, bent), [0, 0, 340], 2000.0)
    monkeypatch.setattr(unattainable, "actual_poses", None)
    assert 1000 < _explained(arm, 0, bent[0], far[0], {}).distance_mm < 2000


def test_targets_without_readings_are_judged_where_they_are_nearly_attained():
    arm = arm_of(ABB)
    forearm, offset = arm.robot.geometry[3, 1], arm.robot.geometry[2, 2]
    elbow = -np.arctan2(forearm, offset)
    stretched = np.array([[0.1, 0.5, elbow, 0.4, 0.9, 0.2]])
    poses = nominal_poses(arm.robot, stretched)
    shoulder = np.array([0, 0, 290.0]) + 72 * poses[0, :3, 2]
    home = arm.robot.limits.mean(1)[None]
    found = compensate(arm, home, moved_out(poses, shoulder, 3.0), None, True)
    (one,) = unattainable_targets(arm, home, found, None)
    assert one.joint == 3 and one.distance_mm < 4


def test_joint_5_of_aligned_wrist_axes_is_named():
    """Joints 4 and 6 make the motion that leaves the flange in place; joint 5 leads out of the singularity."""
    arm = arm_of(ABB)
    assert singular_joint(arm.robot, np.array([0.1, 0.4, 0.3, 0.5, 0.0, 0.2])) == 5
    stretched = np.array(
        [0.1, 0.5, -np.arctan2(arm.robot.geometry[3, 1], arm.robot.geometry[2, 2])]
    )
    assert singular_joint(arm.robot, np.array([*stretched, 0.4, 0.9, 0.2])) == 3
    assert singular_joint(arm.robot, np.array([0.1, 0.4, 0.3, 0.5, 0.9, 0.2])) is None


def test_an_error_below_the_uncertainty_is_no_reason_to_refuse():
    """A stretched arm that misses its target by a third of the negligible error, and by six times that error."""
    arm = arm_of(ABB)
    elbow = -np.arctan2(arm.robot.geometry[3, 1], arm.robot.geometry[2, 2])
    stretched = np.array([[0.1, 0.5, elbow, 0.4, 0.9, 0.2]])
    poses = actual_poses(arm, stretched)
    shoulder = np.array([0, 0, 290.0]) + 72 * poses[0, :3, 2]
    allowed = negligible_mm(compensate(arm, stretched).uncertainty_mm)[0]
    for factor, is_reached in ((0.3, True), (6.0, False)):
        found = compensate(arm, stretched, moved_out(poses, shoulder, factor * allowed))
        assert found.reached[0] == is_reached, (factor, allowed, found.left_mm)
