"""Few poses: the noise of positions stays known, one stage has all errors of joints, and couplings have a stage."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.makers import gubankov
from robot_model.effects import CATALOGUE
from robot_model.system import bind
from scenes import scene
from test_diagnosis_engine import SIGMA, recorded
from workbench.core.errors import InputError
from workbench.core.solution import Stage
from workbench.files.results import StageResult
from workbench.fitting.calibration_plans.plans import (
    FEW_POSES,
    base_and_tool,
    geometry,
    plan_of_recording,
)
from workbench.fitting.cross_validation import HeldOut
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.stages import with_errors_of_result

NOISE_MM = 0.05
POSE = ("qw", "qx", "qy", "qz")


def few_noisy_poses(n: int):
    """External poses of the nominal arm with noise that nobody states."""
    made = scene("external-pose", n=n, sigma=None).recording
    rng = np.random.default_rng(2)
    columns = dict(made.columns)
    for name in ("x_mm", "y_mm", "z_mm"):
        columns[name] = columns[name] + rng.normal(0, NOISE_MM, n)
    turned = Rotation.from_rotvec(rng.normal(0, 3e-4, (n, 3))) * Rotation.from_quat(
        np.column_stack([columns[name] for name in POSE]), scalar_first=True
    )
    columns |= dict(zip(POSE, turned.as_quat(scalar_first=True).T))
    return replace(made, columns=columns)


def waves(chain):
    """The geometry, and five orders of the transmission error of every joint."""
    rows = [
        ("transmission-harmonic", f"joint-{k}", {"order": order})
        for k in range(1, 7)
        for order in range(1, 6)
    ]
    return geometry(chain.robot), Stage("waves", "gears", tuple(rows), earn=False)


def test_positions_that_could_be_interpolated_keep_their_noise():
    # 54 coordinates of positions and more parameters: orientations alone leave degrees of freedom
    result = calibrate(few_noisy_poses(18), waves)
    assert result.fit["rms_mm"] > 0.3 * NOISE_MM
    assert result.held_out["rms_mm"] > NOISE_MM


def test_one_stage_has_all_errors_of_joints_and_bearings_of_few_poses():
    made = scene("external-point", n=FEW_POSES)
    chain = bind(made.robot, made.recording)
    names = [stage.name for stage in plan_of_recording(chain)]
    assert names == ["geometry", "coupling", "transmission and compliance"]
    repeated = chain.at(np.repeat(np.arange(FEW_POSES), 2))
    assert [stage.name for stage in plan_of_recording(repeated)] == names
    made = scene("external-point", n=FEW_POSES + 1)
    many = plan_of_recording(bind(made.robot, made.recording))
    assert "joint curves" in [stage.name for stage in many]
    rows = {row[:2] for stage in many if stage.name != "drift" for row in stage.effects}
    assert rows == {row[:2] for stage in plan_of_recording(chain) for row in stage.effects}


def test_coupled_wrist_joints_are_no_other_effect():
    kind = CATALOGUE["joint-coupling"]
    made = recorded(4, [kind("joint-6", 5), kind("joint-5", 4)], [0.012, 0.003], n=120)
    result = calibrate(made)
    assert [stage.name for stage in result.stages if stage.earned] == ["geometry", "coupling"]
    parameters = result.solution.parameters
    assert abs(parameters["joint-6.joint-coupling.from5"] - 0.012) < 3e-4
    assert abs(parameters["joint-5.joint-coupling.from4"] - 0.003) < 3e-4


def test_the_last_retained_stage_has_the_errors_of_the_result():
    def stage(name, earned):
        return StageResult(name, "", 3, 3, 0.5, 0.6, earned, "", "converged", ())

    fit = SimpleNamespace(residual=np.full((3, 4), 0.1))
    step = SimpleNamespace(fit=fit, free=9, rank=8)
    held_out = HeldOut(np.full((3, 4), 0.2), np.zeros(4, int))
    stages = [stage("geometry", True), stage("gears", False), stage("bending", True)]
    stages = with_errors_of_result([*stages, stage("drift", False)], step, held_out)
    assert [row.held_out_rms_mm for row in stages] == [0.6, 0.6, held_out.rms, 0.6]
    assert (stages[2].free, stages[2].identifiable) == (9, 8)


def test_a_fit_that_nearly_interpolates_does_not_make_its_noise_zero():
    # 60 coordinates and 70 parameters; the noise is not stated
    made = replace(recorded(6, n=20), sigma_mm=None)
    result = calibrate(made, waves)
    noise = np.sqrt(3) * SIGMA
    assert result.fit["rms_mm"] > 0.2 * noise
    assert result.held_out["rms_mm"] > noise


def test_folds_know_no_value_that_the_fit_of_all_poses_left():
    # 36 coordinates: most columns are dependent only because there are so few rows
    kind = CATALOGUE["joint-compliance"]
    made = recorded(4, [kind("joint-2"), kind("joint-3")], [5e-6, 8e-6], n=12)
    result = calibrate(made)
    assert result.stages[-1].earned
    parameters = result.solution.parameters
    held = ~parameters.mask & (parameters.precision > 0)
    np.testing.assert_allclose(parameters.values[held], parameters.nulls[held], atol=1e-12)
    assert result.held_out["rms_mm"] > np.sqrt(3) * SIGMA


def test_a_fit_without_degrees_of_freedom_states_no_error():
    """Four touches of one point are met exactly by any arm: their held-out error would be a rounding error."""
    made = gubankov.ur10e(0.3, 5).recording()
    touched = made.columns["point"] == made.columns["point"][0]
    few = replace(made.select(np.flatnonzero(touched)[:4]), sigma_mm=None)
    with pytest.raises(
        InputError, match="the fit is exact .* neither noise nor error can be stated"
    ):
        calibrate(few, trust_data=True)
    result = calibrate(few, [base_and_tool()], trust_data=True)
    assert result.held_out["rms_mm"] > 0.05
