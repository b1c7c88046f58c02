"""Beams that pass unknown points of an unknown sphere: beam, sphere and arm from joint readings alone."""

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

BEAM = np.array([12.0, -7.0, 0.0]), Rotation.from_euler("xy", [0.04, 0.11]).as_matrix()[:, 2]
CENTRE, RADIUS = np.array([700.0, 40.0, 300.0]), 60.0


def beams(robot, geometry, points=9, each=8, sigma=0.0, seed=0, spheres=1):
    """A recording of an arm with `geometry` that drives its beam to the middle of a detector on a sphere."""
    rng = np.random.default_rng(seed)
    readings, labels = [], []
    for k in range(points):
        away = rng.normal(size=3) * 0.5 - [1.0, 0, 0]
        place = CENTRE + RADIUS * away / np.linalg.norm(away)
        for _ in range(each):
            readings.append(_aim(robot, geometry, place + sigma * rng.standard_normal(3), rng))
            labels.append(k + 1.0)
    columns = {"sample": np.arange(1.0, len(labels) + 1), "point": np.array(labels)}
    columns["sphere"] = 1.0 + (np.array(labels) - 1) % spheres
    columns |= {f"q{k + 1}_deg": np.rad2deg(q) for k, q in enumerate(np.array(readings).T)}
    return Recording("laser-spot", columns, ABB, sigma_mm=max(sigma, 0.01), name="beams")


def _aim(robot, geometry, place, rng):
    def gap(q):
        frames = forward(robot, q[:, None], geometry)
        flange = np.stack(frames.end)[:, :, 0].T
        away = flange.T @ (place - frames.end_origin[:, 0]) - BEAM[0]
        return np.cross(away, BEAM[1])

    while True:
        found = least_squares(
            gap, rng.uniform(-1.3, 1.3, 6), bounds=(-1.5, 1.5), xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        if np.abs(found.fun).max() < 1e-9:
            return found.x


@pytest.fixture(scope="module")
def arm():
    robot = load_robot(ABB)
    rng = np.random.default_rng(3)
    return robot, robot.geometry + rng.normal(size=robot.geometry.shape) * [1e-3, 0.4, 0.4, 1e-3, 0]


def test_exact_beams_of_the_nominal_arm_start_at_beam_points_and_sphere():
    robot = load_robot(ABB)
    chain = bind(robot, beams(robot, robot.geometry))
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-3
    np.testing.assert_allclose(chain.parameters["artefact.sphere1_radius"], RADIUS, atol=0.01)
    np.testing.assert_allclose(
        [chain.parameters[f"artefact.sphere1_{a}"] for a in "xyz"], CENTRE, atol=0.01
    )
    direction = Rotation.from_rotvec([chain.parameters[f"tool.r{a}"] for a in "xyz"]).as_matrix()[
        :, 2
    ]
    assert abs(direction @ BEAM[1]) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("spheres", [1, 3], ids=["bound", "too few points for a sphere"])
def test_the_jacobian_is_the_derivative(arm, spheres):
    robot, geometry = arm
    model = Model(bind(robot, beams(robot, geometry, each=4, spheres=spheres)))
    everything = model.parameters.only(np.ones(len(model.parameters), bool))
    everything = everything.unpack(everything.pack() + 1e-3)
    expected = differences(lambda x: model.residual(everything.unpack(x)), everything.pack(), 1e-6)
    assert_rows(model.linearise(everything)[1], expected, 1e-4)
    assert model.chain.measurement.spheres == (1 if spheres == 1 else 0)


def test_exact_beams_are_met_and_unseen_ones_predicted(arm):
    robot, geometry = arm
    recording = beams(robot, geometry, points=12, each=8)
    test = np.arange(recording.n) % 4 == 0
    model = Model(bind(robot, recording, start_on=~test))
    free = model.parameters.free("tool.*", "artefact.*", *geometry_free(robot))
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    fit = solve(model.at(~test), free)
    assert fit.converged and np.abs(fit.residual).max() < 1e-5
    assert np.abs(model.residual(fit.parameters)[:, test]).max() < 2e-3


@pytest.mark.slow
def test_the_main_job_takes_beams(arm):
    robot, geometry = arm
    answer = calibrate(beams(robot, geometry, points=12, each=10, sigma=0.02), folds=5).as_json()
    assert answer["measures"] == "laser-spot" and answer["nominal"]["rms_mm"] > 0.2
    assert (
        answer["held_out"]["rms_mm"] < 0.05
    )  # sigma 0.02 in each of two directions across the beam is 0.028
    tied = {row["name"]: row for row in answer["parameters"]}
    assert not any(tied[name]["identifiable"] for name in ("d1", "theta1", "d6"))
