"""Products that a diagnosis computes once a solution, or from smaller matrices, equal those of the columns."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.core.least_squares import solver
from workbench.diagnosis.linear.evidence import design_effect
from workbench.diagnosis.robot.bench import bench_of


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
