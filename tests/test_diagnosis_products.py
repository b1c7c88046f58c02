"""Products that a diagnosis computes once a solution, or from smaller matrices, equal those of the columns."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.core.least_squares import solver
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.evidence import design_effect
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.most_probable_set import accept_most_probable_set
from workbench.diagnosis.search.state import _SELECTIONS, ELASTIC, LAWS, Search


@pytest.fixture(scope="module")
def problem():
    """A problem of 40 poses with three repeats each, solved with three effects."""
    effects = (
        CATALOGUE["joint-compliance"]("joint-3"),
        CATALOGUE["zero-shift"]("joint-1", after=1200.0),
        CATALOGUE["joint-compliance"]("joint-2"),
    )
    return bench_of(recorded(31, effects, [4e-6, 3e-4, 2e-6], n=120, repeats=3)).problem(effects)


@pytest.mark.parametrize("kept", [(), (1,), (0, 2), (0, 1, 2)])
def test_design_effect_of_retained_effects_equals_that_of_their_basis(problem, kept):
    shared = problem.conditional_on(kept)
    basis = np.hstack([problem.basis, shared.retained.basis])
    fresh = replace(shared, basis=basis, cache={}, retained=None)
    assert design_effect(shared) == pytest.approx(design_effect(fresh), rel=1e-9)
    assert design_effect(shared) > 1.0


def test_design_effect_of_reordered_effects_is_not_that_of_their_former_places(problem):
    design_effect(problem.conditional_on((0, 1)))
    other = problem.reordered([2, 0, 1])
    expected = design_effect(problem.conditional_on((1, 2)))
    assert design_effect(other.conditional_on((0, 2))) == pytest.approx(expected, rel=1e-9)


def test_nothing_is_projected_out_where_no_effect_is_retained(problem):
    columns = np.random.default_rng(2).normal(size=(len(problem.residual), 4))
    expected = columns - problem.basis @ (problem.basis.T @ columns)
    assert np.allclose(problem.conditional_on(()).orthogonalise(columns), expected, rtol=1e-12)


def test_shares_of_components_are_those_of_the_leverages():
    """Six components, of which the parameters spend degrees of freedom unequally."""
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(8, 6, 50)) * np.array([3.0, 3.0, 3.0, 1.0, 0.2, 0.2])[:, None]
    state = object.__new__(solver._Problem)
    state.residual, state.scale = rng.normal(size=(6, 50)), rng.uniform(0.5, 2.0, 8)
    state.rows = solver._WhitenedRows(rows.reshape(8, -1), 1.5)
    white = 1.5 * rows.reshape(8, -1) * state.scale[:, None]
    covariance = np.linalg.inv(white @ white.T + np.eye(8))
    leverage = np.einsum("ik,ij,jk->k", white, covariance, white).reshape(6, 50)
    expected = 1 - leverage.mean(1)
    assert state.shares_of_components(covariance) == pytest.approx(expected, rel=1e-9)
    assert np.ptp(expected) > 0.01


@pytest.fixture(scope="module")
def search():
    """A search that has accepted two compliances and a slip."""
    effects = (
        CATALOGUE["joint-compliance"]("joint-3"),
        CATALOGUE["zero-shift"]("joint-1", after=1200.0),
        CATALOGUE["joint-compliance"]("joint-2"),
    )
    bench = bench_of(recorded(31, effects, [4e-6, 3e-4, 2e-6], n=120))
    started = Search(bench, None, UNMODELLED_LEVEL, lambda line: None)
    started.solve()
    accept_most_probable_set(started, thorough=False)
    assert len(started.accepted) >= 3
    return started


def ranked(table):
    """Numbers of the hypotheses of a table by their names."""
    return {
        (h.effect, h.where, h.label): (h.evidence, h.gain, h.log_prior, h.weight) for h in table
    }


@pytest.mark.parametrize("part", [LAWS, ELASTIC])
@pytest.mark.parametrize("kept", [(), (0,), (1, 2)])
def test_part_of_a_table_is_what_the_whole_table_says_of_it(search, kept, part):
    search.tables.clear()
    found = ranked(search.table(kept, part))
    whole = search.table(kept)
    expected = ranked(h for h in whole if _SELECTIONS[part](h))
    assert len(whole) > len(expected) > 5
    assert found.keys() == expected.keys()
    for name, numbers in expected.items():
        assert found[name] == pytest.approx(numbers, rel=1e-9, abs=1e-9)


def test_a_solution_that_is_known_keeps_its_tables(search):
    table, problem = search.table((0,)), search.problem
    search.solve()
    assert search.problem is problem and search.table((0,)) == table
    search.accepted = search.accepted[:2]
    search.solve()
    assert search.problem is not problem and not search.tables
