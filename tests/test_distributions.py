"""workbench.core.distributions gives the numbers of scipy.stats."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from conftest import ROOT
from workbench.core.distributions import chi2, fisher, norm, signed_rank_sf, student

X = np.array([-1.0, 0.0, 0.3, 1.0, 4.0, 30.0, 200.0])
P = np.array([1e-12, 1e-6, 0.05, 0.5, 0.9, 0.999])


@pytest.mark.parametrize("degrees", [1, 3, 17.5, 2000])
def test_chi_square(degrees):
    np.testing.assert_allclose(chi2.sf(X, degrees), stats.chi2.sf(X, degrees), rtol=1e-10)
    np.testing.assert_allclose(chi2.cdf(X, degrees), stats.chi2.cdf(X, degrees), rtol=1e-10)
    np.testing.assert_allclose(chi2.ppf(P, degrees), stats.chi2.ppf(P, degrees), rtol=1e-9)
    np.testing.assert_allclose(chi2.isf(P, degrees), stats.chi2.isf(P, degrees), rtol=1e-9)
    expected = stats.chi2.logsf(X, degrees)
    np.testing.assert_allclose(chi2.logsf(X, degrees), expected, rtol=1e-9, atol=1e-14)
    assert chi2.logsf(1e5, degrees) == -np.inf


@pytest.mark.parametrize("first, second", [(1, 2), (3, 40), (12.5, 7.5), (900, 1100)])
def test_fisher(first, second):
    np.testing.assert_allclose(fisher.sf(X, first, second), stats.f.sf(X, first, second), rtol=1e-9)
    np.testing.assert_allclose(
        fisher.ppf(P, first, second), stats.f.ppf(P, first, second), rtol=1e-7
    )
    quantiles = fisher.isf(P, first, second)
    np.testing.assert_allclose(fisher.sf(quantiles, first, second), P, rtol=1e-9)


def test_normal_and_student():
    np.testing.assert_allclose(norm.sf(X), stats.norm.sf(X), rtol=1e-12)
    np.testing.assert_allclose(norm.cdf(X), stats.norm.cdf(X), rtol=1e-12)
    np.testing.assert_allclose(norm.isf(P), stats.norm.isf(P), rtol=1e-10)
    for degrees in (1, 4.5, 300):
        np.testing.assert_allclose(student.sf(X, degrees), stats.t.sf(X, degrees), rtol=1e-9)
        np.testing.assert_allclose(
            student.isf(P, degrees), stats.t.isf(P, degrees), rtol=1e-7, atol=1e-12
        )


@pytest.mark.parametrize("count", [1, 2, 5, 10, 50, 51, 200])
def test_signed_ranks(count):
    rng = np.random.default_rng(count)
    for shift in (-0.5, 0.0, 0.4, 2.0):
        differences = rng.normal(shift, 1.0, count)
        expected = stats.wilcoxon(differences, alternative="greater").pvalue
        assert signed_rank_sf(differences) == pytest.approx(expected, rel=1e-9)


def test_signed_ranks_with_ties_and_zeros():
    differences = np.array([0.0, 1.0, 1.0, -1.0, 2.0, 3.0, 3.0, -2.0, 0.0, 5.0, 6.0, 7.0])
    expected = stats.wilcoxon(differences, alternative="greater", method="asymptotic").pvalue
    assert signed_rank_sf(differences) == pytest.approx(expected, rel=1e-9)
    assert signed_rank_sf(np.zeros(6)) == 1.0


@pytest.mark.parametrize(
    "module", ["workbench.fitting.checked_samples", "workbench.explanation.answer"]
)
def test_what_commands_load_is_without_scipy_stats(module):
    code = f"import sys, {module}; print('scipy.stats' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
