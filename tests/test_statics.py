"""Gravity torques are minus the slope of the potential energy; moments are sums of levers times weights."""

from dataclasses import replace

import numpy as np
import pytest

from plain_frames import frames_of, middles_of
from robot_model import load_robot
from robot_model.state import State
from scenes import ARMS, differences
from workbench.core.covariates import clock

G = 9.80665
EVERY_ARM = pytest.mark.parametrize(
    "arm",
    [ARMS["abb"], ARMS["craig"], ARMS["sliding"], ARMS["sliding-craig"]],
    ids=["abb", "craig", "sliding", "sliding-craig"],
)
CENTRE = np.array([20.0, -35.0, 110.0])


def state_of(robot, n=7, payload=2.0, gravity=None):
    rng = np.random.default_rng(2)
    variables = np.where(robot.prismatic, 80.0, 1.0)[:, None] * rng.uniform(
        -2, 2, (robot.joints, n)
    )
    nothing = np.zeros((3, n))
    gravity = robot.gravity if gravity is None else gravity
    return State(
        robot,
        variables,
        {},
        gravity,
        np.full(n, payload),
        CENTRE,
        nothing,
        np.ones(n, int),
        nothing,
    )


def bodies(state, i, variables=None):
    """Masses (kg) and centres (J+1, 3) mm of links and load for sample i, by plain matrix products."""
    robot = replace(state.robot, mixing=np.eye(state.robot.joints))
    frames = frames_of(robot, state.variables[:, i] if variables is None else variables)
    centres = [f @ [*c, 1] for f, c in zip(frames[1:-1], robot.com)] + [
        frames[-1] @ [*state.load_centre, 1]
    ]
    return np.append(robot.mass, state.payload[i]), np.array(centres)[:, :3], frames


def potential(state, i, variables):
    """N mm"""
    masses, centres, _ = bodies(state, i, variables)
    return -G * masses @ (centres @ state.gravity)


def torques_by_differences(state):
    """(J, n) N m, and N for a slide."""
    units = np.where(state.robot.prismatic, 1.0, 1e-3)
    steps = np.where(state.robot.prismatic, 1e-2, 1e-5)
    columns = [
        -units * differences(lambda q, i=i: potential(state, i, q), state.variables[:, i], steps)
        for i in range(state.n)
    ]
    return np.array(columns).T


@EVERY_ARM
@pytest.mark.parametrize("gravity", [None, [0.48, -0.6, 0.64]])
def test_torque_is_minus_the_slope_of_the_potential(arm, gravity):
    state = state_of(load_robot(arm), gravity=gravity and np.array(gravity))
    assert np.abs(state.torque).max() > 5
    np.testing.assert_allclose(state.torque, torques_by_differences(state), atol=1e-6)


@EVERY_ARM
def test_the_links_share_is_the_torque_without_load(arm):
    robot = load_robot(arm)
    loaded, empty = state_of(robot), state_of(robot, payload=0.0)
    np.testing.assert_allclose(loaded.self_torque, empty.torque, atol=1e-12)
    assert np.abs(loaded.torque - empty.torque).max() > 1


@EVERY_ARM
def test_load_torque_is_linear_in_the_load_and_one_newton_gives_its_lever(arm):
    robot = load_robot(arm)
    state = state_of(robot, payload=3.0)
    load = state.torque - state.self_torque
    np.testing.assert_allclose(load, 3.0 * G * state.unit_load_torque, atol=1e-9)
    np.testing.assert_allclose(
        2 * load, (state_of(robot, payload=6.0).torque - state.self_torque), atol=1e-9
    )


def test_a_horizontal_arm_is_pulled_down():
    """Positive torque turns the joint the way in which gravity drives it: textbook arm, 2 kg at 500 mm."""
    arm = {
        "name": "one joint",
        "convention": "distal",
        "joint": [
            {
                "theta_deg": 0.0,
                "d_mm": 0.0,
                "a_mm": 500.0,
                "alpha_deg": 0.0,
                "mass_kg": 2.0,
                "com_mm": [0.0, 0.0, 0.0],
            }
        ],
        "gravity": [0.0, -1.0, 0.0],
    }
    state = replace(
        state_of(load_robot(arm), n=2, payload=0.0), variables=np.array([[0.0, np.pi / 3]])
    )
    np.testing.assert_allclose(state.torque, [[-2 * G * 0.5, -2 * G * 0.25]], rtol=1e-12)


@EVERY_ARM
def test_bending_moments_are_levers_times_weights(arm):
    """Base carries everything, link K what is beyond it, the tool the load; each in its own frame, N m."""
    state = state_of(load_robot(arm))
    joints = state.robot.joints
    for i in range(state.n):
        masses, centres, frames = bodies(state, i)
        origins = np.array([f[:3, 3] for f in frames[: joints + 1]])
        robot = replace(state.robot, mixing=np.eye(joints))
        middles = middles_of(robot, frames, state.variables[:, i])
        pivots = [origins[0], *middles, frames[-1][:3, 3]]
        first = [0, *range(1, joints + 1), joints]
        places = [*frames[: joints + 1], frames[-1]]
        for p, (pivot, body, frame) in enumerate(zip(pivots, first, places)):
            weights = masses[body:, None] * G * state.gravity
            moment = np.cross((centres[body:] - pivot) * 1e-3, weights).sum(0)
            np.testing.assert_allclose(state.moment[p, :, i], frame[:3, :3].T @ moment, atol=1e-9)


@EVERY_ARM
def test_bearing_moments_lie_across_the_axis_and_with_the_torque_make_the_whole(arm):
    state = state_of(load_robot(arm))
    joints, links = state.robot.joints, state.frames.link[1:-1]
    across = np.einsum("kcin,kcn->kin", links, state.bearing_moment)
    assert np.abs((across * state.frames.z).sum(1)).max() < 1e-9
    for i in range(state.n):
        masses, centres, _ = bodies(state, i)
        for k in np.flatnonzero(~state.robot.prismatic):
            axis, origin = state.frames.z[k, :, i], state.frames.z_origin[k, :, i]
            whole = np.cross(
                (centres[k:] - origin) * 1e-3, masses[k:, None] * G * state.gravity
            ).sum(0)
            np.testing.assert_allclose(
                across[k, :, i] + state.torque[k, i] * axis, whole, atol=1e-9
            )
    assert across.shape == (joints, 3, state.n)


@EVERY_ARM
def test_altered_gravity_and_moments_are_those_of_an_altered_robot(arm):
    """Tilted gravity, and a first moment added to link 3 and to the load, against a state made so from the start."""
    state = state_of(load_robot(arm))
    tilt, link, load = (
        np.array([0.02, -0.01, 0.03]),
        np.array([30.0, -60.0, 90.0]),
        np.array([-20.0, 5.0, 40.0]),
    )
    robot, j = state.robot, state.robot.joints
    changes = [
        ("gravity", (0, 1, 2), tilt[:, None]),
        ("mass", (6, 7, 8), link[:, None]),
        ("mass", range(3 * j, 3 * j + 3), load[:, None]),
    ]
    altered = state.altered(changes)
    com = robot.com.copy()
    com[2] += link / robot.mass[2]
    expected = replace(
        state,
        robot=replace(robot, com=com),
        gravity=state.gravity + tilt,
        load_centre=CENTRE + load / state.payload[0],
    )
    for name in ("torque", "moment", "bearing_moment"):
        np.testing.assert_allclose(getattr(altered, name), getattr(expected, name), atol=1e-9)
    assert not np.allclose(altered.torque, state.torque)


def test_the_links_share_does_not_hold_the_tools_first_moment():
    """The tool is load: the uncertainty of its mass is no self-weight of the links."""
    state = state_of(load_robot(ARMS["abb"]))
    altered = state.altered([("mass", (18, 19, 20), np.full((3, 1), 50.0))])
    assert not np.allclose(altered.torque, state.torque)
    np.testing.assert_allclose(altered.self_torque, state.self_torque, atol=1e-12)


def test_without_time_the_clock_is_the_row():
    state = state_of(load_robot(ARMS["abb"]), n=4)
    assert clock(state).tolist() == [0, 1, 2, 3]
    assert clock(replace(state, covariates={"time_s": np.arange(4.0) * 5})).tolist() == [
        0,
        5,
        10,
        15,
    ]
