"""Parameters that cannot be negative are held at zero where the least-squares estimate is negative."""

import numpy as np
import pytest

from scenes import model_of, observed, scene
from workbench.core.least_squares.solver import solve
from workbench.fitting.nonnegative import solve_nonnegative

KEY = "joint-{}.joint-compliance.compliance"
JOINTS = (2, 3, 5)


def fitted(sizes, noise=1.0, seed=1):
    """A solved arm with joint compliances of the given true sizes (rad/(N m)), negative ones included."""
    made = scene("external-point", n=40, seed=seed)
    model = model_of(made, *(("joint-compliance", f"joint-{k}", {}) for k in JOINTS))
    truth = model.parameters.update({KEY.format(k): size for k, size in zip(JOINTS, sizes)})
    model = observed(model, truth, np.random.default_rng(seed), noise)
    keys = {KEY.format(k) for k in JOINTS}
    free = truth.only(truth.matching(*keys, "base.*", "tool.*"))
    return model, solve(model, free, "linear", 30)


def test_a_negative_compliance_is_held_at_zero_and_the_others_are_solved_again():
    model, fit = fitted((2e-5, -3e-5, 1e-5), noise=0.1)
    assert fit.parameters[KEY.format(3)] < 0
    bounded, held = solve_nonnegative(model, fit, "linear", 30)
    assert held == {KEY.format(3)}
    assert bounded.parameters[KEY.format(3)] == 0
    assert not bounded.parameters.mask[bounded.parameters.index[KEY.format(3)]]
    assert bounded.history[-1] >= fit.history[-1]
    assert bounded.parameters[KEY.format(2)] > 0


def test_what_stands_for_other_parameters_of_its_effect_may_be_negative():
    model, fit = fitted((2e-5, -3e-5, 1e-5), noise=0.1)
    tied = {"joint-3.joint-compliance.other": [KEY.format(3), KEY.format(2)]}
    bounded, held = solve_nonnegative(model, fit, "linear", 30, tied)
    assert bounded is fit and not held
    other = {"joint-4.joint-compliance.compliance": [KEY.format(3)]}
    assert solve_nonnegative(model, fit, "linear", 30, other)[1] == {KEY.format(3)}


def test_positive_compliances_stay_as_they_are():
    model, fit = fitted((2e-5, 3e-5, 1e-5), noise=0.1)
    bounded, held = solve_nonnegative(model, fit, "linear", 30)
    assert bounded is fit and not held


@pytest.mark.parametrize("seed", range(6))
def test_the_result_satisfies_the_conditions_of_the_bounded_minimum(seed):
    """No released parameter would lower the cost by a positive value (Karush-Kuhn-Tucker)."""
    model, fit = fitted((0.0, 0.0, 0.0), seed=seed)
    bounded, held = solve_nonnegative(model, fit, "linear", 30)
    for key in held:
        nudged = bounded.parameters.update({key: 1e-8})
        again = solve(model, nudged, "linear", 30)
        assert again.history[-1] >= bounded.history[-1] * (1 - 1e-9)
    values = [bounded.parameters[KEY.format(k)] for k in JOINTS]
    assert min(values) >= 0
