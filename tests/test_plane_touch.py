"""Touches of unknown planes: tip, planes and arm from joint readings alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from robot_model.system import bind, geometry_free
from scenes import ABB, assert_rows, differences
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.jobs.robot.calibrate import calibrate

TIP = np.array([20.0, -15.0, 150.0])
PLANES = {
    1: (Rotation.from_euler("xy", [3, -4], degrees=True), 250.0),
    2: (Rotation.from_euler("xy", [60, 5], degrees=True), 180.0),
    5: (Rotation.from_euler("xy", [5, 70], degrees=True), 420.0),
}


def touches(robot, geometry, each=30, sigma=0.0, seed=0):
    """A recording of an arm with `geometry` whose tip is driven to planes, from many sides."""
    rng = np.random.default_rng(seed)
    readings, labels = [], []
    for number, (turn, offset) in PLANES.items():
        normal = turn.as_matrix()[:, 2]
        while len(labels) < each * (list(PLANES).index(number) + 1):
            readings.append(
                _reach(robot, geometry, normal, offset + sigma * rng.standard_normal(), rng)
            )
            labels.append(float(number))
    columns = {"sample": np.arange(1.0, len(labels) + 1), "plane": np.array(labels)}
    columns |= {f"q{k + 1}_deg": np.rad2deg(q) for k, q in enumerate(np.array(readings).T)}
    return Recording("plane-touch", columns, ABB, sigma_mm=max(sigma, 0.01), name="planes")


def _reach(robot, geometry, normal, offset, rng):
    def gap(q):
        return normal @ forward(robot, q[:, None], geometry).point(TIP)[:, 0] - offset

    while True:
        found = least_squares(
            gap, rng.uniform(-1.3, 1.3, 6), bounds=(-1.6, 1.6), xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        if np.abs(found.fun).max() < 1e-9:
            return found.x


@pytest.fixture(scope="module")
def arm():
    robot = load_robot(ABB)
    rng = np.random.default_rng(3)
    return robot, robot.geometry + rng.normal(size=robot.geometry.shape) * [1e-3, 0.3, 0.3, 1e-3, 0]


def test_exact_touches_of_the_nominal_arm_start_at_tip_and_planes():
    robot = load_robot(ABB)
    chain = bind(robot, touches(robot, robot.geometry))
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-2
    np.testing.assert_allclose(chain.start[:3], TIP, atol=0.1)
    assert chain.parameters["artefact.plane1_offset"] == pytest.approx(250, abs=0.1)


def test_the_jacobian_is_the_derivative(arm):
    robot, geometry = arm
    model = Model(bind(robot, touches(robot, geometry, each=8)))
    everything = model.parameters.only(np.ones(len(model.parameters), bool))
    expected = differences(lambda x: model.residual(everything.unpack(x)), everything.pack(), 1e-5)
    assert_rows(model.linearise(everything)[1], expected, 1e-5)


def test_exact_touches_are_met_and_unseen_ones_predicted(arm):
    robot, geometry = arm
    recording = touches(robot, geometry, each=40)
    test = np.arange(recording.n) % 4 == 0
    model = Model(bind(robot, recording, start_on=~test))
    free = model.parameters.free("tool.*", "artefact.*", *geometry_free(robot))
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    fit = solve(model.at(~test), free)
    assert fit.converged and np.abs(fit.residual).max() < 1e-4
    assert np.abs(model.residual(fit.parameters)[:, test]).max() < 5e-3


def test_the_main_job_takes_touches_of_planes(arm):
    robot, geometry = arm
    answer = calibrate(touches(robot, geometry, each=50, sigma=0.02), folds=5).as_json()
    assert answer["nominal"]["rms_mm"] > 0.2
    assert answer["held_out"]["rms_mm"] < 0.035  # one length a touch, sigma 0.02
