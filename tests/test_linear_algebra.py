"""The shared linear algebra: right where matrices are regular, and defined where they are not."""

import numpy as np
import pytest

from workbench.core.errors import InputError
from workbench.core.least_squares import linear_algebra
from workbench.core.least_squares.linear_algebra import (
    covariance_of,
    inverse_positive,
    least_squares,
    posterior_of,
    pseudo_inverse,
    root_between,
    solve_positive,
    symmetric_eigen,
    thin_svd,
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def graded(rng, size=12, decades=12):
    """A positive definite matrix whose diagonal spans many decades: parameters in very different units."""
    rows = rng.normal(size=(3 * size, size))
    scale = 10.0 ** rng.uniform(-decades / 2, decades / 2, size)
    return (rows.T @ rows) * np.outer(scale, scale), scale


def deficient(rng, size=12, rank=7, scale=1.0):
    rows = rng.normal(size=(rank, size)) * scale
    return rows.T @ rows


@pytest.mark.parametrize("stack", [(), (3,), (2, 4)])
def test_regular_systems_are_solved_as_numpy_does(rng, stack):
    rows = rng.normal(size=(*stack, 20, 5))
    matrix, right = np.swapaxes(rows, -1, -2) @ rows, rng.normal(size=(*stack, 5, 2))
    np.testing.assert_allclose(
        solve_positive(matrix, right), np.linalg.solve(matrix, right), rtol=1e-9
    )
    np.testing.assert_allclose(inverse_positive(matrix), np.linalg.inv(matrix), rtol=1e-8)
    prior = np.full(5, 1e-3)
    expected = np.linalg.inv(matrix + np.diag(prior))
    np.testing.assert_allclose(covariance_of(matrix, prior), expected, rtol=1e-8)


def test_badly_scaled_systems_are_solved_to_the_accuracy_of_well_scaled_ones(rng):
    matrix, scale = graded(rng)
    wanted = rng.normal(size=12) / scale
    np.testing.assert_allclose(solve_positive(matrix, matrix @ wanted), wanted, rtol=1e-8)


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1.0, 1e9, 1e150])
def test_a_singular_system_is_solved_with_nothing_moved_along_what_it_does_not_determine(
    rng, scale
):
    matrix = deficient(rng, scale=np.sqrt(scale))
    wanted = rng.normal(size=12)
    found = solve_positive(matrix, matrix @ wanted)
    np.testing.assert_allclose(matrix @ found, matrix @ wanted, rtol=1e-7, atol=1e-9 * scale)
    assert (
        np.abs(found).max() < 1e3
    )  # unit diagonal is not unit length: not the least norm, but of its size


def test_columns_of_zeros_stay_where_they_are():
    matrix = np.diag([4.0, 0.0, 1.0])
    np.testing.assert_array_equal(
        solve_positive(matrix, np.array([4.0, 0.0, 2.0])), [1.0, 0.0, 2.0]
    )


def test_what_no_data_determine_keeps_the_variance_of_its_prior():
    """Two parameters of which only the sum is known, a million million times better than their priors."""
    information = 1e14 * np.array([[1.0, 1.0], [1.0, 1.0]])
    found = covariance_of(information, np.array([1e-4, 1e-4]))
    difference, total = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    assert difference @ found @ difference == pytest.approx(2e4, rel=1e-6)
    assert abs(total @ found @ total) < 1e-9


def test_what_the_data_determine_needs_no_prior_of_its_own(monkeypatch):
    """A weak prior alone does not call for the slow factorisation of rows: the pivots show that all is determined."""
    information = 1e12 * np.array([[2.0, 1.0], [1.0, 2.0]])
    expected = np.linalg.inv(information)

    def slow(*arguments):
        raise AssertionError("the information alone is accurate")

    monkeypatch.setattr(linear_algebra, "_covariance_by_rows", slow)
    np.testing.assert_allclose(covariance_of(information, np.full(2, 1e-9)), expected, rtol=1e-9)


def test_a_small_parameter_among_large_ones_is_as_certain_as_alone():
    information = np.diag([1e16, 1e16, 25.0])
    information[0, 1] = information[1, 0] = 1e16
    found = covariance_of(information, np.full(3, 1e-4))
    assert found[2, 2] == pytest.approx(1 / 25.0001, rel=1e-6)
    assert found[0, 0] == pytest.approx(0.5e4, rel=1e-2)


def test_the_covariance_of_something_undetermined_is_large_and_not_zero(rng):
    found = inverse_positive(deficient(rng))
    assert np.linalg.eigvalsh(found)[-5:].min() > 1e9
    assert np.abs(np.diag(pseudo_inverse(deficient(rng)))).max() < 1e3


def test_rank_deficient_least_squares(rng):
    rows = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 6)) * 10.0 ** np.arange(6)
    wanted = rng.normal(size=6) / 10.0 ** np.arange(6)
    np.testing.assert_allclose(
        rows @ least_squares(rows, rows @ wanted), rows @ wanted, rtol=1e-8, atol=1e-9
    )
    assert least_squares(np.zeros((0, 3)), np.zeros(0)).tolist() == [0.0, 0.0, 0.0]
    assert least_squares(np.zeros((4, 3)), np.ones(4)).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "function",
    [
        lambda bad: solve_positive(bad, np.ones(3)),
        inverse_positive,
        symmetric_eigen,
        thin_svd,
        lambda bad: covariance_of(bad, np.ones(3)),
        lambda bad: least_squares(bad, np.ones(3)),
    ],
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_a_sentence(function, value):
    bad = np.eye(3)
    bad[1, 2] = bad[2, 1] = value
    with pytest.raises(InputError, match="not finite"):
        function(bad)


def test_another_algorithm_takes_over_where_divide_and_conquer_does_not_converge(rng, monkeypatch):
    matrix = deficient(rng, 6, 3)
    expected = np.linalg.eigvalsh(matrix), np.linalg.svd(matrix, compute_uv=False)

    def fails(*arguments, **options):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(linear_algebra.np.linalg, "eigh", fails)
    monkeypatch.setattr(linear_algebra.np.linalg, "svd", fails)
    values, vectors = symmetric_eigen(np.stack([matrix, 1e200 * matrix]))
    np.testing.assert_allclose(values[0], expected[0], atol=1e-12)
    np.testing.assert_allclose((vectors[0] * values[0]) @ vectors[0].T, matrix, atol=1e-12)
    np.testing.assert_allclose(values[1], 1e200 * expected[0], atol=1e188)
    u, values, vt = thin_svd(matrix)
    np.testing.assert_allclose(values, expected[1], atol=1e-12)
    np.testing.assert_allclose((u * values) @ vt, matrix, atol=1e-12)


def test_entries_near_the_limits_of_floating_point_neither_overflow_nor_vanish(rng):
    matrix = deficient(rng, 5, 5)
    for factor in (1e-300, 1e300):
        np.testing.assert_allclose(
            symmetric_eigen(factor * matrix)[0] / factor, np.linalg.eigvalsh(matrix), rtol=1e-9
        )
        np.testing.assert_allclose(
            thin_svd(factor * matrix)[1] / factor,
            np.linalg.svd(matrix, compute_uv=False),
            rtol=1e-9,
        )


def test_a_root_is_found_where_there_is_one_and_the_nearer_end_otherwise():
    assert root_between(lambda x: x - 0.3, 0.0, 1.0) == pytest.approx(0.3)
    assert root_between(lambda x: x + 1, 0.0, 1.0) == 0.0
    assert root_between(lambda x: x - 2, 0.0, 1.0) == 1.0
    assert root_between(lambda x: np.nan, 0.0, 1.0) in (0.0, 1.0)


@pytest.mark.parametrize("rank", [12, 7])
def test_posterior_mean_and_variances_are_those_of_the_covariance(rank):
    rng = np.random.default_rng(rank)
    rows = rng.normal(size=(30, rank)) @ rng.normal(size=(rank, 12)) * np.geomspace(1e-3, 1e3, 12)
    prior, right = rng.uniform(0.1, 2.0, 12), rng.normal(size=12)
    covariance = covariance_of(rows.T @ rows, prior)
    mean, variances = posterior_of(rows.T @ rows, prior, right)
    np.testing.assert_allclose(variances, np.diag(covariance), rtol=1e-6)
    np.testing.assert_allclose(mean, covariance @ right, rtol=1e-6)
