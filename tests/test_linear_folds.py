"""Folds by one linearisation predict held-out samples as folds that are fitted one by one do."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import model_of, observed, scene
from workbench.core.least_squares.solver import solve
from workbench.fitting import linear_folds
from workbench.fitting.cross_validation import blocks, cross_validate
from workbench.fitting.linear_folds import cross_validate_linearised

EFFECTS = (
    ("transmission-harmonic", "joint-1", {"order": 1}),
    ("transmission-harmonic", "joint-2", {"order": 1}),
    ("joint-compliance", "joint-2", {}),
    ("joint-compliance", "joint-3", {}),
)


def fitted(measures, n=120):
    """A model of noisy samples with effects of one typical size, its fit, and ten folds."""
    model = model_of(scene(measures, n=n), *EFFECTS)
    start, own = model.parameters, len(model.chain.parameters)
    is_effect = np.arange(len(start)) >= own
    truth = replace(start, values=start.values + start.typical * is_effect)
    model = observed(model, truth, np.random.default_rng(3))
    frames = np.char.startswith(start.keys, "base.") | np.char.startswith(start.keys, "tool.")
    fit = solve(model, start.only(is_effect | frames))
    return model, fit.parameters, blocks(np.arange(n), 10)


@pytest.fixture
def without_fits(monkeypatch):
    """No fold may have a fit of its own."""

    def refuse(*arguments):
        raise AssertionError("one linearisation is enough here")

    monkeypatch.setattr(linear_folds, "hold_out", refuse)


@pytest.mark.parametrize("settle", [False, True])
@pytest.mark.parametrize("measures", ["external-point", "external-pose", "ball-centre"])
def test_one_linearisation_predicts_as_ten_fits_do(measures, settle, without_fits):
    model, start, fold = fitted(measures)
    found = cross_validate_linearised(model, start, fold, settle=settle)
    expected = cross_validate(model, start, fold, "linear", settle=settle)
    sigma = np.broadcast_to(model.chain.sigma, expected.residual.shape)
    assert np.abs((found.residual - expected.residual) / sigma).max() < 0.02
    assert found.rms == pytest.approx(expected.rms, rel=1e-3)
    assert np.array_equal(found.fold, expected.fold) and found.located == expected.located


def test_a_fold_that_a_step_does_not_reach_is_fitted(monkeypatch):
    model, start, fold = fitted("external-point")
    monkeypatch.setattr(linear_folds, "_SAME_FIT", -1.0)
    found = cross_validate_linearised(model, start, fold)
    np.testing.assert_array_equal(
        found.residual, cross_validate(model, start, fold, "linear").residual
    )


def test_samples_of_no_fold_have_no_part(without_fits):
    model, start, fold = fitted("external-point")
    fold[::4] = -1
    found = cross_validate_linearised(model, start, fold)
    assert np.isnan(found.residual[:, ::4]).all()
    expected = cross_validate(model, start, fold, "linear")
    assert found.rms == pytest.approx(expected.rms, rel=1e-3)


def test_what_only_one_fold_shows_is_located_on_it(without_fits):
    """Reflector 2 is measured in one fold alone: its place can come from nowhere else."""
    model, start, _ = fitted("external-point")
    reflector = model.chain.state.index
    if len(np.unique(reflector)) < 2:
        pytest.skip("this scene has one reflector")
    fold = np.where(reflector == reflector.max(), 9, np.arange(len(reflector)) % 9)
    found = cross_validate_linearised(model, start, fold)
    expected = cross_validate(model, start, fold, "linear")
    assert found.located and found.located.keys() == expected.located.keys()
