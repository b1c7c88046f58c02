"""A SCARA on a slide: four axes are parallel but for their errors, which determines some parameters hardly at all."""

import numpy as np
import pytest
import tomli_w

import datasets
from workbench.core.least_squares.identifiability import independent
from workbench.core.parameters import Parameter, Parameters
from workbench.core.solution import Stage
from workbench.jobs.robot.calibrate import calibrate
from workbench.recordings.inspection.inspect import inspect_recording

NOISE_MM = 1e-5
JOINTS = [
    {"kind": "prismatic", "theta_deg": 0.0, "d_mm": 0.0, "a_mm": 90.0, "alpha_deg": -90.0},
    {"theta_deg": 0.0, "d_mm": 420.0, "a_mm": 455.0, "alpha_deg": 0.0},
    {"theta_deg": 0.0, "d_mm": 60.0, "a_mm": 390.0, "alpha_deg": 180.0},
    {"kind": "prismatic", "theta_deg": 0.0, "d_mm": 100.0, "a_mm": 0.0, "alpha_deg": 0.0},
    {"theta_deg": 0.0, "d_mm": 45.0, "a_mm": 0.0, "alpha_deg": 0.0},
]
RANGES = [(0, 1800), (-120, 120), (-130, 130), (0, 250), (-170, 170)]


def rotation(axis, angle):
    """(n, 4, 4) about x, y or z."""
    angle = np.atleast_1d(angle)
    made = np.tile(np.eye(4), (len(angle), 1, 1))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    made[:, i, i] = made[:, j, j] = np.cos(angle)
    made[:, j, i] = np.sin(angle)
    made[:, i, j] = -np.sin(angle)
    return made


def shift(*along):
    """(n, 4, 4) by x, y, z."""
    x, y, z = np.broadcast_arrays(*map(np.atleast_1d, along))
    made = np.tile(np.eye(4), (len(x), 1, 1))
    made[:, :3, 3] = np.stack([x, y, z], axis=1)
    return made


def written(folder, seed, n=150, noise=NOISE_MM, ripple_mrad=0.0):
    """A recording of an arm whose every parameter is off, by its own multiplication of matrices; joint 2 may ripple."""
    mm, deg = 0.35, 0.06
    rng = np.random.default_rng(seed)
    joints = np.array([rng.uniform(*ends, n) for ends in RANGES])
    true = joints.copy()
    true[1] += np.rad2deg(1e-3 * ripple_mrad * np.sin(8 * np.deg2rad(joints[1])))
    pose = rotation(2, rng.uniform(-3, 3)) @ shift(*rng.uniform(-2000, 2000, 3))
    for joint, reading in zip(JOINTS, true):
        slides = joint.get("kind") == "prismatic"
        theta, alpha, beta = np.deg2rad(deg * rng.normal(size=3) + [0, joint["alpha_deg"], 0])
        d, a = mm * rng.normal(size=2) + [joint["d_mm"], joint["a_mm"]]
        turned = rotation(2, theta + (0 if slides else np.deg2rad(reading)))
        pose = pose @ turned @ shift(0, 0, d + (reading if slides else 0)) @ shift(a, 0, 0)
        pose = pose @ rotation(0, alpha) @ rotation(1, beta)
    points = (pose @ [40.0, 25.0, 60.0, 1.0])[:, :3] + noise * rng.normal(size=(n, 3))
    robot = {"name": "slide-scara", "convention": "distal", "joint": JOINTS}
    (folder / "robot.toml").write_text(tomli_w.dumps(robot))
    (folder / "recording.toml").write_text(
        'format = "recording/1"\nmeasures = "external-point"\ntitle = "SCARA on a slide"\n'
        f'sigma_mm = {noise}\n[robot]\nfile = "robot.toml"\n[samples]\nfile = "samples.csv"\n'
    )
    head = "sample,q1_mm,q2_deg,q3_deg,q4_mm,q5_deg,x_mm,y_mm,z_mm"
    table = np.column_stack([np.arange(1, n + 1), joints.T, points])
    np.savetxt(folder / "samples.csv", table, "%.9g", ",", header=head, comments="")
    return folder


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_geometry_errors_alone_are_fitted_to_the_noise(tmp_path, seed):
    found = calibrate(datasets.read(written(tmp_path, seed)), folds=4)
    rms = found.fit["rms_mm"]
    assert rms < 1.2 * np.sqrt(3) * NOISE_MM


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_a_stage_leaves_out_returns_when_a_later_one_has_made_the_residual_small(
    tmp_path, seed
):
    """With the ripple in the residual, weak combinations of the geometry are below what counts as noise."""
    recording = datasets.read(written(tmp_path, seed, noise=0.002, ripple_mrad=1.0))
    geometry = Stage("geometry", "", free=("base.*", "tool.*", "joint-*"), earn=False)
    effects = (("transmission-harmonic", "joint-2", {"order": 8.0}),)
    found = calibrate(recording, [geometry, Stage("ripple", "", effects=effects)], folds=4)
    first, last = found.stages
    assert first.rms_mm > 0.1 and last.rms_mm < 1.1 * np.sqrt(3) * 0.002
    assert last.identifiable > first.identifiable


def test_the_check_says_that_no_measurement_tests_the_sense_of_all_joints(tmp_path):
    needs = inspect_recording(datasets.read(written(tmp_path, 3, n=60))).needs
    (sentence,) = [need.what for need in needs if "opposite sign of all of them" in need.what]
    assert "q1_mm, q2_deg, q3_deg, q4_mm, q5_deg" in sentence


def test_rounding_that_nearly_dependent_columns_amplify_is_no_information():
    """Columns 0 and 1 differ by 1e-5 of their length, column 2 is their difference, column 3 is its own."""
    rng = np.random.default_rng(0)
    first, small, own = rng.normal(size=(3, 300))
    columns = np.stack([1e5 * first, 1e5 * first + small, 1e4 * small, small + 1e3 * own])
    table = Parameters.of([Parameter(f"tool.{k}", "mm") for k in range(4)]).free("*")
    free, tied = independent(columns @ columns.T, table)
    assert np.array(free.keys)[free.mask].tolist() == ["tool.0", "tool.1", "tool.3"]
    assert list(tied) == ["tool.2"]
