"""Harmonics of one order at several joints, as of equal gears, and harmonics that look like noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search import common_orders
from workbench.diagnosis.search.common_orders import (
    LOG_ODDS_OF_COMMON,
    common_order_p_value,
    harmonics_of_common_order,
    order_group,
    rounded_order,
    with_common_orders,
)
from workbench.diagnosis.search.objective import LogPosterior
from workbench.diagnosis.search.prior import SECOND
from workbench.diagnosis.search.select import found_terms
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.noise.hidden_harmonics import hidden_harmonics, least_gain
from workbench.explanation.noise.stated_noise import FROM_RESIDUALS, NoiseRatio, finding_of
from workbench.explanation.result import AMBIGUOUS, EXPLAINED, verdict_of
from workbench.explanation.sentences.statements import statement

HARMONIC = "transmission-harmonic"
JOINTS = tuple(f"joint-{k}" for k in range(1, 6))


def harmonics(order, joints=JOINTS):
    return [CATALOGUE[HARMONIC](where, order) for where in joints]


def with_harmonics(seed, size, order=200.0, n=80):
    """Bench of an arm with equal harmonics at five joints, each of its own phase; size: rad of joint 1."""
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(JOINTS))
    sizes = size * np.array([1.5, 1.0, 0.9, 2.4, 6.0])  # about as visible at each joint
    values = np.stack([sizes * np.cos(phases), sizes * np.sin(phases)], 1).ravel()
    return bench_of(recorded(seed, harmonics(order), values, n=n))


@pytest.fixture(scope="module")
def faint():
    """Harmonics of which none is significant by itself."""
    return with_harmonics(4, 3.6e-5)


def found_harmonics(bench) -> set:
    terms = found_terms(bench)
    return {f.where for f in terms if f.effect == HARMONIC and f.effects[0].order == 200.0}


def test_orders_are_rounded_as_they_are_searched():
    assert [rounded_order(order) for order in (17.4, 17.6, 160.2, 319.9)] == [17.5, 17.5, 160, 320]


def test_harmonics_of_one_order_are_found_together(faint, monkeypatch):
    problem = faint.problem().conditional_on(())
    table = ranked_hypotheses(problem)
    together = harmonics_of_common_order(problem, table)
    assert {h.effects[0].order for h in together} == {200.0}
    assert common_order_p_value(problem) < 1e-4
    assert {"joint-1", "joint-2", "joint-3"} <= found_harmonics(faint)


def test_harmonics_by_themselves_are_not_found(faint, monkeypatch):
    search = "workbench.diagnosis.search"
    monkeypatch.setattr(f"{search}.prior.LOG_ODDS_OF_COMMON", -np.inf)
    monkeypatch.setattr(f"{search}.most_probable_set.harmonics_of_common_order", lambda *args: [])
    monkeypatch.setattr(f"{search}.state.with_common_orders", lambda table, terms: list(table))
    monkeypatch.setattr(f"{search}.select.common_order_p_value", lambda problem: 1.0)
    assert len(found_harmonics(faint)) < 3


def test_an_order_is_as_likely_as_not_at_further_joints(faint):
    problem = faint.problem().conditional_on(())
    objective = LogPosterior.of(
        problem, harmonics_of_common_order(problem, ranked_hypotheses(problem))
    )
    priors = objective.priors
    highest = priors.log_prior.max()
    numbers = list(range(len(priors.log_prior)))
    expected = highest + (len(numbers) - 1) * (LOG_ODDS_OF_COMMON + SECOND)
    assert priors.of(numbers) == pytest.approx(expected)
    assert priors.of(numbers[::-1]) == pytest.approx(expected)
    added = priors.of(numbers) - priors.of(numbers[:-1])
    assert priors.conditional(numbers[:-1])[numbers[-1]] == pytest.approx(added)


def test_the_prior_of_a_set_is_that_of_its_steps(faint):
    """Also where a joint has an error curve, of which its harmonics are a part: they show no gear."""
    problem = faint.problem().conditional_on(())
    table = ranked_hypotheses(problem)
    curve = next(h for h in table if h.key == ("joint-curve", "joint-1"))
    backlash = next(h for h in table if h.effect == "zero-shift")
    together = harmonics_of_common_order(problem, table)
    priors = LogPosterior.of(problem, [*together, curve, backlash]).priors
    numbers = list(range(len(together) + 2))
    for k in range(len(numbers)):
        step = priors.of(numbers[: k + 1]) - priors.of(numbers[:k])
        assert priors.conditional(numbers[:k])[k] == pytest.approx(step)
    assert [h.where for h in together][0] == "joint-1"
    waves_alone = numbers[: len(together)]
    with_curve = [*waves_alone, len(together)]
    lost = priors.of(with_curve) - priors.of(waves_alone) - priors.log_prior[len(together)] - SECOND
    assert lost < -5  # the harmonic of joint 1 counts as a part of the curve


def test_a_table_next_to_a_harmonic_has_the_order_of_other_joints(faint):
    problem = faint.problem().conditional_on(())
    table = ranked_hypotheses(
        problem, common_orders.required_harmonics(problem, _harmonic_rows(problem))
    )
    raised = with_common_orders(table, _harmonic_rows(problem))
    common = [h for h in raised if h.log_bonus > 0]
    assert {order_group(h) for h in common} == {200.0}
    assert "joint-1" not in {h.where for h in common}
    assert all(h.log_prior + h.log_bonus == pytest.approx(LOG_ODDS_OF_COMMON) for h in common)
    assert sum(h.weight for h in common) <= 0.5
    before = {(h.key, h.label): h.weight for h in table}
    assert all(h.weight <= before[h.key, h.label] for h in raised if not h.log_bonus)


def _harmonic_rows(problem):
    """The harmonic of order 200 at joint 1 as a row of a table."""
    wanted = [("joint-1", 200.0)]
    rows = harmonics_of_common_order(problem, ranked_hypotheses(problem))
    return [h for h in rows if (h.where, order_group(h)) in wanted]


def test_noise_alone_has_no_common_order():
    for seed in (11, 12):
        bench = bench_of(recorded(seed, n=80))
        problem = bench.problem().conditional_on(())
        assert harmonics_of_common_order(problem, ranked_hypotheses(problem)) == []
        assert common_order_p_value(problem) > 0.05


def ratio(factor):
    return NoiseRatio(factor, 0.05, 1e-6, FROM_RESIDUALS, factor)


def harmonic_term():
    return Term(
        Finding(
            HARMONIC,
            "joint-1",
            "order 200",
            tuple(harmonics(200.0, JOINTS[:1])),
            1e-9,
            1.0,
            1.0,
            9.0,
        )
    )


def test_noise_next_to_a_harmonic_is_confounded_with_harmonics_in_few_poses(faint):
    hidden = hidden_harmonics(ratio(1.5), [harmonic_term()], 160.0, faint.chain)
    assert {a.where for a in hidden} == {f"joint-{k}" for k in range(2, 7)}
    term = Term(finding_of(ratio(1.5), hidden), kept=True)
    assert verdict_of((harmonic_term(), term), 1e-9) == AMBIGUOUS
    text = statement(term, "the reflector", "mm")
    assert "look like noise in so few poses" in text
    assert "joint 6" in text
    clear = Term(finding_of(ratio(1.5)), kept=True)
    assert verdict_of((harmonic_term(), clear), 1e-9) == EXPLAINED


def test_noise_is_not_confounded_with_harmonics_that_the_poses_would_show(faint):
    enough = 1.01 * least_gain(5) * 5 / (1 - 1.5**-2)
    assert hidden_harmonics(ratio(1.5), [harmonic_term()], enough, faint.chain) == ()
    assert hidden_harmonics(ratio(1.5), [], 160.0, faint.chain) == ()
    assert hidden_harmonics(ratio(0.7), [harmonic_term()], 160.0, faint.chain) == ()
    slow = SimpleNamespace(finding=SimpleNamespace(effects=harmonics(2.0, JOINTS[:1])))
    assert hidden_harmonics(ratio(1.5), [slow], 160.0, faint.chain) == ()
