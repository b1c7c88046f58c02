"""Every kind of measurement starts by itself in closed form, and knows its own derivative."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plain_frames import place
from robot_model.measurements import KINDS as REGISTERED
from robot_model.measurements import measurement_of
from robot_model.measurements.closure import rigid_fit, solve_linear_start
from robot_model.system import bind
from scenes import (
    ABB,
    ARMS,
    BALLS,
    KINDS,
    REFLECTORS,
    assert_rows,
    differences,
    model_of,
    random_pose,
    scene,
)
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix
from workbench.fitting.checked_samples import check_samples

EVERY_KIND = pytest.mark.parametrize("measures", KINDS)
CLOSED = {
    "touch-point",
    "laser-spot",
    "plane-touch",
    "ball-surface",
    "distance",
}  # each has a test file of its own
COPLANAR = {k: (x, y, 0.0, r) for k, (x, y, _, r) in BALLS.items()}


def pose_of(values):
    return place(Rotation.from_rotvec(values[3:6]), values[:3])


def own_values(chain):
    return chain.parameters.values[6 + 5 * chain.robot.joints :]


def assert_started(made, chain, atol=1e-6):
    """Base and tool of the exact scene, mm and matrix entries."""
    np.testing.assert_allclose(pose_of(chain.start[:6]), made.base, atol=atol)
    if chain.measurement.place == "tool" and made.recording.measures == "external-point":
        expected = [REFLECTORS[i] for i in chain.measurement.ids]
        np.testing.assert_allclose(own_values(chain).reshape(-1, 3), expected, atol=atol)
    elif (
        made.recording.measures == "partial-pose"
    ):  # its turn about the measured axis is nowhere seen
        seen = [1, 3]
        np.testing.assert_allclose(
            pose_of(own_values(chain))[:, seen], made.tool[:, seen], atol=atol
        )
    else:
        np.testing.assert_allclose(pose_of(own_values(chain)), made.tool, atol=atol)


def test_every_registered_kind_is_tested():
    assert {*KINDS, *CLOSED} == set(REGISTERED)


@EVERY_KIND
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("angle", [None, np.pi, 0.0], ids=["any", "half-turn", "none"])
def test_exact_data_start_at_base_and_tool_without_a_guess(measures, seed, angle):
    made = scene(measures, seed=seed, angle=angle)
    assert_started(made, bind(made.robot, made.recording))


@EVERY_KIND
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())
def test_every_arm_starts(measures, arm):
    made = scene(measures, arm=arm, seed=20)
    chain = bind(made.robot, made.recording)
    assert_started(made, chain)
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-6


@EVERY_KIND
@pytest.mark.parametrize("n", [12, 20])
def test_few_samples_are_enough(measures, n):
    made = scene(measures, n=n, seed=4)
    assert_started(made, bind(made.robot, made.recording), 1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_one_reflector_starts_at_base_and_its_place(seed):
    made = scene("external-point", seed=seed, reflectors={1: REFLECTORS[1]})
    assert_started(made, bind(made.robot, made.recording))


@pytest.mark.parametrize("seed", range(4))
def test_coplanar_balls_start_right_side_up(seed):
    made = scene("ball-centre", seed=seed, balls=COPLANAR)
    assert_started(made, bind(made.robot, made.recording))


@pytest.mark.parametrize(
    "balls",
    [{3: (0.0, 0.0, 0.0, 15.0)}, {3: (50.0, -20.0, 10.0, 15.0)}],
    ids=["origin", "elsewhere"],
)
def test_one_ball_gives_the_hand_eye_and_its_place_though_not_the_artefacts_attitude(balls):
    made = scene("ball-centre", seed=2, balls=balls)
    chain = bind(made.robot, made.recording)
    np.testing.assert_allclose(pose_of(own_values(chain)), made.tool, atol=1e-6)
    ball = [*balls[3][:3], 1]
    np.testing.assert_allclose(
        np.linalg.inv(pose_of(chain.start[:6])) @ ball, np.linalg.inv(made.base) @ ball, atol=1e-6
    )
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-6


def test_two_balls_leave_only_the_turn_about_their_line():
    made = scene("ball-centre", seed=2, balls={1: BALLS[1], 2: BALLS[2]})
    chain = bind(made.robot, made.recording)
    np.testing.assert_allclose(pose_of(own_values(chain)), made.tool, atol=1e-6)
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-6


@EVERY_KIND
def test_noise_moves_the_start_a_little(measures):
    made = scene(measures, seed=6, n=200)
    rng = np.random.default_rng(1)
    noisy = {
        k: v + rng.normal(0, 0.05, made.recording.n) if k in ("x_mm", "y_mm", "z_mm") else v
        for k, v in made.recording.columns.items()
    }
    chain = bind(made.robot, replace(made.recording, columns=noisy))
    np.testing.assert_allclose(pose_of(chain.start[:6])[:3, 3], made.base[:3, 3], atol=0.5)
    assert (
        np.sqrt((chain.evaluate(chain.parameters.values, {}).residual[:3] ** 2).sum(0).mean())
        < 0.12
    )


@EVERY_KIND
@pytest.mark.parametrize("angle", [None, np.pi], ids=["any", "half-turn"])
@pytest.mark.parametrize("away", [1e-3, 0.3])
def test_the_jacobian_of_base_and_tool_is_the_derivative(measures, angle, away):
    """Near the solution and far from it."""
    model = model_of(scene(measures, n=15, angle=angle))
    start = model.parameters.free("base.*", "tool.*" if measures != "ball-centre" else "sensor.*")
    free = start.unpack(start.pack() + away * start.typical[start.mask])
    found = model.linearise(free)[1]
    assert_rows(
        found, differences(lambda x: model.residual(free.unpack(x)), free.pack(), 1e-5), 1e-6
    )


@EVERY_KIND
def test_columns_of_a_prediction_measure_back_to_no_residual(measures):
    """What is written of a simulated measurement is what the chain predicts, orientation too."""
    made = scene(measures, n=15)
    chain = bind(made.robot, made.recording)
    values = chain.parameters.values + 0.01
    columns = chain.measurement.columns(chain.evaluate(values, {}).residual)
    written = measurement_of(replace(made.recording, columns=made.recording.columns | columns))
    residual = replace(chain, measurement=written).evaluate(values, {}).residual
    assert np.abs(chain.evaluate(values, {}).residual).max() > 0.01
    assert np.abs(residual).max() < 1e-9


@EVERY_KIND
def test_some_samples_are_the_same_chain(measures):
    made = scene(measures, n=30)
    chain = bind(made.robot, made.recording)
    part = np.array([3, 4, 17, 29])
    values = chain.parameters.values + 0.01
    np.testing.assert_allclose(
        chain.at(part).evaluate(values, {}).residual, chain.evaluate(values, {}).residual[:, part]
    )
    assert chain.at(part).sigma.shape == (chain.sigma.shape[0], 4)
    mask = np.isin(np.arange(30), part)
    assert np.array_equal(chain.at(mask).state.measured, chain.at(part).state.measured)


@EVERY_KIND
def test_sigma_is_the_recordings(measures):
    made = scene(measures, n=12, sigma=0.03)
    assert (bind(made.robot, made.recording).sigma[:3] == 0.03).all()
    rows = np.linspace(0.01, 0.05, 12)
    own = replace(made.recording, columns=made.recording.columns | {"sigma_mm": rows})
    np.testing.assert_array_equal(bind(made.robot, own).sigma[:3], np.tile(rows, (3, 1)))
    unknown = bind(made.robot, replace(made.recording, sigma_mm=None))
    assert (unknown.sigma[:3] == 1).all() and unknown.sigma_unknown


def test_a_poses_turn_has_a_sigma_of_its_own():
    made = scene("external-pose", n=12, sigma=0.03)
    np.testing.assert_allclose(bind(made.robot, made.recording).sigma[3:], 0.03 / 100)
    own = replace(made.recording, columns=made.recording.columns | {"sigma_deg": np.full(12, 0.2)})
    np.testing.assert_allclose(bind(made.robot, own).sigma[3:], np.deg2rad(0.2))


def test_sample_numbers_are_those_of_the_file():
    for measures, known in (("ball-centre", BALLS), ("external-point", REFLECTORS)):
        made = scene(measures, n=12)
        assert set(measurement_of(made.recording).numbers) == set(known)
    assert set(measurement_of(scene("external-pose", n=12).recording).numbers) == {1}


def test_a_kind_that_moves_no_chain_is_a_sentence():
    made = scene("external-point", n=12)
    with pytest.raises(
        InputError,
        match="'board-images' cannot be calibrated as an arm; expected one of ball-centre",
    ):
        measurement_of(replace(made.recording, measures="board-images"))


@pytest.mark.parametrize(
    ("measures", "command"), [("target-pose", "handeye"), ("board-images", "camera")]
)
def test_a_recording_without_joints_names_the_command_that_takes_it(measures, command):
    """Before anything is asked of a robot that such a recording does not have."""
    other = replace(scene("external-point", n=12).recording, measures=measures, robot={})
    with pytest.raises(InputError, match=f"'{measures}' cannot be .* use `workbench {command}`"):
        check_samples(other)


def test_arrows_and_points_stand_in_the_root_frame():
    for measures in KINDS:
        made = scene(measures, n=12)
        chain = bind(made.robot, made.recording)
        values = chain.parameters.values
        evaluation = chain.evaluate(values, {})
        points, arrows = chain.to_root(values, evaluation, np.full((3, 12), 0.5))
        np.testing.assert_allclose(np.sqrt((arrows**2).sum(0)), np.sqrt(0.75))
        back = rotation_matrix(values[3:6]) @ points + values[:3, None]
        np.testing.assert_allclose(back, evaluation.closure.point, atol=1e-8)


def test_rigid_fit_finds_pose_and_never_mirrors():
    rng = np.random.default_rng(0)
    pose = random_pose(rng, 100)
    points = rng.normal(size=(6, 3))
    turn, shift = rigid_fit(points, points @ pose[:3, :3].T + pose[:3, 3])
    np.testing.assert_allclose(turn, pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(shift, pose[:3, 3], atol=1e-12)
    mirrored, _ = rigid_fit(points, points * [1, 1, -1])
    assert np.linalg.det(mirrored) == pytest.approx(1)


def test_linear_start_takes_the_shortest_of_many_solutions():
    ones = np.ones((4, 1))
    np.testing.assert_allclose(
        solve_linear_start([ones, ones, 0 * ones], 2 * ones[:, 0]), [1, 1, 0], atol=1e-12
    )


def test_one_attitude_only_is_finite_all_the_same():
    """Poses that never turn do not determine a tool; the start must not break."""
    made = scene("external-point", n=20, arm=ABB)
    still = made.recording.columns | {f"q{k}_deg": np.full(20, 10.0) for k in range(1, 7)}
    chain = bind(made.robot, replace(made.recording, columns=still))
    assert np.isfinite(chain.start).all()
