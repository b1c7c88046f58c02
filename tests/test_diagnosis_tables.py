"""What a search keeps: tables, sets less a member and rotations equal those computed again."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.chain import rotate
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search import select
from workbench.diagnosis.search.objective import LogPosterior


def solved():
    """A problem solved with three effects, with the clock and a slip in the recording."""
    effects = (
        CATALOGUE["joint-compliance"]("joint-3"),
        CATALOGUE["zero-shift"]("joint-1", after=2000.0),
        CATALOGUE["joint-compliance"]("joint-2"),
    )
    bench = bench_of(recorded(31, effects, [4e-6, 3e-4, 2e-6], n=120))
    return bench.problem(effects)


@pytest.mark.parametrize("kept", [(), (0,), (1,), (0, 1), (1, 2), (0, 1, 2)])
def test_table_conditional_on_kept_effects_equals_one_computed_again(kept):
    """What the baseline makes of every hypothesis is kept with the problem; all else is as without it."""
    problem = solved()
    ranked_hypotheses(problem.conditional_on(()))
    shared = problem.conditional_on(kept)
    fresh = replace(shared, basis=shared.full_basis, cache={}, function_cache={}, retained=None)
    found, expected = ranked_hypotheses(shared), ranked_hypotheses(fresh)
    own = {
        (h.effect, h.where, h.label): (h.evidence, h.gain, h.rank, np.log(h.p)) for h in expected
    }
    assert len(found) == len(expected) > 500
    for h in found:
        made = h.evidence, h.gain, h.rank, np.log(h.p)
        assert made == pytest.approx(own[h.effect, h.where, h.label], rel=1e-6, abs=1e-6)


def test_what_a_spread_of_the_noise_changes_is_not_kept():
    problem = solved()
    ranked_hypotheses(problem.conditional_on(()))
    through = problem.transformed(lambda rows: 2 * rows)
    assert not through.cache and through.retained is None


def test_terms_found_at_one_solution_have_their_columns_at_another():
    """A likely term is not judged again about a new solution, but its columns are those there."""
    problem = solved()
    other = problem.transformed(lambda rows: 2 * rows)
    for h in ranked_hypotheses(problem.conditional_on(()))[:200]:
        assert np.allclose(h.at(other).columns(other), 2 * h.columns(problem))
    gone = replace(other, candidates=(), with_masses=(), scans=(), sites=())
    assert h.at(gone) is None


def test_a_part_of_the_samples_has_slices_of_the_bases_of_all():
    bench = bench_of(recorded(31, n=120))
    samples = np.arange(120) % 4 > 0
    bench.problem((), samples)
    part = bench._part(samples)
    state = part.chain.state
    linear = [o.effect for o in part.library(True) if o.effect.port not in (*STATE_PORTS, NOISE)]
    assert len(linear) > 50
    for effect in linear:
        assert np.allclose(part.bases[effect, None], effect.basis(state), rtol=1e-9)


def test_a_problem_takes_fewer_steps_than_a_complete_solve_and_is_the_same_to_first_order():
    effects = CATALOGUE["joint-compliance"]("joint-2"), CATALOGUE["joint-compliance"]("joint-3")
    bench = bench_of(recorded(35, effects, [2e-5, 2e-5], n=60))
    early = bench.problem(effects).conditional_on()
    bench.solve(effects)
    late = bench.problem(effects).conditional_on()
    y, z = (
        p.orthogonalise(p.residual) / np.sqrt(p.weights)[p.sample] * p.sigma for p in (early, late)
    )
    assert np.sqrt(((y - z) ** 2).mean()) < 0.01 * np.sqrt((z**2).mean())


def test_an_objective_without_functions_weighs_laws_alike():
    problem = solved().conditional_on(())
    terms = [h for h in ranked_hypotheses(problem) if h.evidence > 0]
    objective = LogPosterior.of(problem, terms[:40])
    rows = np.flatnonzero(~objective.is_smooth)
    alone = objective.select_terms(rows)
    for members in [(0,), (1, 3), (0, 2, 4)]:
        every = tuple(int(rows[i]) for i in members)
        assert alone.value(members) == pytest.approx(objective.value(every), rel=1e-9)
        assert alone.gain(members) == pytest.approx(objective.gain(every), rel=1e-9)


def test_the_basis_of_an_effect_that_is_gone_is_not_anothers():
    """Objects get the place in memory of those that are gone."""
    model = bench_of(recorded(31, n=40)).solve()[0]
    for k in range(60):
        joint = 1 + k % 5
        effect = CATALOGUE["joint-coupling"]("joint-6", joint=joint)
        assert np.array_equal(model.basis(effect), effect.basis(model.chain.state))
        del effect


def test_several_points_turn_as_each_does():
    rng = np.random.default_rng(6)
    vector, points = 0.01 * rng.normal(size=(3, 7)), rng.normal(size=(4, 3, 7))
    assert all((rotate(vector, points)[k] == rotate(vector, points[k])).all() for k in range(4))


def test_hardly_any_noise_is_no_error(monkeypatch):
    """Points rounded to four decimals are exact but for that: inner products beyond what rounding can resolve."""
    monkeypatch.setattr("test_diagnosis_engine.SIGMA", 1e-6)
    effects = CATALOGUE["joint-compliance"]("joint-2"), CATALOGUE["joint-compliance"]("joint-3")
    answer = select.find(bench_of(recorded(35, effects, [2e-5, 2e-5], n=60)))
    assert {(f.effect, f.where) for f in answer.findings} == {(e.effect, e.where) for e in effects}
