"""Touches of points that nobody measured: solved without base, guess or instrument, and judged on touches not fitted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from robot_model.measurements.touch_point import TouchPoint
from robot_model.system import bind, geometry_free
from scenes import ABB, assert_rows, differences
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.solver import normal_matrix, solve
from workbench.core.model import Model
from workbench.diagnosis.robot.bench import bench_of
from workbench.jobs.robot.calibrate import calibrate

TIP = np.array([20.0, -15.0, 180.0])


def touches(robot, geometry, sigma=0.0, seed=0, each=15, points=4):
    """A recording of an arm with `geometry` whose tip is driven to each of some points with an error of `sigma`."""
    rng = np.random.default_rng(seed)
    readings, labels = [], []
    for k in range(points):
        centre = rng.uniform([250, -200, 250], [450, 200, 450])
        for _ in range(each):
            readings.append(_reach(robot, geometry, centre + sigma * rng.standard_normal(3), rng))
            labels.append(k + 1.0)
    columns = {"sample": np.arange(1.0, len(labels) + 1), "point": np.array(labels)}
    columns |= {f"q{k + 1}_deg": np.rad2deg(q) for k, q in enumerate(np.array(readings).T)}
    return Recording("touch-point", columns, ABB, sigma_mm=max(sigma, 0.01), name="touches")


def _reach(robot, geometry, point, rng):
    low, high = -1.4, 1.4

    def gap(q):
        return forward(robot, q[:, None], geometry).point(TIP)[:, 0] - point

    while True:
        found = least_squares(
            gap, rng.uniform(low, high, 6), bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        if np.abs(found.fun).max() < 1e-9:
            return found.x


@pytest.fixture(scope="module")
def arm():
    robot = load_robot(ABB)
    rng = np.random.default_rng(5)
    geometry = robot.geometry + rng.normal(size=robot.geometry.shape) * [2e-3, 0.5, 0.5, 2e-3, 0]
    return robot, geometry


def free_of(model):
    return model.parameters.free("tool.*", "artefact.*", *geometry_free(model.chain.robot))


def test_exact_touches_of_the_nominal_arm_start_at_tip_and_points():
    robot = load_robot(ABB)
    chain = bind(robot, touches(robot, robot.geometry, each=6))
    assert chain.base_size == 0 and not any(
        key.startswith("base.") for key in chain.parameters.keys
    )
    np.testing.assert_allclose(chain.start[:3], TIP, atol=1e-6)
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-6


def test_the_jacobian_is_the_derivative(arm):
    robot, geometry = arm
    model = Model(bind(robot, touches(robot, geometry, each=4)))
    everything = model.parameters.only(np.ones(len(model.parameters), bool))
    expected = differences(lambda x: model.residual(everything.unpack(x)), everything.pack(), 1e-5)
    assert_rows(model.linearise(everything)[1], expected, 1e-5)


def test_what_joint_readings_alone_cannot_tell_is_said(arm):
    """d1 and theta1 move all touched points at once: Gubankov & Yukhimets leave them out by a list, here they are found."""
    robot, geometry = arm
    model = Model(bind(robot, touches(robot, geometry)))
    free = free_of(model)
    fit = solve(model, free)
    known = identifiability(normal_matrix(model, fit.parameters), fit.parameters)
    tied = known.tied()
    assert {"joint-1.d1", "joint-1.theta1"} <= set(tied)
    assert any(key.startswith("tool.tip") for key in tied) and "joint-6.d6" in tied


def test_exact_touches_are_met_and_unseen_ones_predicted(arm):
    robot, geometry = arm
    recording = touches(robot, geometry)
    test = np.arange(recording.n) % 3 == 0
    model = Model(bind(robot, recording, start_on=~test))
    free = free_of(model)
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    fit = solve(model.at(~test), free)
    assert fit.converged and np.abs(fit.residual).max() < 1e-5
    assert np.abs(model.residual(fit.parameters)[:, test]).max() < 1e-3


def test_the_main_job_takes_touches(arm):
    robot, geometry = arm
    result = calibrate(touches(robot, geometry, sigma=0.05, each=20), folds=5)
    answer = result.as_json()
    assert answer["measures"] == "touch-point"
    assert answer["nominal"]["rms_mm"] > 0.5
    assert answer["held_out"]["rms_mm"] < 0.15  # sigma 0.05 a coordinate is 0.087 of distance
    rows = {row["name"]: row for row in answer["parameters"]}
    assert rows["theta2"]["identifiable"] and rows["alpha1"]["identifiable"]
    assert not any(rows[name]["identifiable"] for name in ("d1", "theta1", "theta6", "d6", "a6"))
    # nobody ever measured a length: an arm grown as a whole touches as well
    assert "joint-4.d4" in rows["a2"]["tied_to"] and not rows["a2"]["identifiable"]
    # a short length changes little with the size of the arm, and its standard deviation says by how much
    assert rows["a3"]["identifiable"] and rows["a3"]["std"] > 0.02 * abs(rows["a3"]["nominal"]) / 10


def test_touches_have_no_coordinate_to_write():
    assert TouchPoint(np.zeros(3, int), (1,)).columns(np.zeros((3, 3))) == {}


def test_errors_of_touches_are_not_explained_by_the_scale_of_the_arm(arm):
    """Touches contain no length. The sum of squares that a baseline leaves is chi-square by the degrees of freedom."""
    robot, geometry = arm
    problem = bench_of(touches(robot, geometry, sigma=0.05, seed=4)).problem(hypotheses=False)
    left = problem.orthogonalise(problem.residual) * problem.sigma / 0.05
    assert chi2.sf(left @ left, problem.degrees) > 1e-3
    assert chi2.cdf(left @ left, problem.degrees) > 1e-3
