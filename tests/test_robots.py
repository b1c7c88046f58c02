"""Nominal arms stand, turn and reach as their makers say."""

import numpy as np
import pytest

from plain_frames import frames_of
from robot_model import builtin_robots, load_robot
from robot_model.chain import forward

X, Y, Z = np.eye(3)
UNIVERSAL = ("ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e")


def axes_of(robot):
    return np.array(
        [
            frame[:3, 2]
            for frame in frames_of(robot, np.zeros(robot.mixing.shape[1]))[: robot.joints]
        ]
    )


# name: readings (deg), flange (mm), flange x axis, flange z axis; from data sheets, controllers and published URDFs
POSES = {
    "abb_irb120": ([0, 0, 0, 0, 0, 0], [374, 0, 630], -Z, X),
    "fanuc_lr_mate_200id": ([0, 0, 0, 0, 0, 0], [465, 0, 695], Z, X),
    "kuka_kr10_r1100": ([0, -90, 90, 0, 0, 0], [620, 0, 995], -Z, X),
    "kuka_kr6_r900": ([0, -90, 90, 0, 0, 0], [525, 0, 890], -Z, X),
    "mitsubishi_rv_2fb": ([0, 0, 90, 0, 90, 0], [270, 0, 505], -X, -Z),
    "motoman_ma1400": ([0, 0, 0, 0, 0, 0], [820, 0, 1064], X, -Z),
    "staubli_tx60": ([0, 0, 0, 0, 0, 0], [0, 20, 670], X, Z),
    "staubli_tx90l": ([0, 90, 0, 0, 0, 0], [1200, 50, 0], -Z, X),
    "ur10": ([0, 0, 0, 0, 0, 0], [-1184.3, -256.141, 11.6], X, -Y),
    "ur10e": ([0, 0, 0, 0, 0, 0], [-1184.25, -290.7, 60.85], X, -Y),
    "ur16e": ([0, 0, 0, 0, 0, 0], [-838.4, -290.7, 60.85], X, -Y),
    "ur3": ([0, 0, 0, 0, 0, 0], [-456.9, -194.25, 66.55], X, -Y),
    "ur3e": ([0, 0, 0, 0, 0, 0], [-456.75, -223.15, 66.5], X, -Y),
    "ur5": ([0, 0, 0, 0, 0, 0], [-817.25, -191.45, -5.491], X, -Y),
    "ur5e": ([0, 0, 0, 0, 0, 0], [-817.2, -232.9, 62.8], X, -Y),
}
# the direction about which each reading counts positive, at zero, in the base frame
AXES = {
    "abb_irb120": [Z, Y, Y, X, Y, X],
    "fanuc_lr_mate_200id": [Z, Y, -Y, -X, -Y, -X],
    "kuka_kr10_r1100": [-Z, Y, Y, -X, Y, -X],
    "kuka_kr6_r900": [-Z, Y, Y, -X, Y, -X],
    "mitsubishi_rv_2fb": [Z, Y, Y, Z, Y, Z],
    "motoman_ma1400": [Z, Y, -Y, -X, -Y, -Z],
    "staubli_tx60": [Z, Y, Y, Z, Y, Z],
    "staubli_tx90l": [Z, Y, Y, Z, Y, Z],
    **dict.fromkeys(UNIVERSAL, [Z, -Y, -Y, -Y, -Z, -Y]),
}
# maximum reach of the data sheet (mm), and the frame to whose origin it is measured from axis 1; for other UR arms
# the data sheet states a working radius, which is that of no frame
REACH = {
    "abb_irb120": (580, 4, 0.1),
    "fanuc_lr_mate_200id": (717, 4, 0.5),
    "kuka_kr10_r1100": (1101, 4, 0.5),
    "kuka_kr6_r900": (901.5, 4, 0.1),
    "mitsubishi_rv_2fb": (504.6, 4, 0.1),
    "motoman_ma1400": (1434, 4, 1.0),
    "staubli_tx60": (670, 6, 0.5),
    "staubli_tx90l": (1200, 6, 1.0),
    "ur10": (1300, 5, 0.1),
    "ur10e": (1300, 5, 5.0),
}
PARALLEL = {name: [2] for name in POSES} | dict.fromkeys(UNIVERSAL, [2, 3])


def test_the_tables_name_every_builtin_arm():
    assert set(builtin_robots()) == set(POSES) == set(AXES)
    assert set(POSES) - set(REACH) == set(UNIVERSAL) - {"ur10", "ur10e"}


@pytest.mark.parametrize("name", POSES)
def test_the_arm_stands_where_its_maker_says(name):
    readings, point, x, z = POSES[name]
    flange = frames_of(load_robot(name), np.deg2rad(readings))[-1]
    np.testing.assert_allclose(flange[:3, 3], point, atol=1e-9)
    np.testing.assert_allclose(flange[:3, [0, 2]].T, [x, z], atol=1e-12)


@pytest.mark.parametrize("name", AXES)
def test_every_joint_turns_the_way_of_its_maker(name):
    robot = load_robot(name)
    np.testing.assert_allclose(
        axes_of(robot) * np.diag(robot.mixing)[:, None], AXES[name], atol=1e-12
    )


@pytest.mark.parametrize("name", REACH)
def test_the_arm_reaches_as_far_as_its_data_sheet_says(name):
    """Axis 1 to shoulder, and from there the farthest that elbow and wrist can straighten out."""
    reach, frame, tolerance = REACH[name]
    robot, elbow = load_robot(name), np.deg2rad(np.arange(0, 360, 0.1))
    readings = np.zeros((6, 2 * elbow.size))
    readings[2], readings[3, elbow.size :] = np.tile(elbow, 2), -np.pi / 2
    frames = forward(robot, readings)
    point = [*frames.z_origin, frames.end_origin][frame]
    from_shoulder = np.cross(frames.z[1], point - frames.z_origin[1], axis=0)
    farthest = abs(robot.geometry[0, 2]) + np.linalg.norm(from_shoulder, axis=0).max()
    assert farthest == pytest.approx(reach, abs=tolerance)


@pytest.mark.parametrize("name", POSES)
def test_hayati_marks_the_joints_whose_next_axis_is_parallel(name):
    robot = load_robot(name)
    axes = axes_of(robot)
    parallel = np.linalg.norm(np.cross(axes[:-1], axes[1:]), axis=1) < 1e-9
    assert (
        list(np.flatnonzero(robot.hayati) + 1)
        == list(np.flatnonzero(parallel) + 1)
        == PARALLEL[name]
    )


@pytest.mark.parametrize("name", POSES)
def test_chain_and_plain_products_agree(name):
    robot = load_robot(name)
    readings = np.random.default_rng(1).uniform(-3, 3, 6)
    chain = forward(robot, (robot.mixing @ readings)[:, None])
    expected = frames_of(robot, readings)[-1]
    np.testing.assert_allclose(chain.end_origin[:, 0], expected[:3, 3], atol=1e-9)
    np.testing.assert_allclose(
        np.column_stack([axis[:, 0] for axis in chain.end]), expected[:3, :3], atol=1e-12
    )


@pytest.mark.parametrize("name", POSES)
def test_every_builtin_arm_names_its_source_and_has_sound_numbers(name):
    robot = load_robot(name)
    assert len(robot.source) > 30
    assert np.allclose(robot.gravity, -Z)
    known = np.isfinite(robot.limits).all(1)
    assert (robot.limits[known, 0] < robot.limits[known, 1]).all()
    assert known.sum() >= 5
    assert np.array_equal(robot.base, np.eye(4)) and np.array_equal(robot.flange, np.eye(4))


def test_fanucs_forearm_keeps_its_slope_when_joint_2_moves():
    robot = load_robot("fanuc_lr_mate_200id")
    before, after = (frames_of(robot, np.deg2rad([0, q2, 20, 0, 0, 0]))[-1] for q2 in (0, 37))
    np.testing.assert_allclose(before[:3, :3], after[:3, :3], atol=1e-12)
    # 330 mm of upper arm leaned forward by 37 deg
    expected = 330 * np.array([np.sin(np.deg2rad(37)), 0, np.cos(np.deg2rad(37)) - 1])
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], expected, atol=1e-9)


def test_masses_lie_within_their_links():
    """ABB's at zero where the published URDF has them; UR's along the arm as UR draws it."""
    published = {
        1: [0.1, -0.1, 238.4],
        2: [0.8, -2.1, 391.2],
        3: [22.8, 1.1, 617.9],
        4: [224.7, 0.2, 630.4],
        5: [300.9, 0.0, 630.1],
        6: [366.9, -0.2, 630.0],
    }
    robot = load_robot("abb_irb120")
    frames = frames_of(robot, np.zeros(6))
    for k, centre in published.items():
        np.testing.assert_allclose((frames[k] @ [*robot.com[k - 1], 1])[:3], centre, atol=0.06)
    assert robot.mass.sum() == pytest.approx(11.931)
    ur = load_robot("ur10e")
    upper = frames_of(ur, np.zeros(6))[2] @ [*ur.com[1], 1]
    np.testing.assert_allclose(upper[:3], [-232.7, -158, 180.7], atol=1e-9)
