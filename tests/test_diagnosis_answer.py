"""What a diagnosis proves, says and proposes: held-out blocks, controls, smallest sizes, shares, sentences."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from sensors.effects import CATALOGUE as SENSOR
from workbench.core.covariates import clock
from workbench.diagnosis.linear.problem import Alternative, Finding, Problem
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation import folds, held_out, left_out_blocks, stability
from workbench.diagnosis.validation.controls import PERMUTED, ROTATED, controls, of_order
from workbench.explanation import minimal_detectable_bias
from workbench.explanation.comparison import reference as references
from workbench.explanation.noise import replicates
from workbench.explanation.planning.candidate_recordings import list_candidates
from workbench.explanation.planning.experiment import (
    ConfoundedPair,
    compared,
    describe_comparison,
    missing_of,
    next_experiment,
)
from workbench.explanation.result import Term, options_of, verdict_of
from workbench.explanation.sentences import statements, words
from workbench.jobs.robot.simulate import simulate

SCENE = {
    "robot": "abb_irb120",
    "samples": 90,
    "seed": 4,
    "sigma_mm": 0.02,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.6,
    "approach": True,
    "payload_kg": [0.0, 0.5],
    "errors": {"length_mm": 0.1, "angle_deg": 0.02},
}
GAP = {"effect": "backlash", "where": "joint-2", "values": {"half_gap": 2e-4}}


def made(tmp_path, **more):
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE | more), encoding="utf-8")
    return simulate(path)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording with backlash of joint 2."""
    return made(tmp_path_factory.mktemp("gap"), effect=[GAP])


@pytest.fixture(scope="module")
def bench(recording):
    return bench_of(recording)


def gap():
    return CATALOGUE["backlash"]("joint-2")


def test_blocks_left_out_of_a_linear_fit_are_predicted_as_by_fitting_again():
    rng = np.random.default_rng(0)
    columns, y = rng.normal(size=(40, 5)), rng.normal(size=40)
    fold = np.arange(40) // 8
    q = np.linalg.qr(columns)[0]

    every, ones = np.arange(40), np.ones(40)
    problem = Problem(y, q, every, ones, ones, every, every, {}, (), ())
    again = np.empty(40)
    for k in range(5):
        again[fold == k] = (
            y[fold == k] - columns[fold == k] @ np.linalg.lstsq(columns[fold != k], y[fold != k])[0]
        )
    assert np.allclose(held_out.left_out(problem, fold), np.abs(again))


def test_held_out_error_of_a_right_model_is_noise_and_the_uncertainty_of_its_parameters():
    """The mean square of many draws of noise alone; a sample that is no usual one does not count."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(60, 12)) * np.linspace(0.2, 3, 60)[:, None]
    sample, ones, fold = np.repeat(np.arange(20), 3), np.ones(20), np.arange(20) // 4
    basis = np.linalg.qr(columns)[0]
    inliers = np.arange(20) != 7
    squares = []
    for y in rng.normal(size=(2000, 60)):
        problem = Problem(y, basis, sample, ones, np.ones(60), fold, fold, {}, (), ())
        squares.append((held_out.left_out(problem, fold)[inliers] ** 2).mean() / 3)
    factor = left_out_blocks.variance_factor(problem, fold, inliers)
    assert factor > 1.2 and factor == pytest.approx(np.mean(squares), rel=0.02)


def test_what_a_block_alone_determines_lowers_its_held_out_error():
    """As the pose of a board that no other image shows: it is fitted to the noise of its own block."""
    rng = np.random.default_rng(4)
    fold = np.arange(20) // 4
    sample, ones = np.repeat(np.arange(20), 3), np.ones(20)
    of_block = [rng.normal(size=(60, 3)) * (fold[sample] == k)[:, None] for k in range(5)]
    basis = np.linalg.qr(np.hstack([rng.normal(size=(60, 4)), *of_block]))[0]
    squares = []
    for y in rng.normal(size=(2000, 60)):
        problem = Problem(y, basis, sample, ones, np.ones(60), fold, fold, {}, (), ())
        squares.append((held_out.left_out(problem, fold) ** 2).mean() / 3)
    factor = left_out_blocks.variance_factor(problem, fold, np.ones(20, bool))
    assert factor < 0.9 and factor == pytest.approx(np.mean(squares), rel=0.02)


def test_folds_never_part_a_pose(bench):
    problem = bench.problem(()).conditional_on()
    pose = np.arange(90) // 3
    for scheme in folds.schemes(pose, problem):
        assert all(len(np.unique(scheme.fold[pose == p])) == 1 for p in range(30))
        assert len(np.unique(scheme.fold)) == len(scheme.folds)


def test_paired_gains_count_poses_and_not_samples():
    rng = np.random.default_rng(1)
    before, after = np.sqrt(rng.uniform(1, 3, 50)), np.sqrt(rng.uniform(0.8, 2.8, 50))
    once = held_out.paired_t(np.arange(50), before, after, np.ones(50, bool))
    often = held_out.paired_t(
        np.repeat(np.arange(50), 7), np.repeat(before, 7), np.repeat(after, 7), np.ones(350, bool)
    )
    assert often == pytest.approx(once)


def test_a_few_poses_far_off_do_not_hide_what_helps_all_others():
    rng = np.random.default_rng(5)
    before = np.sqrt(rng.uniform(1, 3, 300))
    after = 0.7 * before
    far = rng.choice(300, 6, replace=False)
    before[far], after[far] = 12.0, 12.0 * rng.uniform(0.6, 1.4, 6)
    inliers, pose = np.ones(300, bool), np.arange(300)
    squares = before**2 - after**2
    assert (
        squares.mean() / squares.std(ddof=1) * np.sqrt(300)
        < 3
        < 10
        < held_out.paired_t(pose, before, after, inliers)
    )
    assert held_out.paired_t(pose, after, before, inliers) == pytest.approx(
        -held_out.paired_t(pose, before, after, inliers)
    )


def held_out_errors(rng, shown, noise, true=1.0, count=60):
    """Poses, errors without and with an effect that makes `shown` (p,) sigmas at a pose and is `true` large, and
    sigmas (n,); its size is fitted to the other four fifths of the poses."""
    pose = np.repeat(np.arange(len(shown)), count)
    sigma, effect = (
        np.resize(noise, len(pose)),
        np.repeat(shown, count) * rng.choice([-1, 1], len(pose)),
    )
    error, left = rng.normal(size=len(pose)) + true * effect, np.empty(len(pose))
    for fold in range(5):
        out = pose % 5 == fold
        left[out] = error[out] - effect[out] * (effect[~out] @ error[~out]) / (
            effect[~out] @ effect[~out]
        )
    return pose, np.abs(error) * sigma, np.abs(left) * sigma, sigma


def test_what_only_some_poses_show_is_no_luck_and_what_is_noisy_hides_nothing():
    """Boards show it a little, or more; balls not at all; every fifth sample is of a kind that is ten times as noisy."""
    shown = np.concatenate([np.geomspace(0.1, 0.8, 14), np.zeros(20)])
    rng, noise = np.random.default_rng(3), np.array([1.0, 1.0, 1.0, 1.0, 10.0])
    plain, weighted = [], []
    for _ in range(30):
        pose, before, after, sigma = held_out_errors(rng, shown, noise)
        inliers = np.ones(len(pose), bool)
        plain.append(held_out.paired_t(pose, before, after, inliers))
        weighted.append(held_out.paired_t(pose, before, after, inliers, sigma))
    assert min(plain) < 2 < min(weighted)
    assert np.median(weighted) > 1.2 * np.median(
        plain
    )  # of the order that a normal distribution predicts, of about nine poses that show it


def test_absent_effect_and_effect_of_one_pose_are_not_significant():
    rng = np.random.default_rng(4)
    shown = np.concatenate([np.geomspace(0.02, 0.3, 14), np.zeros(20)])
    several = [held_out_errors(rng, shown, np.ones(1), 0.0) for _ in range(300)]
    chance = np.array(
        [held_out.paired_t(p, b, a, np.ones(len(p), bool), s) for p, b, a, s in several]
    )
    assert np.mean(chance > 2) < 0.023 and chance.mean() < 0
    one = np.where(np.arange(34) == 5, 3.0, 0.01)
    alone = [held_out_errors(rng, one, np.ones(1)) for _ in range(20)]
    assert max(held_out.paired_t(p, b, a, np.ones(len(p), bool), s) for p, b, a, s in alone) < 2


def test_where_few_poses_show_most_luck_proves_no_more_often():
    """A term that makes the prediction no better: t beyond 2 as often as a normal's, however few poses show it."""
    rng, t = np.random.default_rng(6), []
    for _ in range(1500):
        moves = 0.5 * np.exp(rng.normal(size=5)) * rng.choice([-1, 1], 5)
        before = rng.normal(size=5) + moves / 2
        t.append(held_out._jackknife_t(20 * (before**2 - (before - moves) ** 2), 20 * moves**2))
    assert np.mean(np.array(t) > 2) < 0.03
    assert max(t) < 4


def test_a_fold_finds_a_term_again_by_what_it_makes_and_not_by_its_name():
    rng = np.random.default_rng(7)
    own, other = rng.normal(size=(2, 300))
    assert stability._is_reselected(own, [0.4 * own + 0.1 * other, other])
    assert not stability._is_reselected(own, [-own])
    assert not stability._is_reselected(own, [other])
    assert not stability._is_reselected(own, [])


def test_with_sigma_a_root_mean_square_weighs_samples_as_a_fit_does():
    errors, sigma = np.array([1.0, 1.0, 30.0, np.nan]), np.array([1.0, 1.0, 10.0, 1.0])
    inliers = np.ones(4, bool)
    assert held_out.rms(errors, inliers, sigma) == pytest.approx(np.sqrt((1 + 1 + 9) / 2.01))
    assert held_out.rms(errors, inliers) == pytest.approx(np.sqrt(902 / 3))


def test_a_search_inside_a_fold_keeps_every_pose_where_these_are_few():
    every = np.ones(3000, bool)
    few = folds.thinned(np.arange(3000) // 125, every)
    many = folds.thinned(np.arange(3000) // 3, every)
    assert few.sum() <= folds._SEARCHED and len(np.unique((np.arange(3000) // 125)[few])) == 24
    assert (
        many.sum() <= folds._SEARCHED
        and (many.reshape(1000, 3).all(1) | ~many.reshape(1000, 3).any(1)).all()
    )


def test_a_direction_that_one_block_alone_shows_stays_where_all_samples_have_it(bench):
    block = bench.chain.state.covariates["q5"] > 0.2
    problem = bench.problem(()).conditional_on()
    assert (
        left_out_blocks.block_shares(problem, block[problem.sample]).max()
        < 1 - held_out.NEGLIGIBLE_SHARE
    )
    errors = held_out.Errors(bench).predicted(block.astype(int), {1: ()})[block]
    assert np.isfinite(errors).all() and errors.max() < 5


def test_a_real_cause_passes_its_control_and_a_wrong_one_gains_nothing(bench):
    (permuted,) = controls(bench, (), (gap(),))
    assert permuted.passed and permuted.share < 0.05 and permuted.p_value <= 0.01
    wrong = [
        controls(bench, (gap(),), (CATALOGUE["backlash"](f"joint-{k}"),))[0] for k in (1, 3, 5, 6)
    ]
    assert sum(one.passed for one in wrong) == 0


def step(after):
    return {"effect": "zero-shift", "where": "joint-3", "after": after, "values": {"shift": 3e-4}}


@pytest.mark.parametrize("after", [445.0, 205.0, 755.0])
def test_a_real_step_passes_its_controls_or_they_say_that_they_cannot_tell(tmp_path, after):
    made_of = bench_of(made(tmp_path, effect=[step(after)], payload_kg=[0.0, 0.0]))
    found = {
        c.kind: c for c in controls(made_of, (), (CATALOGUE["zero-shift"]("joint-3", after=after),))
    }
    assert set(found) == {PERMUTED, ROTATED}
    assert found[PERMUTED].passed and found[ROTATED].passed


def test_slow_drift_taken_for_a_step_fails_the_circular_shift_control(tmp_path):
    slow = {"effect": "joint-thermal-drift", "where": "joint-3", "values": {"per_unit": 0.02}}
    made_of = bench_of(made(tmp_path, effect=[slow], payload_kg=[0.0, 0.0]))
    for after in (205.0, 755.0):
        found = {
            c.kind: c
            for c in controls(made_of, (), (CATALOGUE["zero-shift"]("joint-3", after=after),))
        }
        assert found[ROTATED].passed is False


def test_what_reads_the_clock_is_known(bench):
    assert of_order(bench, (CATALOGUE["zero-shift"]("joint-2", after=400.0),))
    assert not of_order(bench, (gap(),))


def test_the_smallest_visible_is_found_as_often_as_is_said(bench):
    problem = bench.problem(()).conditional_on()
    rows = minimal_detectable_bias.minimal_detectable_biases(
        problem,
        problem.sigma,
        lambda c: [p.unit for e in c.effects for p in e.parameters(bench.chain)],
    )
    k = next(
        i
        for i, c in enumerate(problem.candidates)
        if (c.effect, c.where) == ("backlash", "joint-3")
    )
    column = problem.orthogonalise(problem.candidates[k].columns[:, 0] * rows[k].parameter)
    level = 1 - (1 - minimal_detectable_bias.FAMILY) ** (1 / len(rows))
    from scipy.stats import chi2

    noise = np.random.default_rng(2).normal(size=(4000, len(column)))
    gain = (column @ column + noise @ column) ** 2 / (column @ column)
    assert (gain > chi2.isf(level, 1)).mean() == pytest.approx(
        minimal_detectable_bias.POWER, abs=0.015
    )
    assert rows[k].unit == "rad" and rows[k].orthogonal_size < rows[k].size


def test_separable_distance_follows_from_the_likelihood_ratio():
    d = minimal_detectable_bias.separable_distance()
    ratio = np.random.default_rng(3).normal(d**2 / 2, d, 200_000)
    assert (ratio > np.log(19)).mean() == pytest.approx(0.95, abs=0.003)


def test_noise_comes_from_replicates_else_from_what_is_stated():
    rng = np.random.default_rng(4)
    residual = 0.03 * rng.normal(size=(3, 200)) + np.repeat(rng.normal(size=(3, 20)), 10, 1)
    found, source = replicates.noise(np.arange(200) // 10, np.zeros(200), residual, 0.5, 600)
    assert source == "from replicates" and found == pytest.approx(np.sqrt(3) * 0.03, rel=0.1)
    assert replicates.noise(np.arange(200), np.zeros(200), residual, 0.5, 600) == (
        np.sqrt(3) * 0.5,
        "as the recording states",
    )
    lack = replicates.lack_of_fit(np.arange(200) // 10, np.zeros(200), residual, 6)
    assert lack["p_value"] < 1e-6 and lack["f"] > 10


def test_shares_of_a_difference_add_up_and_only_structure_is_missing_physics(recording, tmp_path):
    path = tmp_path / "other.toml"
    path.write_text(
        tomli_w.dumps(SCENE | {"seed": 9, "base": {"xyz_mm": [1.0, 0.0, 0.0]}}), encoding="utf-8"
    )
    reference = references.reference_of(path, None)
    model, values = references.bound(reference, recording)
    found = references.shares(
        model, values, lambda residual, degrees: np.sqrt(3) * 0.02, reference.name
    )
    assert found.parameters_mm2 + found.noise_mm2 + found.structure_mm2 == pytest.approx(
        found.total_mm2, rel=1e-9
    )
    assert found.noise_mm2 == pytest.approx(3 * 0.02**2, rel=0.01)
    assert (
        found.structure_mm2 == pytest.approx(_of_gap(recording), rel=0.5)
        and found.placing_mm2 > 0.9
    )


def _of_gap(recording):
    """mm^2 that the gap makes and the fitted geometry does not take up."""
    problem = bench_of(recording).problem((gap(),))
    left = problem.orthogonalise(problem.added[0] @ problem.values[0]) * problem.sigma
    return float((left**2).sum() / problem.n)


def test_a_second_load_distinguishes_two_compliances(bench):
    doubt = ConfoundedPair(
        (CATALOGUE["joint-compliance"]("joint-2"),),
        np.array([2e-6]),
        (CATALOGUE["link-self-weight"]("joint-2"),),
        "one",
        "other",
    )
    rows = compared(bench, (), doubt, list_candidates(bench))
    assert rows[0][0]["plan"] == "the same poses with more load"
    assert rows[0][0]["apart_then_sigma"] > 1.5 * rows[0][0]["apart_now_sigma"]
    assert "kg more on the flange" in describe_comparison(doubt, rows)


def test_what_is_proposed_separates_as_far_as_was_said(bench):
    """The stated distance is what a fit of the whole plan finds: no step is lost between the two."""
    doubt = ConfoundedPair(
        (gap(),), np.array([1e-5]), (CATALOGUE["joint-thermal-drift"]("joint-2"),), "one", "other"
    )
    rows = compared(bench, (), doubt, list_candidates(bench))
    assert all(row["apart_then_sigma"] >= row["apart_now_sigma"] for row, _ in rows)


@pytest.mark.parametrize(
    "name, kind", [*CATALOGUE.items(), *(("sensor " + n, k) for n, k in SENSOR.items())]
)
def test_every_effect_has_a_sentence_with_its_place(name, kind):
    place = kind.places[0]
    where = f"{place}-3" if place in ("joint", "link", "ball") else place
    said = words.law(kind.effect, where, kind=kind)
    assert said[0].isupper() and not said.endswith(".") and " K " not in f"{said} "
    if place in ("joint", "link", "ball") and name != "ye-compliance":
        assert f"{place} 3".lower() in said.lower()


@pytest.mark.parametrize(
    "value, std, unit, said",
    [
        (1.3e-4, 1e-5, "rad", "0.130 ± 0.010 mrad"),
        (-2.04e-6, 3e-7, "rad/(N m)", "−2.04 ± 0.30 µrad/(N m)"),
        (1.2e-5, 1e-6, "1/K", "12.0 ± 1.0 ppm/K"),
        (0.25, None, "mm", "0.25 mm"),
        (0.0, 0.0, "mm", "0 µm"),
    ],
)
def test_figures_are_stated_in_units_without_rows_of_zeros(value, std, unit, said):
    assert words.measured(value, std, unit) == said


def term(probability, *others, effect="backlash", depends=()):
    alternatives = tuple(
        Alternative(name, "joint-3", "", p, 1.0, "same signature in these poses")
        for name, p in others
    )
    found = Finding(effect, "joint-3", "", (), 1e-9, probability, 0.3, 40.0, depends, alternatives)
    row = {"name": "half_gap", "label": "half gap", "value": 1.3e-4, "std": 1e-5, "unit": "rad"}
    return Term(found, (row,), 0.08, 5.2, 4.1, 0.013, 9, 9)


def test_the_statement_names_effect_place_size_and_proof():
    said = statements.statement(term(0.99), "the ball", "mm")
    assert said == (
        "Joint 3 differs from its reading by half the gap, to one side or the other: "
        "half gap 0.130 ± 0.010 mrad, 0.08 mm RMS at the ball. It reduces the held-out RMS error by 0.013 mm (t = 5.2) and is reselected "
        "in 9 of 9 folds."
    )
    doubtful = statements.statement(term(0.6, ("zero-shift", 0.4)), "the ball", "mm")
    assert doubtful.endswith(
        "In these poses the name is not certain. This effect has a probability of 0.60; zero-shift at joint 3 0.40."
    )


def test_a_refused_term_has_its_reason_and_no_other_names():
    refused = replace(term(0.001, ("zero-shift", 0.4)), kept=False, reason="its gain is not real")
    said = statements.statement(refused, "the ball", "mm")
    assert said.endswith("9 of 9 folds. Reason: its gain is not real.") and "zero-shift" not in said


def test_the_verdict_follows_from_the_terms():
    assert verdict_of((), 0.5) == "consistent"
    assert verdict_of((), 1e-9) == "unexplained"
    assert verdict_of((term(0.99),), 1e-9) == "explained"
    assert verdict_of((term(0.6, ("zero-shift", 0.4)),), 1e-9) == "ambiguous"
    assert (
        verdict_of((term(0.99), term(0.9, effect="unknown", depends=("q2",))), 1e-9)
        == "unexplained"
    )


def test_options_are_listed_as_json_types(bench):
    wave = CATALOGUE["transmission-harmonic"]("joint-2", order=3.0)
    assert options_of((wave,)) == {"order": 3.0}
    assert options_of((CATALOGUE["backlash"]("joint-2", seat="gravity", width=0.2),)) == {
        "seat": "gravity",
        "width": 0.2,
    }
    assert options_of((bench.with_masses[0].effect,)) == {"masses_found": True}


def test_what_is_not_certain_is_never_said_to_need_nothing(bench):
    problem = bench.problem(())
    hidden = Alternative(
        "backlash", "joint-3", "", 0.5, 1.0, "needs what was not recorded", "approach"
    )
    moving = Term(Finding("unknown", "joint-3", "", (), 1e-9, 1.0, 0.3, 40.0, (), (hidden,)))
    said = next_experiment(bench, (moving,), problem, 1e-9).sentence
    assert (
        said
        == "Record the side from which each joint came with every sample; without it this is not identifiable."
    )
    assert missing_of((moving,)) == ("approach",)
    unknown = Term(Finding("unknown", "joint-1", "", (), 1e-9, 0.99, 0.3, 40.0, ("move1",)))
    said = next_experiment(bench, (unknown,), problem, 1e-9).sentence
    assert "the last move of joint 1" in said and "othing" not in said.replace(
        "nothing else does", ""
    )
    assert next_experiment(bench, (), problem, 1e-9).sentence.startswith("Measure more poses")
    assert next_experiment(bench, (), problem, 0.5).sentence.startswith("None is needed")


def test_what_was_found_and_not_retained_is_open(bench):
    problem = bench.problem(())
    sure = Term(Finding("joint-compliance", "joint-2", "", (), 1e-9, 0.999, 0.3, 40.0))
    open_yet = Term(Finding("backlash", "joint-3", "", (), 1e-9, 0.9, 0.02, 9.0), kept=False)
    said = next_experiment(bench, (sure,), problem, 1e-9).sentence
    assert said.startswith("No finding is in doubt")
    said = next_experiment(bench, (sure,), problem, 1e-9, (open_yet,)).sentence
    assert said.startswith("Of the findings that are retained none is in doubt.")
    assert "Open is backlash at joint 3, which was found and not retained" in said


def test_a_held_out_sample_next_to_an_instant_is_not_predicted_where_no_other_tells_its_side(
    tmp_path,
):
    made_of = bench_of(made(tmp_path, effect=[step(445.0)], payload_kg=[0.0, 0.0]))
    times = clock(made_of.chain.state)
    adjacent = np.argsort(np.abs(times - 445.0))[:2]
    fold = np.where(np.isin(np.arange(len(times)), adjacent), 0, 1)
    effects = (CATALOGUE["zero-shift"]("joint-3", after=445.0),)
    errors = held_out.Errors(made_of)
    assert np.isnan(errors(effects, fold)[adjacent]).all()
    assert np.isfinite(errors((), fold)).all(), "without a step no side is asked for"
    far = np.argsort(np.abs(times - 445.0))[10:20]
    elsewhere = np.where(np.isin(np.arange(len(times)), far), 0, 1)
    assert np.isfinite(errors(effects, elsewhere)[far]).all()
