"""Corrections of arms that cannot move their tool in all six directions: position first, then orientation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from export_scenes import arm_with, exported
from robot_model import load_robot
from robot_model.postures.task_priority import LEVER_MM, Task
from robot_model.tool_points import corrected_point_name
from scenes import ABB, CRAIG, SLIDING
from workbench.jobs.robot.compensation.compensate import actual_poses, compensate, nominal_poses
from workbench.jobs.robot.compensation.unattainable import left_by_joints

TOOL = np.array([25.0, 10.0, -60.0])


def _joint(a=0.0, alpha=0.0, d=0.0, limits=(-130, 130), **more):
    slides = more.get("kind") == "prismatic"
    key = "limits_mm" if slides else "limits_deg"
    row = {"theta_deg": 0.0, "d_mm": float(d), "a_mm": float(a), "alpha_deg": float(alpha)}
    return row | {key: [float(end) for end in limits]} | more


SCARA = {
    "name": "scara",
    "convention": "distal",
    "joint": [
        _joint(325, d=400),
        _joint(275, 180, limits=(-145, 145)),
        _joint(d=50, kind="prismatic", limits=(0, 200)),
        _joint(limits=(-350, 350)),
    ],
}
PALLETISER = {
    "name": "four joints, the third coupled",
    "convention": "distal",
    "joint": [
        _joint(150, -90, d=500),
        _joint(700),
        _joint(600, coupled={"joint": 2, "ratio": -1.0}),
        _joint(80),
    ],
}
FIVE = {
    "name": "five joints",
    "convention": "distal",
    "joint": [_joint(50, -90, d=300), _joint(400), _joint(350), _joint(0, -90), _joint(d=80)],
}
PLANAR = {"name": "planar", "convention": "distal", "joint": [_joint(400), _joint(300), _joint(9)]}
RANKS = {"scara": (3, 1), "palletiser": (3, 1), "five": (3, 2), "planar": (2, 1)}
SPECS = {"scara": SCARA, "palletiser": PALLETISER, "five": FIVE, "planar": PLANAR}


def calibrated(spec, seed=3):
    return arm_with(spec, (), seed, {f"tool.reflector1_{c}": v for c, v in zip("xyz", TOOL)})


def bent(arm, n=10):
    """(n, R) rad, mm: readings away from the limits and from a stretched elbow."""
    low, high = arm.robot.limits.T
    rng = np.random.default_rng(5)
    return rng.uniform(0.6 * high + 0.4 * low, 0.85 * high + 0.15 * low, (n, len(low)))


def error_of(arm, readings, wanted):
    """(6,) mm and rad of one target, at the tool point, from plain matrices."""
    actual = actual_poses(arm, readings[None])[0]
    place = (actual - wanted)[:3] @ np.append(TOOL, 1.0)
    turn = Rotation.from_matrix(actual[:3, :3] @ wanted[:3, :3].T).as_rotvec()
    return np.concatenate([place, turn])


def best_readings(arm, start, wanted):
    """(R,) rad, mm, by an independent solver that weights the position so highly that it comes first."""
    weights = np.repeat([1e4, 1.0], 3)
    sizes = np.where(arm.robot.prismatic, 100.0, 1.0)
    return least_squares(
        lambda q: weights * error_of(arm, q, wanted), start, x_scale=sizes, xtol=1e-15, ftol=1e-15
    ).x


@pytest.mark.parametrize("case", SPECS)
def test_the_position_is_reached_and_the_orientation_is_the_best_of_all_readings(case):
    arm = calibrated(SPECS[case])
    assert Task.of(arm.robot, arm.values).ranks == RANKS[case]
    readings = bent(arm)
    wanted = nominal_poses(arm.robot, readings)
    done = compensate(arm, readings)
    assert done.reached.all() and done.is_deficient and not done.beyond_limits.any()
    assert done.rotation_left_deg.max() > 1e-3  # the part that no joint moves
    assert case == "planar" or done.position_left_mm.max() < 1e-4
    if case == "planar":
        # the tilt of its calibrated axes moves the tool out of the plane by far too little to be of use
        in_plane = [error_of(arm, q, pose)[:2] for q, pose in zip(done.readings, wanted)]
        assert np.abs(in_plane).max() < 1e-3 < done.position_left_mm.min()
        return
    for k in range(3):
        own = error_of(arm, done.readings[k], wanted[k])
        best = error_of(arm, best_readings(arm, readings[k], wanted[k]), wanted[k])
        assert np.linalg.norm(own[:3]) < np.linalg.norm(best[:3]) + 1e-4
        assert np.linalg.norm(own[3:]) < np.linalg.norm(best[3:]) * 1.01 + 1e-6
        np.testing.assert_allclose(done.position_left_mm[k], np.linalg.norm(own[:3]), atol=1e-9)


@pytest.mark.parametrize("case", SPECS)
def test_poses_as_targets_give_the_readings_that_they_were_made_from(case):
    arm = calibrated(SPECS[case])
    readings = bent(arm)
    step = np.where(arm.robot.prismatic, 5.0, 0.05)
    done = compensate(arm, readings + step, nominal_poses(arm.robot, readings))
    assert done.reached.all()
    np.testing.assert_allclose(done.readings, compensate(arm, readings).readings, atol=1e-3)


@pytest.mark.parametrize("case", SPECS)
def test_the_exported_module_corrects_such_an_arm_as_the_workbench_does(case):
    arm = calibrated(SPECS[case])
    readings = bent(arm)
    shown, found = (
        np.where(arm.robot.prismatic, q, np.rad2deg(q))
        for q in (readings, compensate(arm, readings).readings)
    )
    module = exported(arm)
    corrected, left = module["corrected_readings"](shown)
    np.testing.assert_allclose(corrected, found, atol=1e-4)
    position, rotation = module["errors_left"](corrected, shown)
    done = compensate(arm, readings)
    np.testing.assert_allclose(position, done.position_left_mm, atol=1e-4)
    np.testing.assert_allclose(rotation, done.rotation_left_deg, atol=1e-5)
    np.testing.assert_allclose(left, done.left_mm, atol=1e-4)


def test_a_target_beyond_the_limits_is_distinguished_from_one_that_no_reading_reaches():
    arm = calibrated(SCARA)
    poses = nominal_poses(arm.robot, bent(arm, 3))
    beyond = bent(arm, 1)[0]
    beyond[2] = arm.robot.limits[2, 1] + 20.0
    poses[1] = nominal_poses(arm.robot, beyond[None])[0]
    poses[2, 0, 3] += 5000
    done = compensate(arm, bent(arm, 3), poses)
    assert done.reached.tolist() == [True, False, False]
    assert done.beyond_limits.tolist() == [False, True, False]
    assert np.isnan(done.readings[1:]).all()


@pytest.mark.parametrize("spec", [ABB, CRAIG, SLIDING])
def test_an_arm_of_six_joints_has_six_directions(spec):
    robot = load_robot(spec)
    assert not Task.of(robot, {}).is_deficient


def test_an_arm_on_a_track_slides_rather_than_turns_far():
    """Where axis 4 and axis 6 are nearly aligned, the track spares the arm a large rotation of both."""
    track = _joint(0, -90, kind="prismatic", limits=(0, 3000))
    wrist = [_joint(0, 90, d=300), _joint(0, -90), _joint(d=80)]
    arm_joints = [_joint(50, -90, d=300), _joint(400), _joint(40, -90), *wrist]
    arm = calibrated({"name": "on a track", "convention": "distal", "joint": [track, *arm_joints]})
    aligned = np.array([1500.0, *np.deg2rad([40.0, 20.0, -50.0, 30.0, 1.0, 60.0])])
    scatter = np.random.default_rng(2).normal(0, 1, (40, 7)) * [50, 0.2, 0.2, 0.2, 0.2, 0.01, 0.2]
    made = compensate(arm, aligned + scatter)
    assert made.reached.all()
    turned = np.rad2deg(np.abs(made.readings - aligned - scatter)[:, 1:])
    assert turned.max() < 2.0


def test_a_joint_that_a_linkage_moves_is_held():
    """The hand of a palletiser has a reading in the file and no drive: it stayed at 0 throughout the recording."""
    joints = [*PALLETISER["joint"][:3], _joint(80, -90), _joint(d=120)]
    joints[3] = joints[3] | {"coupled": {"joint": 3, "ratio": -1.0}}
    arm = calibrated(PALLETISER | {"joint": joints})
    still = {"q4_deg": (0.0, 0.0)}
    assert Task.of(arm.robot, arm.values).ranks == (3, 2)
    assert Task.of(arm.robot, arm.values, still).ranks == (3, 1)
    readings = bent(arm) * [1, 1, 1, 0, 1]
    free = compensate(arm, readings)
    held = compensate(replace(arm, fitted_range=still), readings)
    assert held.reached.all() and (held.readings[:, 3] == 0).all()
    assert held.position_left_mm.max() < 1e-3 and (free.readings[:, 3] != 0).all()


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"tool.reflector2_x": 1.0, "tool.reflector1_x": 2.0}, "reflector 1"),
        ({"tool.tip_x": 1.0}, "the tip"),
        ({"base.x": 1.0}, "the origin of the flange"),
    ],
)
def test_the_point_that_is_corrected_first_has_a_name(values, name):
    values = {key[:-1] + axis: 1.0 for key in values for axis in "xyz"}
    assert corrected_point_name(values) == name


def test_the_error_of_other_points_of_the_tool_is_stated():
    arm = calibrated(FIVE)
    done = compensate(arm, bent(arm))
    (said,) = left_by_joints(arm, done)
    turned = np.radians(done.rotation_left_deg.max()) * LEVER_MM
    assert "the position of reflector 1 is corrected first" in said
    assert f"{LEVER_MM:g} mm from it, misses its target by up to {turned:.2g} mm more" in said
