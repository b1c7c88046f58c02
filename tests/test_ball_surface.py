"""Points on balls, seen from a flange: as good a measurement as the balls' centres, and the same arm comes out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from datasets.recording import Recording
from robot_model.effects import CATALOGUE
from robot_model.system import bind, geometry_free
from scenes import ABB, assert_rows, differences, scene
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.jobs.robot.calibrate import calibrate


def surface(n=40, each=12, seed=0, sigma=0.0, spread=0.9):
    """The ball centres of a scene as points on a cap of each ball that faces the sensor."""
    made = scene("ball-centre", n=n, seed=seed)
    rng = np.random.default_rng(seed)
    centre = np.repeat(made.recording.points, each, 0)
    radius = np.repeat([made.recording.balls[int(b)][3] for b in made.recording.ball], each)
    away = (
        -centre / np.linalg.norm(centre, axis=1, keepdims=True)
        + spread * rng.normal(size=centre.shape) * 0.5
    )
    points = centre + (radius + sigma * rng.standard_normal(len(radius)))[
        :, None
    ] * away / np.linalg.norm(away, axis=1, keepdims=True)
    columns = {k: np.repeat(v, each, 0) for k, v in made.recording.columns.items()}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), points.T)) | {
        "sample": np.arange(1.0, len(points) + 1)
    }
    columns["pose"] = np.repeat(np.arange(1.0, n + 1), each)
    return made, Recording(
        "ball-surface",
        columns,
        ABB,
        sigma_mm=max(sigma, 0.01),
        balls=made.recording.balls,
        name="surface",
    )


def test_exact_points_start_at_base_and_hand_eye():
    made, recording = surface()
    chain = bind(made.robot, recording)
    assert np.abs(chain.evaluate(chain.parameters.values, {}).residual).max() < 1e-6


def test_the_jacobian_is_the_derivative():
    made, recording = surface(n=8, each=6)
    model = Model(bind(made.robot, recording))
    everything = model.parameters.only(np.ones(len(model.parameters), bool))
    everything = everything.unpack(everything.pack() + 1e-3)
    expected = differences(lambda x: model.residual(everything.unpack(x)), everything.pack(), 1e-6)
    assert_rows(model.linearise(everything)[1], expected, 1e-4)


def test_points_and_centres_give_the_same_arm():
    made, recording = surface(n=60, each=15, sigma=0.02)
    model = Model(bind(made.robot, recording))
    fit = solve(model, model.parameters.free("base.*", "sensor.*", *geometry_free(made.robot)))
    assert fit.converged and fit.sigma_scale == pytest.approx(1, abs=0.08)
    moved = fit.parameters.values[6:36] - made.robot.geometry.ravel()
    assert np.abs(moved.reshape(6, 5)[:, 1:3]).max() < 0.1


def test_the_main_job_takes_points_on_balls():
    _, recording = surface(n=40, each=10, sigma=0.02)
    answer = calibrate(recording, folds=5).as_json()
    assert answer["held_out"]["rms_mm"] < 0.03 and answer["held_out"]["folds"] == 5


def test_lines_across_a_ball_are_a_sentence():
    made, recording = surface(n=6, each=3)
    with pytest.raises(InputError, match="4 points of a ball that are not in one plane"):
        bind(made.robot, recording)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_lateral_scale_of_the_sensor_is_estimated(axis):
    made, recording = surface(n=60, each=15, sigma=0.02)
    name = f"{axis}_mm"
    columns = {**recording.columns, name: 1.004 * recording.columns[name]}
    scaled = replace(recording, columns=columns)
    effect = CATALOGUE["lateral-scale"]("sensor", axis)
    model = Model(bind(made.robot, scaled), (effect,))
    fit = solve(model, model.parameters.free("base.*", "sensor.*"))
    assert fit.sigma_scale == pytest.approx(1, abs=0.08)
    scale = fit.parameters.values[fit.parameters.index[f"sensor.lateral-scale.scale_{axis}"]]
    assert scale == pytest.approx(0.004, abs=1e-4)


def test_the_lateral_scale_is_a_candidate_for_profilers_alone():
    points = np.random.default_rng(0).normal(size=(3, 20))
    for y, expected in ((points[1], 0), (0 * points[1], 1)):
        state = SimpleNamespace(points=np.stack([points[0], y, points[2]]))
        chain = SimpleNamespace(state=state, places=lambda kind: ("sensor",))
        found = list(CATALOGUE["lateral-scale"].candidates(chain))
        assert [variant.effect.axis for variant in found] == ["x"] * expected
