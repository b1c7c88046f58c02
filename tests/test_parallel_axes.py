"""Nominally parallel axes: a plan without Hayati's beta warns, and the one with it finds the error."""

import numpy as np
import pytest
import tomli_w

from robot_model import load_robot
from workbench.core.solution import Stage
from workbench.fitting.calibration_plans.parallel_axes import parallelism_warnings
from workbench.fitting.calibration_plans.plans import default_plan, read_plan
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.compare import compare
from workbench.jobs.robot.simulate import simulate, truth_of

SCENE = {
    "robot": "abb_irb120",
    "samples": 100,
    "sigma_mm": 0.001,
    "reflectors": [[30.0, -40.0, 100.0]],
    "payload_kg": [0.0, 1.0],
    "base": {"xyz_mm": [1500.0, 100.0, 300.0], "rpy_deg": [2.0, -1.0, 140.0]},
    "errors": {"length_mm": 0.3, "angle_deg": 0.03},
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    made = tmp_path_factory.mktemp("scene") / "scene.toml"
    made.write_text(tomli_w.dumps(SCENE))
    return made


def test_the_plan_with_beta_reaches_the_noise_and_the_one_without_warns(path):
    """Ordinary geometry errors, beta among them: without it they cannot be modelled."""
    recording = simulate(path)
    found = compare(recording, ["ye-2024", "ye-2024-hayati"], folds=4)
    without, with_beta = found.rows()
    assert without["held_out_rms_mm"] > 10 * with_beta["held_out_rms_mm"]
    assert with_beta["held_out_rms_mm"] < 0.004
    assert "joint-2.beta2" in found.calibrations[0].warnings[-1]
    assert not any("parallel" in sentence for sentence in found.calibrations[1].warnings)


def test_the_standard_deviation_of_the_held_out_distances_is_a_column(path):
    found = compare(simulate(path), ["ye-mdh", "ye-2024-hayati"], folds=4)
    for row, errors in zip(found.rows(), found.distances):
        assert row["held_out_std_mm"] == pytest.approx(float(np.std(errors)))
        square = row["held_out_mean_mm"] ** 2 + row["held_out_std_mm"] ** 2
        assert square == pytest.approx(row["held_out_rms_mm"] ** 2)


def test_plans_that_estimate_beta_or_no_geometry_do_not_warn(path):
    robot = load_robot("abb_irb120")
    chain = truth_of(path).model.chain
    assert parallelism_warnings(default_plan(chain), robot) == ()
    assert parallelism_warnings(read_plan("ye-2024-hayati"), robot) == ()
    assert parallelism_warnings([Stage("frames", "", free=("base.*",))], robot) == ()
    held = Stage("all", "", free=("joint-?.theta?",), hold=(("joint-2.beta2", 0.0),))
    assert parallelism_warnings([held], robot) == ()
    (sentence,) = parallelism_warnings(read_plan("ye-mdh"), robot)
    assert sentence.startswith("Axes 2 and 3 are nominally parallel")
    assert calibrate(simulate(path), "ye-mdh", folds=3).warnings[-1] == sentence
