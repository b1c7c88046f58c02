"""A residual that is a smooth function of a joint or of a recorded column is distinguished from noise."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.system import bind
from scenes import ABB, SLIDING, scene
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.fitting.verdicts.residual_structure import JOINTS
from workbench.fitting.verdicts.smooth_dependence import smooth_dependence

SIGMA = 0.02


def dependence(seed, arm=ABB, change=lambda columns, u: {}):
    """The tests of a fitted arm whose simulated columns were changed; u: name -> column scaled to -1 ... 1."""
    made = scene("external-point", n=120, seed=seed, arm=arm, sigma=SIGMA)
    rng = np.random.default_rng(seed)
    columns = dict(made.recording.columns)
    for name in ("x_mm", "y_mm", "z_mm"):
        columns[name] = columns[name] + SIGMA * rng.standard_normal(120)
    u = {
        name: 2 * (values - np.min(values)) / max(np.ptp(values), 1e-9) - 1
        for name, values in columns.items()
        if np.issubdtype(np.asarray(values).dtype, np.number)
    }
    columns |= change(columns, u)
    model = Model(bind(made.robot, replace(made.recording, columns=columns)))
    fit = solve(model, model.parameters)
    return smooth_dependence(model, fit.parameters, fit.residual)


@pytest.mark.parametrize("arm", [ABB, SLIDING], ids=["revolute", "slide"])
def test_noise_depends_on_nothing(arm):
    assert not any(dependence(seed, arm).found for seed in range(4))


def test_a_sag_over_one_joint_is_seen():
    found = dependence(1, SLIDING, lambda c, u: {"z_mm": c["z_mm"] + 0.08 * u["q2_mm"] ** 2})
    assert found.depends_on == (JOINTS,) and 0.2 < found.share < 0.95


def test_a_joint_that_two_others_move_is_seen():
    """A hose: the error of joint 4 is a bent function of the sum of two other angles."""

    def change(columns, u):
        bend = 0.02 * np.tanh(2 * (u["q3_deg"] + u["q5_deg"]))
        return {"q2_deg": columns["q2_deg"] + bend}

    assert dependence(2, ABB, change).depends_on == (JOINTS,)


def test_a_recorded_column_is_named():
    def change(columns, u):
        return {"x_mm": columns["x_mm"] + 0.08 * u["payload_kg"] ** 2}

    assert "the recorded column payload_kg" in dependence(3, ABB, change).depends_on
