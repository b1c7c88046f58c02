"""An error curve of a joint with few bends may be the torque of a hose or a spring; one with many may not."""

import numpy as np

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import found, worn
from workbench.explanation.planning import experiment
from workbench.explanation.result import Term

TORQUE = ("joint-torque", "joint-3")


class Worn(CATALOGUE["joint-coupling"]):
    """A bump of a gear."""

    def basis(self, state):
        return worn(state.variables[2])[None, None]


class Hose(CATALOGUE["joint-coupling"]):
    """A torque that grows on one side, with no period."""

    def basis(self, state):
        return (np.exp(1.5 * state.variables[2]) - state.variables[2])[None, None]


def curve_of(law, value: float):
    """The finding of the error curve of joint 3, and its alternatives by name."""
    answer = found(11, [law], [value])
    curve = next(f for f in answer.findings if f.where == "joint-3")
    return curve, {(a.effect, a.where): a for a in curve.alternatives}


def test_a_curve_with_few_bends_is_as_probable_as_the_torque_of_a_hose():
    curve, others = curve_of(Hose("joint-3", joint=4), 4e-4)
    assert curve.effect == "joint-curve" and TORQUE in others
    assert others[TORQUE].probability == curve.probability <= 0.5
    assert "without the hose or the spring" in experiment._by_word(Term(curve))


def test_a_worn_patch_is_no_torque():
    curve, others = curve_of(Worn("joint-3", joint=4), 1.2e-3)
    assert curve.effect == "joint-curve" and TORQUE not in others
