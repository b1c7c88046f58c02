"""A calibration without stated noise says that most of its residual is a gap of a joint, by the side from which it came."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
from workbench.fitting.verdicts.residual_structure import (
    SIDE,
    Samples,
    _joints_of_sides,
    structure,
)
from workbench.jobs.robot.calibrate import calibrate


def arm(half_gap: float, joint: int = 2, seed: int = 4, n: int = 90):
    """A recording of random poses with a gap at a joint, rad; without a stated noise."""
    gap = [CATALOGUE["backlash"](f"joint-{joint}", seat="moves")]
    return replace(recorded(seed, gap, [half_gap], n=n), sigma_mm=None)


@pytest.mark.parametrize("joint", [1, 3])
def test_a_gap_is_named_with_its_joint(joint):
    made = calibrate(arm(4e-4, joint))
    found = made.noise.findings.structure
    assert SIDE.format(f"joint {joint}") in found.depends_on
    sentence = calibration_verdict(made.held_out, made.noise).sentence
    assert f"depends on the side from which joint {joint} came" in sentence
    assert "is no noise" in sentence and "workbench diagnose" in sentence


def test_noise_alone_depends_on_no_side():
    made = calibrate(arm(0.0))
    assert not made.noise.findings.structure.found
    assert "is no noise" not in calibration_verdict(made.held_out, made.noise).sentence


def test_a_recording_without_reversals_has_no_side():
    """Joints that all move on in one direction come from one side."""
    made = calibrate(arm(0.0))
    state = made.model.chain.state
    one_side = {f"move{k}_side": np.ones(made.recording.n) for k in range(1, 7)}
    chain = replace(made.model.chain, state=replace(state, covariates=state.covariates | one_side))
    model = replace(made.model, chain=chain)
    fit = made.solution.fit
    n = made.recording.n
    samples = Samples(np.arange(n), np.arange(n))
    found = structure(model, fit.parameters, fit.residual, samples)
    assert not any("side" in name for name in found.depends_on)


def test_joints_whose_sides_explain_as_much_are_both_named():
    ratios = {0: 500.0, 2: 3.0, 3: 520.0}
    regression = SimpleNamespace(test=lambda column: SimpleNamespace(f=ratios[int(column[0])]))
    columns = np.arange(6)
    assert _joints_of_sides(regression, columns, np.array([0, 2, 3])) == "joint 4 or joint 1"


def test_three_targets_of_a_pose_count_as_one():
    """Errors of poses that all targets share are random from pose to pose, and depend on no side."""
    found = 0
    for seed in range(4):
        made = calibrate(with_three_targets(seed))
        found += any("side" in name for name in made.noise.findings.structure.depends_on)
    assert found == 0


def with_three_targets(seed: int):
    """40 poses of three rows each, displaced by a random error of joint 1 that the rows of a pose share."""
    plain = replace(recorded(seed, n=120, repeats=3), sigma_mm=None)
    rng = np.random.default_rng(seed)
    added = rng.normal(0, 0.05, 40).repeat(3)
    joint = plain.columns["q1_deg"] + added
    return replace(
        plain, columns=plain.columns | {"q1_deg": joint, "pose": np.arange(40).repeat(3)}
    )
