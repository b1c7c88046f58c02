"""The chain against plain products of matrices, and every port's derivative against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plain_frames import frames_of, middles_of, place
from robot_model import load_robot
from robot_model.chain import forward, rotate
from robot_model.poses import pose_values
from robot_model.system import geometry_free
from scenes import ARMS, KINDS, assert_rows, differences, model_of, scene
from workbench.core.rigid import left_jacobian, nearest_rotation, rotation_matrix

EVERY_ARM = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())
EVERY_KIND = pytest.mark.parametrize("measures", KINDS)
PORTS = {"joint": 1, "geometry": 5, "frame": 6}


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def readings_of(robot, rng, n=9):
    return np.where(robot.prismatic, 80.0, 1.0) * rng.uniform(-2, 2, (n, robot.joints))


def matrices(frames):
    out = np.tile(np.eye(4), (frames.end_origin.shape[1], 1, 1))
    out[:, :3, :3] = np.stack(frames.end, -1).transpose(1, 0, 2)
    out[:, :3, 3] = frames.end_origin.T
    return out


@EVERY_ARM
def test_flange_is_the_product_of_printed_matrices(arm, rng):
    robot = load_robot(arm)
    readings = readings_of(robot, rng)
    found = matrices(forward(robot, robot.mixing @ readings.T))
    np.testing.assert_allclose(found, [frames_of(robot, q)[-1] for q in readings], atol=1e-9)


@EVERY_ARM
def test_geometry_given_a_sample_is_that_samples_product(arm, rng):
    robot = load_robot(arm)
    readings = readings_of(robot, rng)
    geometry = robot.geometry[:, :, None] + rng.normal(0, 0.05, (robot.joints, 5, len(readings)))
    found = matrices(forward(robot, robot.mixing @ readings.T, geometry))
    expected = [
        frames_of(replace(robot, geometry=geometry[:, :, i]), q)[-1] for i, q in enumerate(readings)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_root_and_flange_transforms_stand_before_and_behind(rng):
    robot = load_robot(ARMS["abb"])
    root, flange = (place(Rotation.random(random_state=k), rng.normal(0, 200, 3)) for k in (1, 2))
    world = Rotation.random(random_state=3).as_matrix(), rng.normal(0, 200, 3)
    robot = replace(robot, base=root, flange=flange)
    readings = readings_of(robot, rng)
    found = matrices(forward(robot, robot.mixing @ readings.T, base=world))
    outer = np.eye(4)
    outer[:3, :3], outer[:3, 3] = world
    np.testing.assert_allclose(
        found, [outer @ frames_of(robot, q)[-1] for q in readings], atol=1e-9
    )


@EVERY_ARM
def test_twists_turn_each_place_about_its_pivot(arm, rng):
    """Base at its origin, links at their middle, tool at the flange: exact rotations in the place's own frame."""
    robot = load_robot(arm)
    readings = readings_of(robot, rng)
    twists = {
        p: rng.normal(0, [[2], [2], [2], [0.1], [0.1], [0.1]], (6, len(readings)))
        for p in range(robot.joints + 2)
    }
    found = matrices(forward(robot, robot.mixing @ readings.T, twists=twists))
    expected = [
        _twisted(robot, q, {p: t[:, i] for p, t in twists.items()}) for i, q in enumerate(readings)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def _twisted(robot, reading, twists):
    """The flange when every frame's small twist is put between its neighbours."""
    root, *after, flange = frames = frames_of(robot, reading)
    middles = middles_of(robot, frames, reading)
    out = root @ _about(np.zeros(3), twists[0])
    for k, (before, here) in enumerate(zip([root, *after], after), 1):
        step = np.linalg.inv(before) @ here
        middle = here[:3, :3].T @ (middles[k - 1] - here[:3, 3])  # in this frame
        out = out @ step @ _about(middle, twists[k])
    return out @ np.linalg.inv(after[-1]) @ flange @ _about(np.zeros(3), twists[len(after) + 1])


def _about(pivot, twist):
    return (
        place(shift=pivot + twist[:3])
        @ place(Rotation.from_rotvec(twist[3:]))
        @ place(shift=-pivot)
    )


def port_model(measures, arm, rng, twists):
    """A chain at parameters off the nominal, with deltas of joint, geometry and (where asked) every twist."""
    chain = model_of(scene(measures, n=12, arm=arm, seed=5)).chain
    start = chain.parameters
    sizes = np.where(start.typical >= 1, 0.5, 0.02)
    values = start.values + rng.normal(0, 1, len(start)) * sizes
    joints, n = chain.robot.joints, chain.n
    deltas = {
        "joint": (np.arange(joints), rng.normal(0, 0.01, (joints, n))),
        "geometry": (np.arange(5 * joints), rng.normal(0, 0.01, (5 * joints, n))),
    }
    if twists:
        port_indices = np.arange(6 * joints + 12)
        deltas["frame"] = (
            port_indices,
            rng.normal(0, 1, (len(port_indices), n))
            * np.where(port_indices % 6 < 3, 0.5, 0.01)[:, None],
        )
    for port in ("target", "sensor"):
        deltas[port] = np.arange(3), rng.normal(0, 1, (3, n))
    return chain, values, deltas


def changed(deltas, port, row, step):
    port_indices, delta = deltas.get(port, (np.zeros(0, int), np.zeros((0, 12))))
    if row not in port_indices:
        port_indices, delta = np.append(port_indices, row), np.vstack([delta, np.zeros((1, 12))])
    delta = delta.copy()
    delta[list(port_indices).index(row)] += step
    return deltas | {port: (port_indices, delta)}


def index_differences(chain, values, deltas, port, port_indices, step=1e-4):
    ends = (
        [chain.evaluate(values, changed(deltas, port, s, h)).residual for s in port_indices]
        for h in (step, -step)
    )
    return (np.array(next(ends)) - np.array(next(ends))) / (2 * step)


@EVERY_KIND
@EVERY_ARM
@pytest.mark.parametrize("port", ["joint", "geometry", "frame", "target", "sensor"])
def test_port_derivatives_are_those_of_the_residual(measures, arm, port, rng):
    chain, values, deltas = port_model(measures, arm, rng, twists=port == "frame")
    count = {"joint": 1, "geometry": 5, "frame": 6}.get(port, 0)
    port_indices = np.arange(
        count * chain.robot.joints + (12 if port == "frame" else 0) if count else 3
    )
    found = np.array(chain.evaluate(values, deltas).rows(port, port_indices))
    # the derivative of a rotation vector at a finite twist w is a series that stops before w^3 / 24
    assert_rows(
        found,
        index_differences(chain, values, deltas, port, port_indices),
        1e-5 if port == "frame" else 1e-7,
    )


@EVERY_KIND
@EVERY_ARM
def test_twists_are_differentiated_where_none_acts_yet(measures, arm, rng):
    chain, values, deltas = port_model(measures, arm, rng, twists=False)
    port_indices = np.arange(6 * chain.robot.joints + 12)
    found = chain.evaluate(values, deltas).rows("frame", port_indices)
    assert_rows(found, index_differences(chain, values, deltas, "frame", port_indices), 1e-7)


@EVERY_KIND
@EVERY_ARM
def test_own_derivatives_are_those_of_the_residual(measures, arm, rng):
    """Base, geometry and tool, with deltas on all other ports."""
    chain, values, deltas = port_model(measures, arm, rng, twists=False)
    everything = np.arange(len(values))
    found = chain.evaluate(values, deltas).own_rows(everything)
    assert_rows(
        found, differences(lambda v: chain.evaluate(v, deltas).residual, values, 1e-5), 1e-7
    )


@EVERY_KIND
def test_geometry_derivatives_under_small_twists_are_off_by_half_the_twist_at_most(measures, rng):
    """The pivot at mid-link moves with the link, which the derivative leaves out: 0.01 rad give half a per cent."""
    chain, values, deltas = port_model(measures, ARMS["abb"], rng, twists=True)
    port_indices = np.arange(30)
    found = chain.evaluate(values, deltas).rows("geometry", port_indices)
    assert_rows(found, index_differences(chain, values, deltas, "geometry", port_indices), 0.03)


@EVERY_KIND
def test_some_own_rows_are_the_same_as_those_of_all(measures, rng):
    chain, values, deltas = port_model(measures, ARMS["abb"], rng, twists=True)
    evaluation = chain.evaluate(values, deltas)
    some = np.array([1, 4, 7, 22, 35, len(values) - 1])
    np.testing.assert_array_equal(
        evaluation.own_rows(some), evaluation.own_rows(np.arange(len(values)))[some]
    )
    assert evaluation.own_rows(np.array([], int)).shape == (0, *evaluation.residual.shape)


def test_rotation_by_vectors_is_exact_from_nothing_to_a_turn(rng):
    points = rng.normal(size=(3, 50))
    vectors = rng.normal(size=(3, 50)) * np.geomspace(1e-9, 6, 50)
    expected = Rotation.from_rotvec(vectors.T).apply(points.T).T
    np.testing.assert_allclose(rotate(vectors, points), expected, atol=1e-14 * 50)
    assert np.array_equal(rotate(np.zeros((3, 50)), points), points)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.3, 3.1, np.pi])
def test_left_jacobian_turns_small_changes(angle):
    vector = angle * np.array([0.6, -0.48, 0.64])
    turn = rotation_matrix(vector)
    found = left_jacobian(vector)
    expected = differences(
        lambda v: Rotation.from_matrix(rotation_matrix(v) @ turn.T).as_rotvec(), vector, 1e-5
    ).T
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_pose_values_and_rotation_are_inverse(rng):
    turn = Rotation.random(random_state=1).as_matrix()
    values = pose_values(turn, [1, 2, 3])
    np.testing.assert_allclose(rotation_matrix(values[3:]), turn, atol=1e-14)
    assert values[:3].tolist() == [1, 2, 3]
    np.testing.assert_allclose(nearest_rotation(3 * turn), turn, atol=1e-14)
    assert np.linalg.det(nearest_rotation(-turn)) == pytest.approx(1)


def test_geometry_frees_beta_instead_of_d_where_the_next_axis_is_parallel():
    robot = load_robot(ARMS["abb"])
    keys = geometry_free(robot)
    assert len(keys) == 24
    assert "joint-2.beta2" in keys and "joint-2.d2" not in keys
    assert "joint-3.d3" in keys and "joint-3.beta3" not in keys
