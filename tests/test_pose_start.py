"""Base and tool start near the best fit, however little the flange's orientation varies."""

from dataclasses import replace

import numpy as np
import pytest

from pose_scenes import SPREADS_DEG, pose_scene
from robot_model.system import bind
from scenes import KINDS, scene
from workbench.core.model import Model
from workbench.core.solve import Fit, solve
from workbench.plans import frames_of

# what the geometry errors of the scenes leave, with base and tool fitted
LARGEST_MM, LARGEST_DEG = 8.0, 1.2


def fit_base_and_tool(made, start=None) -> Fit:
    model = Model(bind(made.robot, made.recording, start))
    parameters = model.parameters
    return solve(model, parameters.only(parameters.matching(*frames_of(parameters))))


def errors(fit: Fit) -> tuple[float, float]:
    """RMS position error, mm, and RMS orientation error, deg; 0 where no orientation is measured."""
    squares = (fit.residual**2).reshape(-1, fit.residual.shape[1])
    turn = squares[3:].sum(0).mean() if len(squares) > 3 else 0.0
    return float(np.sqrt(squares[:3].sum(0).mean())), float(np.rad2deg(np.sqrt(turn)))


def assert_near(fit: Fit):
    position, orientation = errors(fit)
    assert position < LARGEST_MM and orientation < LARGEST_DEG, (position, orientation)


@pytest.mark.parametrize("spread_deg", (0.0, 0.02, *SPREADS_DEG))
@pytest.mark.parametrize("seed", range(3))
def test_an_external_pose_starts_at_any_spread_of_orientations(spread_deg, seed):
    assert_near(fit_base_and_tool(pose_scene(seed, spread_deg)))


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("spread_deg", (0.0, 0.1, 3.0))
@pytest.mark.parametrize("seed", range(2))
def test_every_kind_starts_where_orientations_are_nearly_equal(measures, spread_deg, seed):
    assert_near(fit_base_and_tool(pose_scene(10 + seed, spread_deg, measures=measures)))


@pytest.mark.parametrize("poses", [3, 4, 5, 8])
@pytest.mark.parametrize("spread_deg", (0.1, 3.0, 180.0))
def test_few_poses_start(poses, spread_deg):
    assert_near(fit_base_and_tool(pose_scene(20 + poses, spread_deg, poses)))


@pytest.mark.parametrize("spread_deg", (0.1, 180.0))
def test_gross_errors_in_a_tenth_of_the_rows_do_not_move_the_start(spread_deg):
    made = pose_scene(31, spread_deg)
    columns = dict(made.recording.columns)
    columns["x_mm"] = columns["x_mm"] + np.where(np.arange(40) % 10 == 3, 500.0, 0.0)
    wrong = replace(made, recording=replace(made.recording, columns=columns))
    chain = bind(wrong.robot, wrong.recording)
    residual = chain.evaluate(chain.parameters.values, {}).residual[:3]
    assert np.median(np.linalg.norm(residual, axis=0)) < LARGEST_MM


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("still", ["all joints", "all but one", "one pose"])
def test_rank_deficient_recordings_start_without_an_exception(measures, still):
    made = scene(measures, n=12, seed=5)
    columns = dict(made.recording.columns)
    if still == "one pose":
        columns = {name: np.repeat(column[:1], 12) for name, column in columns.items()}
    moving = [f"q{k}_deg" for k in range(1 if still == "all joints" else 2, 7)]
    columns |= {name: np.full(12, columns[name][0]) for name in moving}
    chain = bind(made.robot, replace(made.recording, columns=columns))
    assert np.isfinite(chain.start).all()
