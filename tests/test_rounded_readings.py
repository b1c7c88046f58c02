"""Readings that are rounded at all joints: their rounding errors are noise of a known size, and no effect of the arm."""

from dataclasses import replace

import numpy as np
import pytest

from noise_scenes import recorded
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded as with_effect
from workbench.diagnosis.noise.random_effects import known_rounding
from workbench.diagnosis.noise.rounded_readings import rounding_site
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.answer import diagnose

_WITHOUT = ("accel", "approach", "qdot", "temperature", "payload", "range")


def rounded(step_deg):
    """Noise of 0.02 mm, and readings on a lattice."""
    made = recorded(3, n=100)
    columns = {k: v for k, v in made.columns.items() if not k.startswith(_WITHOUT)}
    for name in [name for name in columns if name.endswith("_deg")]:
        columns[name] = np.round(columns[name] / step_deg) * step_deg
    return replace(made, columns=columns)


@pytest.mark.parametrize("step_deg", [0.02, 0.05])
def test_all_joints_are_named_and_the_noise_contains_their_rounding(step_deg):
    found = diagnose(rounded(step_deg))
    assert found.verdict == "explained"
    assert {t.finding.effect for t in found.terms} == {"reading-lattice"}
    assert len(found.terms) == 6
    # 30 parameters from 300 numbers add a tenth to a fifth to the held-out error
    assert 0.75 < found.proof.noise / found.proof.after < 1.05


def test_a_lattice_too_fine_to_matter_is_not_named():
    found = diagnose(rounded(1e-4))
    assert found.verdict == "consistent" and not found.terms


def test_one_rounded_joint_hides_no_effect_of_another():
    """Rounding errors of one joint that exceed the noise are in it from the start of the search.

    They have one direction at each pose. Without them, functions of joint 1 follow them, and the step is one of link 1.
    """
    step = CATALOGUE["zero-shift"]("joint-2", after=900.0)
    made = with_effect(6, effects=(step,), values=(4e-4,), n=110)
    rounded_column = np.round(made.columns["q1_deg"] / 0.05) * 0.05
    found = diagnose(replace(made, columns={**made.columns, "q1_deg": rounded_column}))
    assert found.verdict == "explained"
    named = {(t.finding.effect, t.finding.where) for t in found.terms}
    assert named == {("zero-shift", "joint-2"), ("reading-lattice", "joint-1")}


def test_round_numbers_that_the_arm_reached_are_no_rounding_errors():
    """A plan in whole degrees: nothing was rounded after the arm had moved."""
    bench = bench_of(with_effect(5, n=110))
    problem = bench.problem(())
    whole = {
        f"q{k}": np.deg2rad(np.round(np.rad2deg(problem.covariates[f"q{k}"]))) for k in range(1, 7)
    }
    rounded_problem = replace(problem, covariates={**problem.covariates, **whole})
    assert rounding_site(rounded_problem) is not None
    assert known_rounding(rounded_problem, 0.005) is None
