"""A term stays only where folds that searched by themselves find most of what it makes."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation.folds import schemes
from workbench.diagnosis.validation.held_out import Errors
from workbench.diagnosis.validation.stability import Nested, effects_of, stable_terms
from workbench.diagnosis.validation.terms import Term


def wave(order: int) -> Finding:
    """A harmonic of joint 3."""
    law = CATALOGUE["transmission-harmonic"]("joint-3", order)
    return Finding(law.effect, law.where, f"order {order}", (law,), 1e-9, 1.0, 0.1, 1.0)


@pytest.fixture(scope="module")
def bench():
    """Joint 3 has a harmonic of order 5."""
    effects = effects_of([wave(5)])
    return bench_of(recorded(1, effects, [4e-4, 0.0], n=80))


@pytest.mark.parametrize("order", [5, 2])
def test_a_term_that_no_fold_makes_is_not_kept_for_its_name(bench, order):
    """What the folds find reduces the held-out error, but the harmonic of another order has no part in it."""
    plain, nested = bench.problem((), hypotheses=False), []
    errors = Errors(bench)
    for scheme in schemes(bench.pose, plain):
        found = {k: [wave(5)] for k in scheme.folds}
        laws = {k: effects_of(findings) for k, findings in found.items()}
        predicted = errors.predicted(scheme.fold, laws)
        nested.append(Nested(scheme, errors((), scheme.fold), predicted, found, 30.0))
    kept, lost = stable_terms(bench, [Term(wave(order))], nested, np.ones(80, bool))
    if order == 5:
        assert not lost and kept[0].reselected_folds == kept[0].searched_folds > 0
    else:
        assert not kept and lost[0].reselected_folds == 0 and "no fold finds it" in lost[0].reason
