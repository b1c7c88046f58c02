"""Held-out errors are of samples that nothing saw: whole poses, consecutive blocks, and no leak."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import model_of, observed, scene
from workbench.core.least_squares.solver import solve
from workbench.fitting.cross_validation import (
    HeldOut,
    blocks,
    cross_validate,
    error_summary,
    hold_out,
    samples_of_some_poses,
)
from workbench.jobs.robot.calibrate import calibrate

poses = st.lists(st.integers(0, 12), min_size=1, max_size=60).map(np.array)


@given(poses=poses, folds=st.integers(1, 12))
def test_a_pose_is_never_parted(poses, folds):
    fold = blocks(poses, folds)
    for pose in np.unique(poses):
        assert len(np.unique(fold[poses == pose])) == 1


@given(poses=poses, folds=st.integers(1, 12))
def test_every_fold_is_filled_and_of_nearly_equal_number_of_poses(poses, folds):
    fold = blocks(poses, folds)
    count = len(np.unique(poses))
    assert set(fold) == set(range(min(folds, count)))
    sizes = [len(np.unique(poses[fold == k])) for k in range(fold.max() + 1)]
    assert max(sizes) - min(sizes) <= 1


@given(lengths=st.lists(st.integers(1, 4), min_size=2, max_size=30), folds=st.integers(2, 10))
def test_folds_are_blocks_of_consecutive_samples(lengths, folds):
    """Where the samples of a pose follow one another, as they are measured."""
    fold = blocks(np.repeat(np.arange(len(lengths))[::-1], lengths), folds)
    assert (np.diff(fold) >= 0).all() and (np.diff(fold) <= 1).all()


def started(n=60, seed=1):
    """A noisy recording's model, base, tool and two lengths free."""
    model = model_of(scene("external-point", n=n, seed=seed))
    free = model.parameters.free("base.*", "tool.*", "joint-2.a2", "joint-3.a3")
    return observed(model, free.update({"joint-2.a2": 270.4}), np.random.default_rng(seed)), free


def shifted(model, rows, by):
    """The same model with some samples measured wrong."""
    measured = model.chain.measurement.measured.copy()
    measured[:, rows] += by
    measurement = replace(model.chain.measurement, measured=measured)
    return replace(model, chain=replace(model.chain, measurement=measurement), _bases={})


@pytest.mark.parametrize("loss", ["linear", "huber"])
@pytest.mark.parametrize("poisoned", [0, 2])
def test_poison_in_a_held_out_fold_does_not_reach_its_prediction(loss, poisoned):
    model, free = started()
    fold = blocks(np.arange(60), 4)
    bad = fold == poisoned
    clean = cross_validate(model, free, fold, loss)
    poison = np.random.default_rng(0).normal(0, 50, (3, bad.sum()))
    spoilt = cross_validate(shifted(model, bad, poison), free, fold, loss)
    # predicted minus measured: the poison itself, and not a micrometre of reaction to it
    np.testing.assert_allclose(spoilt.residual[:, bad], clean.residual[:, bad] - poison, atol=1e-9)
    assert np.abs(spoilt.residual[:, ~bad] - clean.residual[:, ~bad]).max() > (
        1e-3 if loss == "huber" else 1
    )


def test_poison_in_named_test_samples_does_not_reach_their_prediction():
    model, free = started()
    test = np.arange(60) % 4 == 0
    clean, spoilt = (
        hold_out(m, free, test, ~test, "linear") for m in (model, shifted(model, test, 30.0))
    )
    np.testing.assert_allclose(spoilt.residual[:, test], clean.residual[:, test] - 30, atol=1e-9)
    assert np.isnan(clean.residual[:, ~test]).all() and (clean.fold == np.where(test, 0, -1)).all()


def test_each_fold_is_predicted_by_a_fit_of_the_others():
    model, free = started()
    fold = blocks(np.arange(60), 5)
    found = cross_validate(model, free, fold, "linear")
    for k in range(5):
        fit = solve(model.at(fold != k), free)
        np.testing.assert_allclose(
            found.residual[:, fold == k], model.at(fold == k).residual(fit.parameters), atol=1e-12
        )


def test_samples_of_no_fold_are_neither_fitted_nor_predicted():
    model, free = started()
    fold = np.where(np.arange(60) < 12, -1, blocks(np.arange(60), 4))
    clean, spoilt = (
        cross_validate(m, free, fold, "linear") for m in (model, shifted(model, fold < 0, 30.0))
    )
    np.testing.assert_allclose(spoilt.residual[:, 12:], clean.residual[:, 12:], atol=1e-9)
    assert np.isnan(clean.residual[:, :12]).all()


def test_a_reflector_that_only_the_held_out_samples_show_is_located_on_them():
    """And is named, because its error is then no longer quite unseen."""
    model, free = started()
    test = model.chain.state.index == 5
    found = hold_out(model, free, test, ~test, "linear")
    assert set(found.located) == {f"tool.reflector5_{axis}" for axis in "xyz"}
    assert found.rms < 0.06
    assert not hold_out(model, free, np.arange(60) < 10, np.arange(60) >= 10, "linear").located


def test_held_out_errors_are_of_the_noises_size():
    model, free = started(n=300)
    found = cross_validate(model, free, blocks(np.arange(300), 10), "linear")
    # three coordinates of 0.02 mm, and 17 parameters from 3 x 270 numbers; 900 numbers scatter by 2.4 %
    assert found.rms == pytest.approx(0.02 * np.sqrt(3 * (1 + 17 / 810)), rel=0.08)


def test_gains_are_judged_over_folds():
    fold = np.repeat(np.arange(10), 6)
    rng = np.random.default_rng(0)
    before = HeldOut(rng.normal(0, 1.0, (3, 60)), fold)
    assert HeldOut(0.8 * before.residual, fold).beats(before)
    assert not before.beats(HeldOut(0.8 * before.residual, fold))
    assert not before.beats(before)
    lucky = before.residual.copy()
    lucky[:, fold == 0] *= 0.1  # one fold of ten gained, the others lost a little
    lucky[:, fold != 0] *= 1.001
    assert not HeldOut(lucky, fold).beats(before)


def test_figures_are_of_distances():
    residual = np.array([[3.0, 0.0, np.nan], [4.0, 0.0, np.nan], [0.0, 1.0, np.nan]])
    found = error_summary(residual)
    assert found["rms_mm"] == pytest.approx(np.sqrt(13)) and found["mean_mm"] == pytest.approx(3)
    assert found["max_mm"] == pytest.approx(5) and found["p95_mm"] == pytest.approx(4.8)
    assert np.isnan(list(error_summary(residual[:, 2:]).values())).all()


def test_some_poses_are_taken_whole_and_from_everywhere():
    poses, samples = np.repeat(np.arange(300), 4), np.arange(1200) % 40 != 0
    some = samples_of_some_poses(poses, samples, 400)
    assert not (some & ~samples).any()
    taken = np.unique(poses[some])
    assert np.array_equal(some, samples & np.isin(poses, taken))
    assert (np.diff(taken) <= 5).all() and len(np.unique(taken % 3)) == 3
    assert 380 <= some.sum() <= 410
    assert np.array_equal(samples_of_some_poses(poses, samples, 1200), samples)


def test_a_calibration_keeps_repeats_of_a_pose_together():
    made = scene("external-point", n=60, seed=4)
    repeat = np.repeat(np.arange(20.0), 3)[np.random.default_rng(0).permutation(60)]
    recording = replace(made.recording, columns=made.recording.columns | {"repeat": repeat})
    result = calibrate(recording, plan=(), folds=5)
    assert result.held_out["folds"] == 5 and result.held_out["samples"] == 60
    for one in np.unique(repeat):
        assert len(np.unique(result.fold[repeat == one])) == 1


def test_a_calibration_tests_on_what_is_named_and_fits_on_the_rest():
    made = scene("external-point", n=60, seed=4)
    noise = np.random.default_rng(0).normal(0, 0.02, 60)
    columns = made.recording.columns | {"x_mm": made.recording.columns["x_mm"] + noise}
    named = np.arange(10, 25)
    result = calibrate(replace(made.recording, columns=columns), plan=(), test_samples=named)
    tested = np.isin(made.recording.sample_ids, named)
    assert (np.isfinite(result.held_out_residual[0]) == tested).all()
    columns["y_mm"] = columns["y_mm"] + np.where(tested, 5.0, 0)
    spoilt = calibrate(replace(made.recording, columns=columns), plan=(), test_samples=named)
    np.testing.assert_allclose(
        spoilt.solution.parameters.values, result.solution.parameters.values, atol=1e-6
    )
