"""What a fit states of its own uncertainty is true: parameters and predicted positions, over many seeds.

Every seed draws a true arm (independent parameters: normal, a typical size, at most a millimetre for base and tool),
simulates noise as stated, fits from the nominal arm and compares with the truth. A stated sigma is
true if 68.3 % of the errors lie within it. Gaps whitened by the whole covariance are independent normal numbers, so
that their share within 1 is binomial.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm

from robot_model.system import geometry_free
from scenes import model_of, observed, scene
from workbench.core.least_squares.identifiability import independent
from workbench.core.least_squares.solver import normal_matrix, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Solution

SHARE = norm.cdf(1) - norm.cdf(-1)
WAVES = tuple(
    ("transmission-harmonic", f"joint-{k}", {"order": n}) for k in (1, 2, 4) for n in (1, 2)
)
SOFT = tuple(("joint-compliance", f"joint-{k}", {}) for k in (2, 3)) + (
    ("link-compliance", "link-2", {}),
)
CASES = {
    "geometry": ("external-point", ()),
    "geometry by balls": ("ball-centre", ()),
    "with gears and compliance": ("external-point", (*WAVES, *SOFT)),
}
QUICK, MANY = 20, 100
EVERY = pytest.mark.parametrize("case", CASES)


@dataclass(frozen=True)
class Gaps:
    """Over all seeds: gaps over their sigmas, gaps whitened together, and gaps of predicted positions over theirs."""

    parameters: np.ndarray
    whitened: np.ndarray
    positions: np.ndarray


def recover(case, seeds) -> Gaps:
    measures, effects = CASES[case]
    model = model_of(scene(measures, n=100, seed=11), *effects)
    elsewhere = model_of(scene(measures, n=40, seed=11), *effects).at(np.arange(20, 40))
    free = identifiable(model, measures)
    found = [one_seed(model, elsewhere, free, seed) for seed in range(seeds)]
    return Gaps(*(np.array([gaps[k] for gaps in found]) for k in range(3)))


def identifiable(model: Model, measures) -> Parameters:
    """All free parameters that these poses distinguish."""
    tool = "sensor.*" if measures == "ball-centre" else "tool.*"
    extra = [p.key for effect in model.effects for p in effect.parameters(model.chain)]
    free = model.parameters.free("base.*", tool, *geometry_free(model.chain.robot), *extra)
    return independent(normal_matrix(model, free), free)[0]


def one_seed(model, elsewhere, free, seed):
    rng = np.random.default_rng(seed)
    sizes = np.minimum(free.typical[free.mask], 1.0)
    truth = free.unpack(free.pack() + sizes * rng.standard_normal(sizes.size))
    fit = solve(observed(model, truth, rng), free)
    assert fit.converged
    solution = Solution(fit.parameters, fit, {}, {})
    gap = fit.parameters.pack() - truth.pack()
    together = np.linalg.solve(np.linalg.cholesky(solution.covariance), gap)
    return gap / list(solution.std.values()), together, predicted(elsewhere, solution, truth)


def predicted(elsewhere, solution, truth):
    """Gaps of predicted coordinates at other poses over their sigma, through covariance and Jacobian."""
    rows = elsewhere.jacobian(solution.parameters)
    sigma = np.sqrt(np.einsum("if,fg,ig->i", rows, solution.covariance, rows))
    return (elsewhere.residual(solution.parameters) - elsewhere.residual(truth)).ravel() / sigma


def within(gaps):
    return float((np.abs(gaps) < 1).mean())


def binomial_bound(count, deviations=4.0):
    """How far a share of `count` independent numbers may be from 68.3 % (once in 16,000 farther)."""
    return deviations * np.sqrt(SHARE * (1 - SHARE) / count)


@EVERY
def test_stated_sigmas_cover_the_truth_in_a_few_seeds(case):
    """Binomial for the whitened gaps; those of one seed go together otherwise, as if only a fifth were independent."""
    gaps = recover(case, QUICK)
    assert abs(within(gaps.whitened) - SHARE) < binomial_bound(gaps.whitened.size)
    assert abs(within(gaps.parameters) - SHARE) < binomial_bound(gaps.parameters.size / 5)
    assert abs(within(gaps.positions) - SHARE) < binomial_bound(QUICK * 5)


@pytest.mark.slow
@EVERY
def test_stated_sigmas_cover_the_truth_in_a_hundred_seeds(case):
    gaps = recover(case, MANY)
    assert abs(within(gaps.whitened) - SHARE) < binomial_bound(gaps.whitened.size)
    assert 0.62 < within(gaps.parameters) < 0.74
    assert 0.62 < within(gaps.positions) < 0.74
    # and no tail: the squared length of the whitened gaps is chi-square
    assert (gaps.whitened**2).mean() == pytest.approx(1, abs=4 * np.sqrt(2 / gaps.whitened.size))
