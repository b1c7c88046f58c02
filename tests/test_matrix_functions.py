"""Functions of a matrix times vectors agree with those by its eigenvectors."""

import numpy as np
import pytest

from workbench.core.errors import InputError
from workbench.core.least_squares.matrix_functions import function_times


def shrinkage(values):
    return 1 / (1 + np.sqrt(np.clip(1 - values, 1e-3, 1.0)))


def symmetric(values, seed=0):
    """A matrix with some eigenvalues (F,), and its eigenvectors."""
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(len(values), len(values))))[0]
    return (directions * values) @ directions.T, directions


@pytest.mark.parametrize("count", [1, 20, 300])
def test_shares_of_a_block_some_of_which_are_its_alone(count):
    rng = np.random.default_rng(1)
    values = rng.beta(2, 8, count)
    values[: count // 20] = 1 - np.geomspace(1e-9, 0.1, count // 20)
    values[count // 2 :] = 0.0
    matrix, directions = symmetric(values)
    vectors = rng.normal(size=(count, 2))
    expected = directions @ (shrinkage(values)[:, None] * (directions.T @ vectors))
    found = function_times(shrinkage, matrix, vectors)
    assert np.allclose(found, expected, atol=1e-5 * np.linalg.norm(vectors))


def test_directions_that_end_soon_are_enough():
    """An eigenvector spans all that the matrix makes of it, and a vector of zeros stays one."""
    matrix, directions = symmetric(np.linspace(0.0, 1.0, 100))
    vectors = np.stack([directions[:, 3], np.zeros(100), directions[:, 5] - directions[:, 9]], 1)
    expected = directions @ (
        shrinkage(np.linspace(0.0, 1.0, 100))[:, None] * (directions.T @ vectors)
    )
    assert np.allclose(function_times(shrinkage, matrix, vectors), expected, atol=1e-9)
    assert not function_times(shrinkage, np.zeros((80, 80)), np.zeros((80, 1))).any()


def test_a_function_that_no_polynomial_follows_goes_by_the_eigenvectors():
    rng = np.random.default_rng(2)
    values = np.linspace(-1.0, 1.0, 90)
    matrix, directions = symmetric(values)
    vector = rng.normal(size=(90, 1))
    expected = directions @ (np.sign(values)[:, None] * (directions.T @ vector))
    assert np.allclose(function_times(np.sign, matrix, vector), expected, atol=1e-5)


def test_an_entry_that_is_not_finite_is_an_error():
    with pytest.raises(InputError, match="finite"):
        function_times(shrinkage, np.full((70, 70), np.nan), np.ones((70, 1)))
