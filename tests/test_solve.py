"""The solve: exact data to rounding, outliers resisted, priors weighed, null directions still, its own sentences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot_model.system import geometry_free
from scenes import KINDS, model_of, observed, scene
from workbench.core.least_squares.identifiability import independent
from workbench.core.least_squares.solver import (
    LOSSES,
    NOT_FINITE,
    OUT_OF_STEPS,
    cauchy,
    huber,
    normal_matrix,
    pose_scores,
    solve,
)
from workbench.core.parameters import Parameter, Parameters

FRAMES = {
    "ball-centre": ("base.*", "sensor.*"),
    "external-point": ("base.*", "tool.*"),
    "external-pose": ("base.*", "tool.*"),
    "partial-pose": ("base.*", "tool.*"),
}


def everything(model, measures="external-point") -> Parameters:
    """Base, tool and all geometry free, null directions among them."""
    return model.parameters.free(*FRAMES[measures], *geometry_free(model.chain.robot))


def canonical(model, measures="external-point") -> Parameters:
    """As many of them as the data distinguish."""
    free = everything(model, measures)
    return independent(normal_matrix(model, free), free)[0]


def moved(parameters, size=0.5, seed=0) -> Parameters:
    """The free ones off by normal numbers times `size` typical sizes, at most a millimetre."""
    steps = np.minimum(parameters.typical[parameters.mask], 1.0)
    return parameters.unpack(
        parameters.pack() + size * steps * np.random.default_rng(seed).standard_normal(steps.size)
    )


def whitened_distance(fit, model, truth):
    """|gap| in sigmas, by the normal matrix of the data."""
    gap = fit.parameters.pack() - truth.pack()
    return float(np.sqrt(gap @ normal_matrix(model, truth) @ gap))


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_exact_data_are_met_far_below_their_sigma(measures, seed):
    """To a ten-thousandth (2 nm); priors, that pull towards the nominal arm, taken off."""
    model = model_of(scene(measures, n=80, seed=seed))
    free = canonical(model, measures)
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    truth = moved(free, seed=seed)
    fit = solve(observed_pose(model, truth, measures), free)
    assert fit.converged and len(fit.history) < 8
    assert np.abs(fit.residual / model.chain.sigma).max() < 1e-4
    assert whitened_distance(fit, model, truth) < 1e-2  # as the outcome's sentence says


def observed_pose(model, truth, measures):
    """As `observed`, with orientations too where they are measured."""
    seen = observed(model, truth)
    if measures not in ("external-pose", "partial-pose"):
        return seen
    columns = model.chain.measurement.columns(model.residual(truth))
    if measures == "partial-pose":
        turned = {"axis": np.stack([columns[f"o{c}"] for c in "xyz"])}
    else:
        turned = {
            "rotations": Rotation.from_quat(
                np.stack([columns[f"q{c}"] for c in "xyzw"], -1)
            ).as_matrix()
        }
    measurement = replace(seen.chain.measurement, **turned)
    return replace(seen, chain=replace(seen.chain, measurement=measurement), _bases={})


def test_the_cost_falls_at_every_step():
    model = model_of(scene("external-point", n=80))
    free = everything(model)
    fit = solve(observed(model, moved(free, 2.0), np.random.default_rng(1)), free)
    assert fit.converged and len(fit.history) > 2
    assert (np.diff(fit.history) < 0).all()


def test_residuals_over_sigmas_are_one_for_noise_as_stated_and_double_for_double():
    model = model_of(scene("external-point", n=400))
    free = canonical(model)
    for noise in (1.0, 2.0):
        fit = solve(observed(model, moved(free), np.random.default_rng(2), noise), free)
        # chi-square over 1,200 numbers: its root has a standard deviation of 2 %
        assert fit.sigma_scale == pytest.approx(noise, rel=0.08)


@pytest.mark.parametrize(("loss", "allowed"), [("huber", 6.0), ("cauchy", 4.0)])
def test_a_robust_loss_resists_gross_outliers(loss, allowed):
    """5 % of the samples are off by 5 mm, which is 250 sigmas; distance of F parameters in sigmas is about root F."""
    model = model_of(scene("external-point", n=300))
    free = canonical(model)
    truth = moved(free)
    rng = np.random.default_rng(3)
    seen = observed(model, truth, rng)
    bad = rng.choice(300, 15, replace=False)
    measured = seen.chain.measurement.measured.copy()
    measured[:, bad] += rng.normal(0, 5, (3, 15))
    spoilt = replace(
        seen,
        chain=replace(seen.chain, measurement=replace(seen.chain.measurement, measured=measured)),
        _bases={},
    )
    clean = whitened_distance(solve(seen, free), model, truth)
    fit = solve(spoilt, free, loss)
    assert fit.converged
    assert whitened_distance(fit, model, truth) < allowed * clean
    assert whitened_distance(solve(spoilt, free), model, truth) > 20 * clean
    others = np.setdiff1d(np.arange(300), bad)
    assert fit.weights[bad].max() < 0.2 < 0.7 < np.median(fit.weights[others])


def test_weights_of_the_losses_are_their_formulas():
    z = np.array([0.0, 1.0, 4.0, 100.0])
    np.testing.assert_allclose(huber(z, 2.0), [1, 1, 1, 0.2])
    np.testing.assert_allclose(cauchy(z, 2.0), [1, 0.8, 0.5, 1 / 26])
    assert set(LOSSES) == {"linear", "huber", "cauchy"} and LOSSES["linear"] is None


def one_offset(n=80, prior=None, sigma=0.02):
    """A model in which only joint 3's zero offset is free, with the prior that is asked for."""
    model = model_of(scene("external-point", n=n, sigma=sigma))
    free = model.parameters.free("joint-3.theta3")
    return model, replace(free, table=tuple(replace(p, prior=prior) for p in free.table))


@pytest.mark.parametrize("strength", [0.1, 1.0, 10.0])
def test_a_prior_pulls_by_its_weight_against_that_of_the_data(strength):
    """Posterior of a linear model: truth * w_data / (w_data + w_prior), towards the null."""
    model, free = one_offset()
    data = normal_matrix(model, free)[0, 0]
    _, weighed = one_offset(prior=(strength * data) ** -0.5)
    truth = free.update({"joint-3.theta3": 1e-5})
    fit = solve(observed(model, truth), weighed)
    null = weighed.nulls[weighed.mask][0]
    assert fit.parameters["joint-3.theta3"] - null == pytest.approx(
        (1e-5 - null) / (1 + strength), rel=1e-3
    )


def test_without_prior_the_data_decide_alone():
    model, free = one_offset()
    fit = solve(observed(model, free.update({"joint-3.theta3": 2e-3})), free)
    assert fit.parameters["joint-3.theta3"] == pytest.approx(2e-3, rel=1e-6)


def test_directions_that_nothing_shows_keep_still():
    """Base rz and joint 1's offset act as one; the last joint's d and the reflector too: the solve moves neither far."""
    made = scene("external-point", n=80, angle=0.0)
    model = model_of(made)
    free = everything(model)
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    fit = solve(observed(model, free, np.random.default_rng(4)), free)
    assert fit.converged
    values, vectors = np.linalg.eigh(
        normal_matrix(model, free) * np.outer(free.typical[free.mask], free.typical[free.mask])
    )
    silent = vectors[:, values < 1e-6 * values.max() / len(values)][:, :4]
    change = (fit.parameters.pack() - free.pack()) / free.typical[free.mask]
    assert silent.shape[1] >= 4 and np.abs(silent.T @ change).max() < 1e-2


def test_a_model_that_is_not_finite_says_so():
    model = model_of(scene("external-point", n=30))
    free = model.parameters.free("base.*")
    fit = solve(model, free.update({"joint-2.a2": np.nan}))
    assert fit.outcome == NOT_FINITE and not fit.converged
    assert "impossible joint angles" in fit.outcome
    assert np.array_equal(fit.parameters.pack(), free.pack())


def test_too_few_steps_say_so():
    model = model_of(scene("external-point", n=80))
    free = everything(model)
    fit = solve(observed(model, moved(free, 2.0)), free, steps=1)
    assert fit.outcome == OUT_OF_STEPS and not fit.converged


class CurvedValley:
    """Rosenbrock's function as a sum of squares: least at (1, 1), and it hardly changes along a parabola."""

    effects, spans, samples, narrow = (), (), 10_000, 100
    parameters = Parameters.of([Parameter("x", "mm"), Parameter("y", "mm")])

    def sigma(self, parameters):
        return np.ones((2, self.samples))

    def residual(self, parameters):
        x, y = parameters.pack()
        return np.tile([[self.narrow * (y - x * x)], [1 - x]], self.samples)

    def residual_and_derivative(self, parameters):
        x = parameters.pack()[0]
        rows = [[[-2 * self.narrow * x], [-1.0]], [[self.narrow], [0.0]]]
        return self.residual(parameters), lambda: np.tile(rows, self.samples)

    def linearise(self, parameters):
        residual, rows = self.residual_and_derivative(parameters)
        return residual, rows()


def test_damped_steps_follow_a_curved_valley():
    """Straight damped steps need 57."""
    model = CurvedValley()
    start = model.parameters.free("*").unpack(np.array([-1.2, 1.44]))
    fit = solve(model, start, steps=100)
    assert fit.converged and len(fit.history) < 42
    np.testing.assert_allclose(fit.parameters.pack(), 1, atol=1e-3)


class ProductValley(CurvedValley):
    """A compliance k under a known and an unknown load, 1 + m: their product is known far better than either."""

    parameters = Parameters.of([Parameter("k", "1"), Parameter("m", "1")])
    narrow, weak, share = 300, 100, 0.8

    def sigma(self, parameters):
        return np.ones((2, 1))

    def residual(self, parameters):
        k, m = parameters.pack()
        of_sum = k * (1 + m) - 2
        of_share = k * (1 + self.share * m) - (1 + self.share)
        return np.array([[self.narrow * of_sum], [self.weak * of_share]])

    def residual_and_derivative(self, parameters):
        k, m = parameters.pack()
        by_k = [[self.narrow * (1 + m)], [self.weak * (1 + self.share * m)]]
        by_m = [[self.narrow * k], [self.weak * self.share * k]]
        return self.residual(parameters), lambda: np.array([by_k, by_m])


def test_short_damped_steps_end_no_solve_far_from_the_minimum():
    """From the floor of the valley, 14 standard deviations from the minimum: the first steps hardly lower the cost."""
    model = ProductValley()
    start = model.parameters.free("*").unpack(np.array([2 / 7, 6.0]))
    fit = solve(model, start)
    assert fit.converged
    np.testing.assert_allclose(fit.parameters.pack(), 1, atol=0.01)


def test_nothing_free_is_a_fit_of_nothing():
    model = model_of(scene("external-point", n=30))
    fit = solve(model, model.parameters)
    assert fit.converged and fit.normal.shape == (0, 0)
    assert np.abs(fit.residual).max() < 1e-6


@pytest.mark.parametrize("factor", [0.01, 1.0, 100.0])
def test_the_unit_of_sigma_does_not_matter(factor):
    """All sigmas times a factor, no priors: the same parameters, to a hundredth of their spread."""
    model = model_of(scene("external-point", n=120))
    free = canonical(model)
    free = replace(free, table=tuple(replace(p, prior=None) for p in free.table))
    truth = moved(free)
    seen = observed(model, truth, np.random.default_rng(5))
    scaled = replace(seen, chain=replace(seen.chain, sigma=factor * seen.chain.sigma), _bases={})
    reference, fit = solve(seen, free), solve(scaled, free)
    gap = fit.parameters.pack() - reference.parameters.pack()
    assert float(np.sqrt(gap @ reference.normal @ gap)) < 0.05
    assert fit.sigma_scale == pytest.approx(reference.sigma_scale / factor, rel=1e-3)


def test_each_sample_counts_by_its_own_sigma():
    """Ten samples with a sigma of a metre and errors of 10 mm change nothing."""
    model = model_of(scene("external-point", n=120))
    free = canonical(model)
    truth = moved(free)
    seen = observed(model, truth, np.random.default_rng(6))
    sigma, measured = seen.chain.sigma.copy(), seen.chain.measurement.measured.copy()
    sigma[:, :10], measured[:, :10] = 1e3, measured[:, :10] + 10
    vague = replace(
        seen.chain, sigma=sigma, measurement=replace(seen.chain.measurement, measured=measured)
    )
    fit, without = (
        solve(replace(seen, chain=vague, _bases={}), free),
        solve(seen.at(np.arange(10, 120)), free),
    )
    gap = fit.parameters.pack() - without.parameters.pack()
    assert float(np.sqrt(gap @ without.normal @ gap)) < 0.02


def test_normal_matrix_is_that_of_the_fit():
    model = model_of(scene("external-point", n=80))
    free = canonical(model)
    fit = solve(observed(model, moved(free), np.random.default_rng(7)), free)
    seen = observed(model, fit.parameters)
    expected = normal_matrix(seen, fit.parameters)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(fit.normal / size, expected / size, atol=1e-9)
    rows = (seen.jacobian(fit.parameters).T / model.chain.sigma.ravel()).T
    np.testing.assert_allclose(expected / size, rows.T @ rows / size, atol=1e-12)


def test_pose_scores_sum_gradients_over_samples_of_a_pose():
    model = model_of(scene("external-point", n=60))
    free = canonical(model)
    seen = observed(model, moved(free), np.random.default_rng(8))
    fit = solve(seen, free)
    assert pose_scores(seen, fit, np.arange(60)) is None
    poses = np.repeat(np.arange(20), 3)
    rows = seen.jacobian(fit.parameters).T.reshape(len(fit.normal), 3, 60)
    white = fit.residual / (seen.chain.sigma * fit.sigma_scale) ** 2
    gradients = np.array([(rows * white)[:, :, poses == k].sum((1, 2)) for k in range(20)])
    expected = gradients.T @ gradients
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(pose_scores(seen, fit, poses) / size, expected / size, atol=1e-9)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_fit_without_shares_of_components_is_the_same_fit(loss):
    model = model_of(scene("external-pose", n=60))
    free = canonical(model, "external-pose")
    seen = observed(model, moved(free), np.random.default_rng(9))
    fits = [solve(seen, free, loss, with_shares=asked) for asked in (True, False)]
    assert fits[0].shares.shape == (6,) and fits[1].shares is None
    assert 0 < fits[0].shares.min() < 1 and np.ptp(fits[0].shares) > 0
    np.testing.assert_array_equal(*(fit.parameters.values for fit in fits))
    np.testing.assert_array_equal(*(fit.normal for fit in fits))
    assert fits[0].degrees == fits[1].degrees and fits[0].sigma_scale == fits[1].sigma_scale
