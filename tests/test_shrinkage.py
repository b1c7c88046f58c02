"""How large effects of one kind are comes from the data: right where they say it, harmless where they say all."""

from pathlib import Path

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from scenes import model_of, observed, scene
from workbench.core.effect import make_effects
from workbench.core.least_squares.solver import solve
from workbench.fitting.priors.shrinkage import rescaled, settled
from workbench.jobs.robot.calibrate import calibrate

WAVES = [("transmission-harmonic", f"joint-{k}", {"order": n}) for k in range(1, 7) for n in (1, 2)]
SIGMA_MM = 0.05


def waved(size, n, seed=0):
    """A model of an arm whose gears err by N(0, size) rad, on n noisy samples, and its true parameters."""
    model = model_of(
        scene("external-point", n=n, seed=3, reflectors={1: (30.0, -40.0, 100.0)}, sigma=SIGMA_MM)
    )
    model = model.with_effects(*make_effects(CATALOGUE, WAVES))
    waves = np.array(["transmission-harmonic" in key for key in model.parameters.keys])
    free = model.parameters.only(waves)
    rng = np.random.default_rng(seed)
    truth = free.unpack(rng.normal(0, size, waves.sum()))
    return observed(model, truth, rng), free, truth


@pytest.mark.parametrize("size", [3e-5, 1e-4, 3e-4])
def test_the_scale_is_that_of_the_truth(size):
    model, free, _ = waved(size, 300)
    found = rescaled(model, solve(model, free).parameters)
    priors = {p.prior for p, wave in zip(found.table, found.mask) if wave}
    assert len(priors) == 1  # one family, one size
    assert priors.pop() == pytest.approx(size, rel=0.5)


def test_where_there_is_nothing_the_prior_closes():
    model, free, _ = waved(0.0, 100)
    fit = solve(model, free)
    after = settled(model, fit, "linear", 50)
    assert np.abs(after.parameters.pack()).max() < 0.3 * np.abs(fit.parameters.pack()).max()


def test_few_samples_are_better_used():
    """Errors of the found waves against the truth, over draws: smaller than without a common scale."""
    plain, scaled = [], []
    for seed in range(10):
        model, free, truth = waved(1e-4, 20, seed)
        fit = solve(model, free)
        plain.append(fit.parameters.pack() - truth.pack())
        scaled.append(settled(model, fit, "linear", 50).parameters.pack() - truth.pack())
    assert np.mean(np.square(scaled)) < 0.9 * np.mean(np.square(plain))


def test_many_samples_say_all_by_themselves():
    """A prior of s draws what is known to std by (std / s)^2 of itself, which is within 3 s."""
    model, free, _ = waved(3e-4, 2000)
    fit = solve(model, free)
    after = settled(model, fit, "linear", 50)
    std = np.sqrt(np.diag(np.linalg.inv(fit.normal)))
    assert (np.abs(after.parameters.pack() - fit.parameters.pack()) < 3 * std**2 / 3e-4).all()
    assert np.median(std) < 0.05 * 3e-4


def test_only_effects_have_a_scale_and_never_wider_than_their_own():
    model, free, _ = waved(3e-4, 60)
    found = rescaled(model, free.free("joint-2.*2", "joint-3.a3"))
    own = [k for k, key in enumerate(found.keys) if key.count(".") == 1]
    assert [found.table[k].prior for k in own] == [free.table[k].prior for k in own]
    soft = model_of(scene("external-point", n=60)).with_effects(
        *make_effects(CATALOGUE, [("joint-compliance", f"joint-{k}", {}) for k in (2, 3)])
    )
    start = soft.parameters.only(["compliance" in key for key in soft.parameters.keys])
    far = start.unpack(100 * start.typical[start.mask])
    assert all(
        p.prior <= q.prior
        for p, q in zip(rescaled(soft, far).table, soft.parameters.table)
        if q.prior
    )
    assert rescaled(soft, soft.parameters.free("base.*")).table == soft.parameters.table


def test_a_plan_that_frees_what_is_undetermined_stays_as_published():
    """`canonical = false`: nothing of the paper's plans is drawn towards anything but its own priors."""
    made = pytest.importorskip(
        "datasets.makers.ye", reason="MuJoCo is not installed", exc_type=ImportError
    )
    recording = made.ye_second_experiment(120, seed=1, noise_mm=0.02).recording()
    found = calibrate(recording, Path("ye-2024"), folds=3)
    priors = {p.key: p.prior for p in found.solution.parameters.table}
    assert all(prior == p.prior for p in found.model.parameters.table for prior in [priors[p.key]])
