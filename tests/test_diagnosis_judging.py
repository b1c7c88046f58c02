"""Held-out errors come from splits that can judge the terms, and terms that do not reduce them are not kept."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from test_real_arm_effects import without_masses
from workbench.diagnosis.linear.problem import Finding, Found, Located, Problem
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find, found_terms
from workbench.diagnosis.validation import held_out, judging, proof, stability
from workbench.diagnosis.validation.controls import controls
from workbench.diagnosis.validation.folds import SPACE, TIME, Scheme, schemes
from workbench.diagnosis.validation.held_out import DOUBLED, critical_t, left_out
from workbench.diagnosis.validation.left_out_blocks import decorrelated
from workbench.explanation.answer import diagnose
from workbench.explanation.result import UNEXPLAINED, Term, verdict_of
from workbench.explanation.sentences import statements
from workbench.explanation.unexplained import unknown_terms
from workbench.fitting.cross_validation import cross_validate
from workbench.jobs.robot.simulate import simulate

SCENE = {
    "robot": "abb_irb120",
    "samples": 120,
    "seed": 4,
    "sigma_mm": 0.05,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.6,
    "errors": {"length_mm": 0.1, "angle_deg": 0.02},
}
STEP = {"effect": "zero-shift", "where": "joint-2", "after": 105.0, "values": {"shift": 1e-3}}


def problem_with(columns: np.ndarray, values: np.ndarray) -> Problem:
    """A problem without a baseline whose only effect has columns (N, P) and values (P,)."""
    n = len(columns)
    return Problem(
        np.zeros(n),
        np.zeros((n, 0)),
        np.arange(n),
        np.ones(n),
        np.ones(n),
        np.arange(n),
        np.arange(n) * 1.0,
        {},
        (),
        (),
        effects=(SimpleNamespace(),),
        added=(columns,),
        values=(values,),
    )


def test_a_curve_is_not_judged_by_a_split_that_leaves_its_angles_out():
    """Ten pieces of an angle's range: blocks of the range leave two pieces out, blocks dealt in turn none."""
    piece = np.repeat(np.arange(10), 20)
    columns = (piece[:, None] == np.arange(10)).astype(float)
    problem = problem_with(columns, np.linspace(1, 2, 10))
    blocks, dealt = piece // 2, np.arange(200) % 5
    assert judging.extrapolated_share(problem, [0], blocks) > 0.99
    assert judging.extrapolated_share(problem, [0], dealt) < 0.01
    bench = SimpleNamespace(chain=None)
    parts = [Scheme(TIME, blocks), Scheme(SPACE, dealt)]
    assert [s.name for s in judging.judging_schemes(bench, (), parts, problem, [0])] == [SPACE]


def test_a_term_of_few_numbers_is_judged_by_every_split():
    columns = np.random.default_rng(0).normal(size=(200, 2))
    problem = problem_with(columns, np.ones(2))
    assert judging.extrapolated_share(problem, [0], np.arange(200) // 40) == 0.0


def test_left_out_blocks_are_predicted_with_the_priors_of_the_effects():
    """A piece of a curve that only the block left out has is predicted by its prior, and not without bounds."""
    rng = np.random.default_rng(0)
    columns = (np.repeat(np.arange(5), 8)[:, None] == np.arange(5)) * 3.0
    columns[:, 0] += 0.3 * rng.normal(size=40)
    baseline = np.linalg.qr(rng.normal(size=(40, 3)))[0]
    y, fold = rng.normal(size=40) + 2.0, np.repeat(np.arange(5), 8)
    precision = np.array([4.0, 1.0, 0.5, 9.0, 2.0])
    values = rng.normal(size=5)
    problem = replace(
        problem_with(columns, values),
        basis=baseline,
        residual=y + columns @ values,
        precisions=(precision,),
    )
    expected = np.empty(40)
    both = np.concatenate([baseline, columns], 1)
    prior = np.diag(np.concatenate([np.zeros(3), precision]))
    for k in range(5):
        seen = both[fold != k]
        found = np.linalg.solve(seen.T @ seen + prior, seen.T @ y[fold != k])
        expected[fold == k] = y[fold == k] - both[fold == k] @ found
    assert np.allclose(left_out(problem.conditional_on(), fold), np.abs(expected))


def test_a_term_is_judged_in_spite_of_another_that_mostly_a_block_determines():
    """A drift that begins shortly before the last block says nothing about a wave, which has a gain in every block."""
    rng = np.random.default_rng(2)
    t = np.linspace(0, 1, 200)
    columns = np.stack([np.maximum(t - 0.785, 0) * 50, np.cos(37 * t), np.sin(37 * t)], 1)
    values = np.array([1.0, 0.4, -0.3])
    noise = rng.normal(size=200)
    problem = replace(
        problem_with(columns, values),
        residual=noise,
        effects=(SimpleNamespace(port="joint"), SimpleNamespace(port="joint")),
        added=(columns[:, :1], columns[:, 1:]),
        values=(values[:1], values[1:]),
        precisions=(np.zeros(1), np.zeros(2)),
    )
    fold = np.arange(200) // 40
    errors = [left_out(problem.conditional_on(present), fold)[None] for present in ((0,), (0, 1))]
    t_of_plain_errors = held_out.clark_west_t(np.arange(200), *errors, np.ones(200, bool))
    assert not t_of_plain_errors > critical_t(None)
    finding = Finding("transmission-harmonic", "joint-1", "", (), 0.0, 1.0, 0.0, 0.0)
    trial = judging.ConditionalGains(SimpleNamespace(chain=None, sigma=None), problem)
    wave = trial.with_gains(Term(finding), [1], [0, 1])
    assert wave.t > critical_t(None) and wave.gain > 0


def test_decorrelated_errors_have_the_variance_of_the_noise():
    """V^-1/2 e of a right model has the identity as its covariance, whatever a block leaves uncertain."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(30, 4)) * np.repeat([2.0, 1.0, 0.5], 10)[:, None]
    fold, precision = np.repeat(np.arange(3), 10), np.full(4, 0.5)
    problem = replace(problem_with(columns, np.zeros(4)), precisions=(precision,))
    root = decorrelated(problem.conditional_on(), fold, np.eye(30)).T
    for k in range(3):
        block, others = columns[fold == k], columns[fold != k]
        posterior = np.linalg.inv(others.T @ others + np.diag(precision))
        covariance = np.eye(10) + block @ posterior @ block.T
        own = root[np.ix_(fold == k, fold == k)]
        assert np.allclose(own @ covariance @ own.T, np.eye(10), atol=1e-8)


def test_effects_in_the_order_of_their_gain_keep_the_basis_of_all():
    """Each next effect is the one with which the set explains most; inner products with the basis of all stay."""
    rng = np.random.default_rng(4)
    added = tuple(rng.normal(size=(60, width)) for width in (3, 1, 2, 4))
    values = tuple(rng.normal(size=part.shape[1]) * k for k, part in enumerate(added, 1))
    problem = replace(problem_with(added[0], values[0]), added=added, values=values)
    problem = replace(problem, effects=(SimpleNamespace(),) * 4, residual=rng.normal(size=60))
    effects, ordered = problem.added_effects, []
    for _ in range(4):
        others = [i for i in range(4) if i not in ordered]
        gains = [(effects.subspace([*ordered, i]).score ** 2).sum() for i in others]
        ordered.append(others[int(np.argmax(gains))])
    assert effects.order_by_gain(lambda remaining: remaining) == ordered
    moved = problem.reordered(ordered).added_effects
    assert np.allclose(moved.basis, effects.basis)
    first = effects.subspace(ordered[:1])
    assert np.allclose(moved.subspace([0]).y, first.y)


def test_a_parameter_that_moves_nothing_does_not_change_what_is_predicted():
    """Its column of zeros has an unbounded precision, which must leave the correlations of the others as they are."""
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(40, 1)) + 0.3 * rng.normal(size=(40, 12))
    y, fold = rng.normal(size=40), np.repeat(np.arange(5), 8)

    def predicted(columns):
        count = columns.shape[1]
        problem = problem_with(columns, np.zeros(count))
        return replace(problem, residual=y, precisions=(np.full(count, 0.1),)).conditional_on()

    plain, wider = predicted(columns), predicted(np.insert(columns, 5, 0.0, axis=1))
    assert np.allclose(left_out(wider, fold), left_out(plain, fold), rtol=1e-9)


@pytest.mark.parametrize("seed", [4, 5])
def test_blocks_left_out_to_first_order_are_predicted_as_by_complete_refits(tmp_path, seed):
    """An arm without masses at 45 poses; to 2 % in RMS."""
    tilt = {"effect": "bearing-compliance", "where": "joint-1", "values": {"tilt": 3e-4}}
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE | {"samples": 45, "seed": seed, "effect": [tilt]}))
    bench = bench_of(without_masses(simulate(path)))
    places = {
        "gravity-bearing-compliance": "joint-1",
        "gravity-compliance": "joint-4",
        "gravity-link-compliance": "link-3",
    }
    effects = tuple(CATALOGUE[name](where) for name, where in places.items())
    problem = bench.problem(effects, hypotheses=False)
    model, fit, _ = bench.solve(effects, is_complete=False)
    for scheme in schemes(bench.pose, problem):
        refit = cross_validate(model, fit.parameters, scheme.fold, "huber").rms
        errors = left_out(problem.conditional_on(), scheme.fold)
        assert np.sqrt((errors**2).mean()) == pytest.approx(refit, rel=0.02)


def test_a_cause_with_many_numbers_passes_its_permutation_control_with_few_poses():
    """Twelve functions of 40 poses explain a third of any signal: that much says nothing against the cause."""
    rng = np.random.default_rng(3)
    columns, cause = rng.normal(size=(40, 12)), CATALOGUE["backlash"]("joint-2")
    signal = columns @ rng.normal(size=12) + 0.1 * rng.normal(size=40)
    with_it = problem_with(columns, np.zeros(12))
    plain = replace(with_it, residual=signal, effects=(), added=(), values=())
    bench = SimpleNamespace(chain=None, problem=lambda effects, **_: with_it if effects else plain)
    assert controls(bench, (), (cause,))[0].passed
    constant = replace(with_it, residual=3.0 + 0.1 * rng.normal(size=40))
    same = problem_with(np.ones((40, 1)) + 1e-3 * rng.normal(size=(40, 1)), np.zeros(1))
    unowed = replace(constant, effects=(), added=(), values=())
    bench = SimpleNamespace(chain=None, problem=lambda effects, **_: same if effects else unowed)
    assert not controls(bench, (), (cause,))[0].passed


def test_effects_with_many_parameters_take_from_another_only_what_their_priors_allow():
    """Thirty coefficients of 40 poses, known to be small, make most of any signal only where they may have any size."""
    rng = np.random.default_rng(3)
    others = rng.normal(size=(40, 30))
    columns = others @ rng.normal(size=(30, 1)) / np.sqrt(30) + 0.1 * rng.normal(size=(40, 1))
    own, other = CATALOGUE["backlash"]("joint-2"), CATALOGUE["backlash"]("joint-3")
    signal = columns[:, 0] + 0.3 * rng.normal(size=40)

    def passes(precision: float) -> bool:
        with_others = replace(
            problem_with(others, np.zeros(30)),
            residual=signal,
            effects=(other,),
            precisions=(np.full(30, precision),),
        )
        with_own = problem_with(columns, np.zeros(1))
        bench = SimpleNamespace(
            chain=None, problem=lambda effects, **_: with_own if own in effects else with_others
        )
        return bool(controls(bench, (other,), (own,))[0].passed)

    assert passes(1e4) and not passes(0.0)


def test_a_term_without_a_gain_goes_however_large_its_t():
    weak, harmful = (Term(Finding(n, "joint-2", "", (), 1e-9, 1.0, 1.0, 1.0)) for n in "wh")

    def judged(left, among):
        figures = {"w": (3.0, 0.01), "h": (8.0, -0.01)}
        made = [figures[term.finding.effect] for term in left]
        return [replace(one, t=t, gain=gain) for one, (t, gain) in zip(left, made)]

    left, gone = proof._without_insignificant(judged, [weak, harmful], 2.5)
    assert [term.finding.effect for term in left] == ["w"]


def test_all_terms_that_stay_are_judged_among_those_that_stay():
    """A clear term is not judged again while unclear ones go, and goes itself where it needed one of them."""
    clear, needing, weak = (
        Term(Finding(n, "joint-2", "", (), 1e-9, 1.0, 1.0, 1.0)) for n in ("clear", "needing", "w")
    )
    asked = []

    def judged(some, among):
        names = {term.finding.effect for term in among}
        asked.append(({term.finding.effect for term in some}, names))
        t = {"clear": 30.0 + len(names), "needing": 20.0 if "w" in names else 1.0, "w": 1.5}
        return [replace(term, t=t[term.finding.effect], gain=1.0) for term in some]

    left, gone = proof._without_insignificant(judged, [clear, needing, weak], 2.5)
    assert [(term.finding.effect, term.t) for term in left] == [("clear", 31.0)]
    assert [term.finding.effect for term in gone] == ["w", "needing"]
    everything = {"clear", "needing", "w"}
    both = {"clear", "needing"}
    assert asked == [(everything, everything), (set(), both), (both, both), (set(), {"clear"})] + [
        ({"clear"}, {"clear"})
    ]


def test_a_scheme_in_which_the_error_rises_counts_on_the_scale_of_the_others():
    """A rise of 1.9 standard errors in one scheme, and a gain of 3.5 in another, which is 7 by Clark and West."""
    rise = judging.combined_t([-1.9 * DOUBLED, 7.0], None)
    assert rise < critical_t(None)
    assert judging.combined_t([-2.1 * DOUBLED, 9.0], None) == -2.1 * DOUBLED
    assert judging.combined_t([-2.1, 9.0], np.ones(3)) == -2.1


@pytest.mark.parametrize(
    "errors, supported, shown",
    [
        (
            ((0.479, 0.548, True), (0.500, 0.300, True)),
            False,
            SPACE,
        ),  # a split that can judge says it is worse
        (
            ((0.117, 0.185, False), (0.120, 0.060, True)),
            True,
            SPACE,
        ),  # a step, by a block of time that contains it
        (((0.117, 0.090, True), (0.120, 0.060, True)), True, TIME),
        (((0.117, 0.117, True), (0.120, 0.120, True)), False, TIME),
    ],
)
def test_the_shown_error_is_of_a_split_that_judges_and_falls(errors, supported, shown):
    rows = [
        judging.SchemeErrors(Scheme(name, np.zeros(1, int)), np.zeros(1), np.zeros(1), *row)
        for name, row in zip((TIME, SPACE), errors)
    ]
    assert judging.is_supported(rows) is supported
    assert judging.reported_scheme(rows).scheme.name == shown


def test_a_few_errors_far_off_do_not_decide_whether_the_held_out_error_falls():
    rng = np.random.default_rng(1)
    before, usual = np.abs(rng.normal(size=400)), np.ones(400, bool)
    after = np.where(np.arange(400) < 4, 10.0, 0.5 * before)
    without, with_it = held_out.rms_pair(before, after, usual)
    assert with_it < without < 1.1
    assert held_out.rms(after, usual) > held_out.rms(before, usual)
    sigma = np.full(400, 0.1)  # squares of errors over sigma are then 100 times as large
    np.testing.assert_allclose(
        held_out.rms_pair(0.1 * before, 0.1 * after, usual, sigma), [0.1 * without, 0.1 * with_it]
    )
    fallen = held_out.rms_pair(before, 0.5 * before, usual)
    assert fallen == (held_out.rms(before, usual), held_out.rms(0.5 * before, usual))
    risen = held_out.rms_pair(before, 2 * before, usual)
    assert risen == (held_out.rms(before, usual), held_out.rms(2 * before, usual))


def test_terms_that_raise_the_held_out_error_are_refused_one_by_one(monkeypatch):
    """The term with the least support goes first, and all go where the error never falls."""
    names = [("joint-coupling", "joint-1"), ("axis-run-out", "joint-2")]
    terms = [
        Term(Finding(*name, "", (), 1e-9, 1.0, 1.0, 50.0), t_nested=t)
        for name, t in zip(names, (3.0, 9.0))
    ]
    scheme = Scheme(TIME, np.zeros(4, int))
    whole = [stability.Nested(scheme, np.full(4, 0.479), np.full(4, 0.548), {}, 5.0)]
    monkeypatch.setattr(proof, "schemes_judging_all", lambda bench, terms, parts: parts)
    errors = SimpleNamespace(
        bench=SimpleNamespace(unit="mm", sigma=None),
        predicted=lambda fold, kept: np.full(4, 0.489),
    )
    kept, refused, rows = proof._supported(errors, terms, [], whole, np.ones(4, bool))
    assert kept == [] and [term.finding.effect for term in refused] == [
        "joint-coupling",
        "axis-run-out",
    ]
    assert all("the held-out error (blocks of time) rises" in term.reason for term in refused)
    assert judging.reported_scheme(rows).rms_after == judging.reported_scheme(rows).rms_before
    assert verdict_of((), 1e-6) == UNEXPLAINED


def test_folds_of_one_kind_alone_search_where_terms_have_many_coefficients(monkeypatch):
    """The other kind predicts with the terms of all samples, says so, and neither judges names nor is shown first."""
    wave = CATALOGUE["transmission-harmonic"]("joint-2", order=3.0)
    bench = bench_of(recorded(8, (wave,), [3e-4, 2e-4], n=120))
    found = find(bench)
    monkeypatch.setattr(stability, "_MANY_COEFFICIENTS", 0)
    proved, terms, _ = proof.prove(bench, found, found_terms, (0.035, "stated"))
    nested, same = proved.schemes
    assert [term.finding.effect for term in terms] == ["transmission-harmonic"]
    assert nested["nested"] and not same["nested"]
    assert same["after"] == same["after_same_terms"] < same["before"]
    assert terms[0].searched_folds == nested["folds"] == 5
    assert proved.scheme == nested["folds_by"]


@pytest.mark.slow
def test_a_step_in_time_is_judged_by_blocks_of_the_workspace(tmp_path):
    """Whoever leaves out the block of time with the step cannot know when it was: that error hardly falls."""
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE | {"effect": [STEP]}), encoding="utf-8")
    made = diagnose(simulate(path))
    shown = made.as_json()["held_out"]
    assert [term.finding.effect for term in made.terms] == ["zero-shift"]
    assert shown["scheme"] == SPACE and shown["after_mm"] < 0.7 * shown["before_mm"]
    assert {row["folds_by"]: row["judges"] for row in shown["schemes"]} == {
        TIME: False,
        SPACE: True,
    }


def found_with(located, p_first=1e-6) -> Found:
    return Found((), None, None, p_first, 1.0, located, (), np.zeros(4, bool))


def test_what_is_unexplained_is_never_a_function_with_p_1_and_no_share():
    """Where no smooth function is significant anywhere, the place is that of the strongest term that was refused."""
    nothing = (Located("laser", "plane", ("v",), 0.0, 1.0),)
    bow = Finding("plane-bow", "laser", "", (), 1e-7, 0.9, 1.0, 60.0)
    refused = (Term(bow, kept=False, reason="it does not predict the others"),)
    likely = (
        "most likely at the laser. The most probable cause there is plane-bow, with a probability of 0.90 in the first "
        "search. Cross-validation did not confirm it"
    )
    for gone, where, said in ((refused, "laser", likely), ((), "samples", statements.NOT_LOCATED)):
        (term,) = unknown_terms(found_with(nothing), (), gone, None)
        assert term.finding.where == where and term.finding.p_value == 1e-6 and term.share is None
        assert said in statements.statement(term, "the board", "px")


def test_where_a_smooth_function_is_significant_it_is_what_is_unexplained(monkeypatch):
    monkeypatch.setattr("workbench.explanation.unexplained.unrecorded", lambda problem, place: ())
    places = (Located("joint-2", "joint", ("q2",), 0.4, 1e-8),)
    (term,) = unknown_terms(found_with(places), (), (), None)
    assert (term.finding.where, term.share, term.finding.p_value) == ("joint-2", 0.4, 1e-8)


def test_errors_before_and_after_are_of_the_same_samples():
    before, inliers = np.array([1.0, 1.0, 1.0, 50.0]), np.ones(4, bool)
    after = np.array([2.0, 2.0, 2.0, np.nan])
    assert held_out.rms_pair(before, after, inliers) == (1.0, 2.0), "the last is not predicted"
