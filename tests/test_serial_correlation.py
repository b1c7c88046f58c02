"""Noise that is correlated from pose to pose is no structure, and a drift is no such noise."""

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import SIGMA, recorded
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.noise.serial_correlation import serial_correlation
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.compatible import equivalent_places
from workbench.diagnosis.search.findings import with_equivalent_places
from workbench.diagnosis.validation.correlated_noise import (
    reject_explained_by_correlated_noise,
    with_correlated_noise,
)
from workbench.diagnosis.validation.terms import Proof, Term
from workbench.explanation.answer import diagnose
from workbench.explanation.final_model import FinalModel, residual_covariances
from workbench.explanation.noise.correlated_noise import correlated_noise
from workbench.explanation.sentences.statements import statement
from workbench.fitting.verdicts.diagnosis_verdict import check_diagnosis


@dataclass(frozen=True)
class _Found:
    """The two p-values of `Found` that are changed."""

    p_first: float
    p_remainder: float


DRIFT = CATALOGUE["base-drift"]("base", 0.0, 20.0 * 119, 1)


def correlated(seed, value, n=120, effects=(), values=()):
    """A recording whose noise is an autoregressive process."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, SIGMA, (3, n))
    for k in range(1, n):
        noise[:, k] = value * noise[:, k - 1] + np.sqrt(1 - value**2) * noise[:, k]
    made = recorded(seed, effects, values, n=n, sigma=1e-6)
    columns = {f"{axis}_mm": made.columns[f"{axis}_mm"] + row for axis, row in zip("xyz", noise)}
    return replace(made, columns=dict(made.columns) | columns, sigma_mm=SIGMA)


def bench(*args, **given):
    return bench_of(correlated(*args, **given))


@pytest.mark.parametrize("value", [0.4, 0.7])
def test_the_correlation_of_noise_is_estimated(value):
    benches = [bench(seed, value, n=200) for seed in range(4)]
    found = [serial_correlation(one.problem((), hypotheses=False)) for one in benches]
    errors = np.array([(one.value - value) / one.std for one in found])
    assert np.abs(errors).max() < 3.5 and abs(errors.mean()) < 1.5


@pytest.mark.parametrize("size", [0.0, 10 * SIGMA])
def test_independent_noise_is_not_correlated_even_next_to_a_drift(size):
    values = [size, -size, size, 0.0, 0.0, 0.0]
    for seed in range(5):
        made = bench(seed, 0.0, effects=[DRIFT], values=values)
        assert serial_correlation(made.problem((), hypotheses=False)) is None


def test_what_correlated_noise_explains_is_not_left():
    made = bench(3, 0.7)
    problem = made.problem((), hypotheses=False)
    fresh, noise = with_correlated_noise(made, _Found(1e-6, 1e-6), [], problem)
    assert fresh.p_first > UNMODELLED_LEVEL and fresh.p_remainder > UNMODELLED_LEVEL
    assert "correlated from pose to pose (0." in correlated_noise(noise)


def test_a_law_of_the_joints_is_left_under_correlated_noise():
    law = CATALOGUE["joint-compliance"]("joint-2")
    made = bench(4, 0.5, effects=[law], values=[4e-6])
    problem = made.problem((), hypotheses=False)
    fresh, noise = with_correlated_noise(made, _Found(1e-6, 1e-6), [], problem)
    assert (fresh.p_first, noise) == (1e-6, None)


@pytest.mark.parametrize(("value", "size", "stays"), [(0.0, 5.0, True), (0.7, 0.0, False)])
def test_a_drift_is_refused_only_where_correlated_noise_explains_it(value, size, stays):
    made = bench(5, value, effects=[DRIFT], values=[size * SIGMA, 0, 0, 0, 0, 0])
    term = Term(Finding("base-drift", "base", "evenly", (DRIFT,), 1e-6, 0.9, 1.0, 30.0))
    kept, refused = reject_explained_by_correlated_noise(made, [term])
    assert (len(kept), len(refused)) == (stays, not stays)
    assert all("correlated from pose to pose" in one.reason for one in refused)


def test_a_step_is_refused_only_where_noise_next_to_it_is_correlated():
    """What a step leaves without it is correlated from pose to pose, though the noise is not."""
    step = CATALOGUE["shift"]("base", 20.0 * 29.5)
    term = Term(Finding("shift", "base", "after", (step,), 1e-6, 0.9, 1.0, 30.0))
    sizes = [48 * SIGMA, -36 * SIGMA, 32 * SIGMA, 0, 0, 0]
    made = bench(5, 0.0, n=60, effects=[step], values=sizes)
    without = made.problem((step,), hypotheses=False).conditional_on([])
    assert serial_correlation(without).value > 0.8
    kept, refused = reject_explained_by_correlated_noise(made, [term])
    assert (len(kept), len(refused)) == (1, 0)
    kept, refused = reject_explained_by_correlated_noise(bench(5, 0.8, n=60), [term])
    assert (len(kept), len(refused)) == (0, 1)


def walk(seed, n=60):
    """A recording whose measured points follow a random walk, beyond their independent noise."""
    made = recorded(seed, n=n)
    steps = np.random.default_rng(seed).normal(0, 3 * SIGMA, (3, n)).cumsum(1)
    columns = {f"{axis}_mm": made.columns[f"{axis}_mm"] + row for axis, row in zip("xyz", steps)}
    return bench_of(replace(made, columns=dict(made.columns) | columns))


STEP = CATALOGUE["shift"]("base", 20.0 * 21.5)


def rejected(made) -> list[str]:
    """Reasons for which the step of the base is no term."""
    term = Term(Finding("shift", "base", "once", (STEP,), 1e-6, 0.9, 1.0, 30.0))
    return [one.reason for one in reject_explained_by_correlated_noise(made, [term])[1]]


def test_a_step_stays_next_to_noise_that_is_less_correlated():
    made = bench(2, 0.5, n=60, effects=[STEP], values=[60 * SIGMA, 0, 0, 0, 0, 0])
    whole = made.problem((STEP,), hypotheses=False)
    values = [serial_correlation(whole.conditional_on(kept)).value for kept in ([], None)]
    assert values[0] > 0.8 and values[1] < 0.6
    assert rejected(made) == []


def test_a_random_walk_is_no_step():
    assert all("correlated from pose to pose" in rejected(walk(seed))[0] for seed in (0, 2, 3))


@pytest.mark.parametrize(("stated", "verdict"), [(1.0, "consistent"), (0.3, "unexplained")])
def test_what_is_above_the_stated_noise_is_not_explained_by_its_correlation(stated, verdict):
    made = replace(correlated(3, 0.7), sigma_mm=stated * SIGMA)
    answer = diagnose(made)
    assert answer.verdict == verdict
    assert (answer.correlation is None) == (verdict == "unexplained")


def test_correlated_noise_of_unknown_size_asks_for_repeats():
    """Nothing says that the correlated residual is noise; where a stated sigma agrees with it, it is."""
    made = replace(correlated(3, 0.7), sigma_mm=None)
    answer = diagnose(made)
    assert answer.correlation is not None
    assert answer.experiment.sentence.startswith("Measure some poses again at other times")
    assert any("nothing distinguishes slow noise from an effect" in one for one in answer.warnings)
    assert answer.verdict == "unexplained"
    sentence = check_diagnosis(answer, made).verdict.sentence
    shared = float(re.search(r"share at least ([\d.]+) mm", sentence)[1])
    assert shared == pytest.approx(np.sqrt(0.7 * 3) * SIGMA, rel=0.35)


def test_unknown_noise_is_at_most_what_the_final_model_leaves():
    """A drift that was refused takes its part off the residual, and that part is no finding."""
    drifting = correlated(1, 0.0, n=40, effects=[DRIFT], values=[10 * SIGMA, 0, 0, 0, 0, 0])
    made = bench_of(replace(drifting, sigma_mm=None))
    before = made.problem((), hypotheses=False)
    after = made.problem((DRIFT,), hypotheses=False).conditional_on()
    found = SimpleNamespace(
        before=before, after=after, outliers=np.zeros(40, bool), noise_findings=()
    )
    refused = FinalModel(made, found, "mm").noise
    proof = Proof(1.0, 1.0, 1.0, 0.0, 5, *refused, np.ones((2, 40)), np.arange(40) // 8)
    final = FinalModel(made, found, "mm", ()).with_noise(proof)
    squares = ((before.residual * before.units) ** 2).sum() / before.degrees
    assert refused[0] < 0.8 * final.noise
    assert final.noise == pytest.approx(np.sqrt(3 * squares), rel=0.02)


def test_noise_of_replicates_is_that_of_the_final_model():
    """Steps between the repeats of a pose, found in the noise and refused, take nothing off the noise."""
    made = bench_of(recorded(1, n=90, repeats=3))
    steps = [CATALOGUE["zero-shift"](f"joint-{k}", 20.0 * (15 * k + 0.5)) for k in range(1, 6)]
    before = made.problem((), hypotheses=False)
    after = made.problem(steps, hypotheses=False).conditional_on()
    found = SimpleNamespace(
        before=before, after=after, outliers=np.zeros(90, bool), noise_findings=()
    )
    refused = FinalModel(made, found, "mm").noise
    final = FinalModel(made, found, "mm", ())
    proof = Proof(1.0, 1.0, 1.0, 0.0, 5, *refused, np.ones((2, 90)), np.arange(90) // 18)
    points = np.stack([made.recording.columns[f"{axis}_mm"] for axis in "xyz"])
    spread = points.reshape(3, 30, 3).var(2, ddof=1).mean()
    assert refused[0] < final.noise[0]
    assert final.with_noise(proof).noise == pytest.approx(np.sqrt(3 * spread), rel=1e-3)


def test_places_of_a_function_of_the_angle_between_them_are_equivalent():
    assert equivalent_places("link-2", ["q3"], 6) == ("link-3",)
    assert equivalent_places("link-3", ["q3", "q4"], 6) == ("link-2", "link-4")
    assert equivalent_places("base", ["q1"], 6) == ("link-1",)
    assert equivalent_places("link-6", ["time"], 6) == ("tool",)
    assert equivalent_places("link-2", ["time"], 6) == equivalent_places("joint-3", ["q3"], 6) == ()


def test_the_statement_names_both_places_of_such_a_function():
    unknown = Finding("unknown", "link-2", "", (), 1e-9, 1.0, 1.0, 30.0, ("q3",))
    made = with_equivalent_places(unknown, 6)
    assert made.probability == 0.5 and made.alternatives[0].where == "link-3"
    said = statement(Term(made, size=0.2), "the reflector", "mm")
    assert "No pose distinguishes link 2 and link 3 as its place" in said


def test_residuals_of_a_fit_without_a_determined_direction_have_the_covariance_of_the_noise():
    """Of a few equal poses nothing is determined; the diagnosis ended with an error."""
    fit = SimpleNamespace(n=4, sample=np.tile(np.arange(4), 3), full_basis=np.zeros((12, 0)))
    np.testing.assert_array_equal(residual_covariances(fit), np.tile(np.eye(3), (4, 1, 1)))
