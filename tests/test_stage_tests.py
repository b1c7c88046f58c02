"""Stages of a plan are retained for gains that are larger than chance, and not for the sign of a negligible one."""

from types import SimpleNamespace

import numpy as np
import pytest

from datasets.makers import gubankov
from workbench.fitting.calibration_plans.stage_tests import is_retained, partial_f_p_value
from workbench.fitting.cross_validation import HeldOut
from workbench.jobs.robot.calibrate import calibrate

N, FOLD = 100, np.repeat(np.arange(10), 10)


def step(residual, degrees):
    """What a stage test reads of a step: its held-out errors are those of its fit."""
    model = SimpleNamespace(at=lambda rows: SimpleNamespace(sigma=lambda parameters: 1.0))
    fit = SimpleNamespace(residual=residual, degrees=degrees, parameters=None)
    return SimpleNamespace(model=model, fit=fit, held_out=HeldOut(residual, FOLD))


def test_a_negligible_gain_in_every_fold_retains_no_stage():
    noise = np.random.default_rng(0).normal(size=(3, N))
    before, after = step(noise, 280.0), step(noise * (1 - 1e-6), 279.9)
    assert after.held_out.beats(before.held_out)
    assert not is_retained(before, after, 5, np.ones(N, bool))


def test_a_large_gain_retains_a_stage():
    noise = np.random.default_rng(0).normal(size=(3, N))
    before, after = step(noise, 280.0), step(0.9 * noise, 275.0)
    assert is_retained(before, after, 5, np.ones(N, bool))
    assert not is_retained(after, before, 5, np.ones(N, bool))


def test_the_p_value_is_uniform_where_a_column_is_random():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        noise = rng.normal(size=60)
        columns = rng.normal(size=(60, 3))
        left = noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
        found.append(partial_f_p_value((noise[None], left[None]), 1.0, (60.0, 57.0)))
    assert np.mean(np.array(found) < 0.1) == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize(("arm", "seed"), [("rv2fb", 1), ("rv2fb", 18), ("ur10e", 2)])
def test_touches_with_driving_errors_alone_keep_the_geometry_alone(arm, seed):
    made = getattr(gubankov, arm)(0.16, seed)
    found = calibrate(made.recording())
    assert [stage.name for stage in found.stages if stage.earned] == ["geometry"]
