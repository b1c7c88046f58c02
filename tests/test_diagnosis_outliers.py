"""Outliers against heavy tails: claimed where some samples lie apart, not where the noise is merely wild."""

from itertools import product

import numpy as np
import pytest

from conftest import mostly_slow
from workbench.diagnosis.noise.outliers import contaminated

CLEAR = np.log(20)


def _with_outliers(rng, n, count, size, axis=None):
    white = rng.normal(size=(3, n))
    rows = rng.choice(n, count, replace=False)
    way = rng.normal(size=(3, count)) if axis is None else np.eye(3)[:, [axis] * count]
    white[:, rows] += size * way / np.linalg.norm(way, axis=0)
    return white, rows


@pytest.mark.parametrize(
    ("shared", "degrees"), mostly_slow(product([True, False], [3, 5, 10, np.inf]), 0, 4)
)
def test_noise_of_any_tails_is_rarely_taken_for_outliers(degrees, shared):
    """By Markov at most once in twenty times on average over tails; far less often in fact."""
    rng = np.random.default_rng(3)

    def drawn():
        if np.isinf(degrees):
            return rng.normal(size=(3, 150))
        spread = np.sqrt(degrees / rng.chisquare(degrees, (1 if shared else 3, 150)))
        return rng.normal(size=(3, 150)) * spread

    assert np.mean([contaminated(drawn())[0] > CLEAR for _ in range(25)]) <= 1 / 20


@pytest.mark.parametrize("axis", [None, 2])
def test_samples_eight_sigmas_off_are_found_each_and_no_other(axis):
    rng = np.random.default_rng(4)
    seen, named, wrong = [], [], 0
    for _ in range(20):
        white, rows = _with_outliers(rng, 250, 3, 8.0, axis)
        factor, each = contaminated(white)
        seen.append(factor > CLEAR)
        named.append(each[rows] > 0.5)
        wrong += int((np.delete(each, rows) > 0.5).sum())
    assert np.mean(seen) >= 0.9
    assert np.mean(named) >= 0.95
    assert wrong <= 1


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_one_sample_among_many_that_is_far_off_is_found(m):
    white = np.random.default_rng(5).normal(size=(m, 6000))
    plain, _ = contaminated(white)
    white[0, 17] = 14.0
    factor, each = contaminated(white)
    assert plain < CLEAR < factor
    assert list(np.flatnonzero(each > 0.5)) == [17]


def test_scale_of_the_residuals_says_nothing():
    white, _ = _with_outliers(np.random.default_rng(6), 200, 2, 12.0)
    factor, each = contaminated(white)
    other, same = contaminated(1e-3 * white)
    assert other == pytest.approx(factor)
    np.testing.assert_allclose(same, each, atol=1e-9)
