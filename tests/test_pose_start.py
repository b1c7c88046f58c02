"""Base and tool start near the best fit, however little the flange's orientation varies."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pose_scenes import SPREADS_DEG, pose_scene
from robot_model.measurements.external_pose import ExternalPose
from robot_model.system import bind, geometry_free
from scenes import BALLS, KINDS, scene
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.core.solution import Stage
from workbench.fitting.calibration_plans.plans import frames_of
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.start_ambiguity import ambiguity_sentence
from workbench.jobs.robot.calibrate import calibrate

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


def half_turns(rng):
    """Frames of a flange that stays in place and is turned by 180 degrees about each of its axes, twice each."""
    turns = np.array(
        [np.diag(signs) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))] * 2, float
    )
    origin = np.repeat(rng.uniform(-500, 500, (3, 1)), 8, 1)
    return SimpleNamespace(end=tuple(turns.transpose(2, 1, 0)), end_origin=origin), turns


def test_bases_that_fit_equally_well_are_all_found():
    """Half turns commute with each other: turning base and tool by one of them changes nothing that is measured."""
    rng = np.random.default_rng(0)
    frames, turns = half_turns(rng)
    base, tool = Rotation.random(2, random_state=1).as_matrix()
    points = base @ (turns @ rng.uniform(-100, 100, 3) + frames.end_origin[:, 0]).T
    made = ExternalPose(points, base @ turns @ tool)
    found = made.system(frames).alternatives()
    assert len(found) == 4
    turned = [np.trace(start.rotations[0] @ found[0].rotations[0].T) for start in found[1:]]
    np.testing.assert_allclose(turned, -1, atol=1e-6)


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("spread_deg", [0.0, 0.1, 180.0])
def test_one_base_alone_fits_a_usual_recording(measures, spread_deg):
    made = pose_scene(3, spread_deg, 12, measures=measures)
    assert ambiguity_sentence(made.robot, made.recording) is None


def test_two_bases_are_a_warning():
    """Three balls, each seen once: as many numbers as unknowns."""
    made = scene("ball-centre", n=3, seed=1, balls={k: BALLS[k] for k in (1, 2, 4)})
    sentence = ambiguity_sentence(made.robot, made.recording)
    assert "fit the nominal arm equally well" in sentence
    assert sentence in check_samples(made.recording).warnings


@pytest.mark.parametrize("seed", [3, 11])
def test_a_plan_that_frees_the_whole_geometry_fits_as_well_as_the_default_geometry(seed):
    # Redundant parameters (beta between axes that are not parallel) must not replace lengths in the solve.
    scene = pose_scene(seed, 180.0, poses=120)
    every = Stage("geometry", "all of it", free=("base.*", "tool.*", "joint-*.*"), earn=False)
    convention = replace(every, free=("base.*", "tool.*", *geometry_free(scene.robot)))
    errors = [
        calibrate(scene.recording, [stage]).held_out["rms_mm"] for stage in (every, convention)
    ]
    assert errors[0] < 1.02 * errors[1]
    assert errors[1] < 1.5 * np.sqrt(3) * scene.recording.sigma_mm
