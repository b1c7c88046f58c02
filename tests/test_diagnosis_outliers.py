"""Outliers against heavy tails: claimed where some samples lie apart, not where the noise is merely wild."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from conftest import mostly_slow
from test_diagnosis_engine import recorded
from workbench.diagnosis.noise.outliers import contaminated, spread_in_blocks
from workbench.explanation.answer import diagnose

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


@pytest.mark.parametrize("tails", [2.0, 50.0])
def test_noise_that_is_larger_for_a_while_is_distinguished_from_heavy_tails(tails):
    rng = np.random.default_rng(int(tails))
    order, pose = np.arange(150.0), np.arange(150) // 3
    calm = [(rng.standard_t(tails, (3, 150)) ** 2).sum(0) for _ in range(200)]
    chance = [spread_in_blocks(squares, order, pose) for squares in calm]
    assert min(chance) > 1e-3 and np.mean(np.array(chance) < 0.05) < 0.09
    together = [squares * rng.exponential(size=50)[pose] for squares in calm]
    assert min(spread_in_blocks(squares, order, pose) for squares in together) > 1e-4
    burst = 4.0 * ((order >= 60) & (order < 90)) + 1.0
    found = [spread_in_blocks(squares * burst**2, order, np.arange(150)) for squares in calm]
    assert np.mean(np.array(found) < 1e-3) > 0.9


def test_a_burst_of_noise_is_a_finding_on_the_noise():
    recording = recorded(17, n=150)
    rng = np.random.default_rng(3)
    noisy = ((np.arange(150) >= 60) & (np.arange(150) < 90)) * 0.1
    columns = {
        name: recording.columns[name] + noisy * rng.normal(size=150)
        for name in ("x_mm", "y_mm", "z_mm")
    }
    made = diagnose(replace(recording, columns={**recording.columns, **columns}))
    names = {term.finding.effect for term in made.terms if term.kept}
    assert "noise-heteroscedastic" in names and "noise-heavy-tailed" not in names
    said = " ".join(term.statement for term in made.terms)
    assert "its spread goes with time" in said
