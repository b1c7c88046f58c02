"""A measurement that was written twice counts once; replicates of one pose are measurements of their own."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from datasets.samples.chunks import read_chunks
from datasets.samples.duplicates import first_of_equal_rows
from erring_scenes import erring
from robot_model.measurements import samples_of
from scenes import KINDS, scene
from workbench.explanation.answer import diagnose
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.calibrate_large import calibrate_chunks
from workbench.jobs.robot.compare import compare
from workbench.jobs.robot.identify import identifiability
from workbench.studies.resampling import by_poses


def joined(recording, rows, **columns):
    """The recording with some of its rows once more, under sample numbers of their own."""
    again = recording.select(rows)
    own = {
        name: np.concatenate([column, again.columns[name]])
        for name, column in recording.columns.items()
    }
    own["sample"] = np.arange(1.0, len(own["sample"]) + 1)
    return replace(recording, columns=own | columns)


@pytest.fixture(scope="module")
def doubled():
    """Sixty rows, and all of them once more."""
    robot, recording = erring("external-point", 1, n=60)
    return robot, recording, joined(recording, np.arange(60))


@pytest.mark.parametrize("measures", KINDS)
def test_a_copy_is_left_out_and_named(measures):
    recording = scene(measures, n=20, seed=3).recording
    copied = joined(recording, [4, 7])
    found = samples_of(copied)
    assert found.n == 20 and len(found.warnings) == 1
    assert "sample 21 = 5, 22 = 8" in found.warnings[0] and "'scene'" in found.warnings[0]
    assert samples_of(found).warnings == found.warnings
    assert samples_of(recording).warnings == ()


@pytest.mark.parametrize("change", ["x_mm", "q3_deg"])
def test_a_replicate_is_no_copy(change):
    recording = scene("external-pose", n=20, seed=3).recording
    copied = joined(recording, [4, 7])
    value = copied.columns[change].copy()
    value[20:] += 0.01
    assert samples_of(replace(copied, columns={**copied.columns, change: value})).n == 22


def test_the_same_reading_of_another_reflector_is_no_copy():
    recording = scene("external-point", n=20, seed=3).recording
    copied = joined(recording, [4])
    label = copied.columns["reflector"].copy()
    label[20] = next(one for one in np.unique(label) if one != label[20])
    assert samples_of(replace(copied, columns={**copied.columns, "reflector": label})).n == 21


def test_replicates_that_agree_by_coarse_rounding_are_no_copies():
    """Rounded to 0.1 mm, most replicates with a noise of 0.03 mm agree exactly."""
    recording = scene(
        "external-point", n=20, seed=3, reflectors={1: (30.0, -40.0, 100.0)}
    ).recording
    repeated = joined(recording, np.repeat(np.arange(20), 5))
    noise = 0.03 * np.random.default_rng(0).standard_normal((3, repeated.n))
    columns = {
        c: (repeated.columns[c] + e).round(1) for c, e in zip(("x_mm", "y_mm", "z_mm"), noise)
    }
    assert samples_of(replace(repeated, columns={**repeated.columns, **columns})).n == repeated.n


def test_copies_among_replicates_are_found():
    recording = scene("external-point", n=20, seed=3).recording
    repeated = joined(recording, np.repeat(np.arange(20), 2))
    noise = 0.03 * np.random.default_rng(0).standard_normal((3, repeated.n))
    columns = {
        c: (repeated.columns[c] + e).round(4) for c, e in zip(("x_mm", "y_mm", "z_mm"), noise)
    }
    repeated = replace(repeated, columns={**repeated.columns, **columns})
    copied = joined(repeated, np.arange(10))
    assert samples_of(copied).n == repeated.n
    assert (first_of_equal_rows(copied)[repeated.n :] == np.arange(10)).all()


def test_a_bootstrap_sample_keeps_every_draw():
    recording = scene("external-point", n=20, seed=3).recording
    drawn = by_poses(recording, None, np.random.default_rng(0))
    assert len(np.unique(drawn.columns["x_mm"])) < drawn.n
    assert samples_of(drawn).n == drawn.n and samples_of(drawn).warnings == ()


def test_calibrate_counts_a_copy_once(doubled):
    robot, once, twice = doubled
    plan = [geometry(robot)]
    single, copied = calibrate(once, plan, folds=3), calibrate(twice, plan, folds=3)
    assert copied.recording.n == 60
    np.testing.assert_allclose(copied.solution.covariance, single.solution.covariance, rtol=1e-9)
    assert any("60 rows repeat" in warning for warning in copied.as_json()["warnings"])
    assert single.as_json()["warnings"] == []
    assert copied.suspicions == ()


@pytest.mark.slow
def test_every_analysis_counts_a_copy_once(doubled):
    _, once, twice = doubled
    for found in (compare(twice, ["default"], folds=3).as_json(), identifiability(twice)):
        assert found["samples"] == 60 and "60 rows repeat" in found["warnings"][0]


@pytest.mark.slow
def test_diagnose_estimates_no_noise_of_zero_from_copies(doubled):
    _, once, twice = doubled
    single, copied = diagnose(once).as_json(), diagnose(twice).as_json()
    assert any("60 rows repeat" in warning for warning in copied["warnings"])
    assert copied["held_out"]["noise_mm"] == pytest.approx(single["held_out"]["noise_mm"])


def test_a_long_recording_counts_a_copy_once(doubled, tmp_path):
    robot, once, twice = doubled
    for name, one in (("once", once), ("twice", twice)):
        datasets.write(one, tmp_path / name, samples="parquet")
    chunks = read_chunks(tmp_path / "twice")
    assert chunks.n == 60 and sum(part.n for part in chunks) == 60 and len(chunks.pose) == 60
    plan = (geometry(robot),)
    single, copied = (calibrate_chunks(tmp_path / name, plan, 3) for name in ("once", "twice"))
    np.testing.assert_allclose(copied.solution.covariance, single.solution.covariance, rtol=1e-6)
    assert any(
        "60 of 120 moving rows repeat" in warning for warning in copied.as_json()["warnings"]
    )
