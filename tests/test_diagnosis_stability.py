"""A term stays only where folds that searched by themselves find most of what it makes."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation.folds import SPACE, Scheme, schemes
from workbench.diagnosis.validation.held_out import Errors
from workbench.diagnosis.validation.stability import Nested, effects_of, stable_terms
from workbench.diagnosis.validation.terms import Term


def bare(law, label: str = "") -> Finding:
    return Finding(law.effect, law.where, label, (law,), 1e-9, 1.0, 0.1, 1.0)


def wave(order: int) -> Finding:
    """A harmonic of joint 3."""
    return bare(CATALOGUE["transmission-harmonic"]("joint-3", order), f"order {order}")


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


def test_samples_between_the_others_around_an_instant_do_not_refuse_a_step():
    """The block of the workspace that is held out is a tenth of the time: the others do not know when the step was."""
    step = CATALOGUE["zero-shift"]("joint-2", 20.0 * 41.5)
    bench = bench_of(recorded(3, [step], [1.5e-3], n=80))
    scheme = Scheme(SPACE, np.select([np.arange(80) < 36, np.arange(80) < 48], [0, 1], 2))
    at = {0: step.after, 1: 20.0 * 35.5, 2: step.after}
    found = {k: [bare(CATALOGUE["zero-shift"]("joint-2", after))] for k, after in at.items()}
    errors = Errors(bench)
    plain = errors((), scheme.fold)
    predicted = errors.predicted(scheme.fold, {k: effects_of(f) for k, f in found.items()})
    nested = [Nested(scheme, plain, predicted, found, 30.0)]
    kept, lost = stable_terms(bench, [Term(bare(step))], nested, np.ones(80, bool))
    assert not lost and kept[0].t_nested > 10


def nested_searches(bench, finding, found_in: int) -> list[Nested]:
    """Searches of all folds, of which the first `found_in` find the harmonic and the others find nothing."""
    plain, nested, left = bench.problem((), hypotheses=False), [], found_in
    errors = Errors(bench)
    for scheme in schemes(bench.pose, plain):
        found = {}
        for k in scheme.folds:
            found[k] = [finding] if left > 0 else []
            left -= 1
        laws = {k: effects_of(findings) for k, findings in found.items()}
        predicted = errors.predicted(scheme.fold, laws)
        nested.append(Nested(scheme, errors((), scheme.fold), predicted, found, 30.0))
    return nested


@pytest.mark.parametrize(("found_in", "is_stable"), [(100, True), (3, False)])
def test_a_term_of_a_minority_of_the_folds_has_no_certain_name(bench, found_in, is_stable):
    """The probability of its name is at most that of being found in one more fold, with `unknown` as alternative."""
    finding = wave(5)
    nested = nested_searches(bench, finding, found_in)
    kept, lost = stable_terms(bench, [Term(finding)], nested, np.ones(80, bool))
    assert not lost
    term = kept[0]
    if is_stable:
        assert term.finding.probability == 1.0 and not term.finding.alternatives
        return
    assert term.reselected_folds == 3
    limit = 4 / (term.searched_folds + 2)
    assert term.finding.probability == pytest.approx(limit)
    other = term.finding.alternatives[0]
    assert other.effect == "unknown" and other.probability == pytest.approx(1 - limit)
    assert not term.is_certain
