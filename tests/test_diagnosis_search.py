"""The search for missing terms: its objective against brute force, and sets that a greedy search would miss."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp

import datasets
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import found, recorded
from workbench.diagnosis.linear.evidence import SIZES
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.findings import finding, with_special_cases
from workbench.diagnosis.search.most_probable_set import _is_last, _limit_variants
from workbench.diagnosis.search.objective import ConditionalSolution, LogPosterior
from workbench.diagnosis.search.options import accept_refined
from workbench.diagnosis.search.posterior import Window
from workbench.diagnosis.search.select import find, found_terms
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.search.stepwise import Stepwise

NAMES = "joint-compliance", "link-compliance"


def law(name, *places, **options):
    return [CATALOGUE[name](where, **options) for where in places]


@pytest.fixture(scope="module")
def problem():
    """An arm whose joint 3 deflects and whose joint 1 slips."""
    effects = (*law("joint-compliance", "joint-3"), *law("zero-shift", "joint-1", after=2000.0))
    return bench_of(recorded(31, effects, [4e-6, 3e-4], n=120)).problem()


@pytest.fixture(scope="module")
def objective(problem):
    """Of the forty likeliest terms, functions among them."""
    return LogPosterior.of(problem, ranked_hypotheses(problem)[:40])


@pytest.fixture(scope="module")
def elastic_arm():
    """All candidates of an arm that deflects at several joints, and the numbers of those that deflect."""
    bench = bench_of(datasets.read("elastic-arm"))
    problem = bench.problem(
        law("joint-compliance", "joint-2", "joint-3", "joint-5")
    ).conditional_on(())
    deflects = [
        h for h in ranked_hypotheses(problem) if h.effect.endswith("-compliance") and not h.label
    ]
    return LogPosterior.of(problem, deflects)


def test_a_set_solved_in_two_parts_is_the_set_solved_at_once(objective):
    columns = objective.index(tuple(range(8)))
    at_once = ConditionalSolution(objective.table, columns)
    first = ConditionalSolution(objective.table, columns[:5])
    parts = ConditionalSolution(objective.table, columns[5:], first)
    assert parts.log_determinant == pytest.approx(at_once.log_determinant, rel=1e-9)
    assert parts.gain == pytest.approx(at_once.gain, rel=1e-9)
    np.testing.assert_allclose(parts.scores, at_once.scores, rtol=1e-6, atol=1e-6)
    for _, group in objective.groups:
        blocks, expected = parts.blocks(group), at_once.blocks(group)
        np.testing.assert_allclose(blocks, expected, rtol=1e-6, atol=1e-6)
    value, spread = at_once.coefficients(3, columns[5:])
    np.testing.assert_allclose(parts.coefficients(3, columns[5:])[0], value, rtol=1e-6)
    np.testing.assert_allclose(parts.coefficients(3, columns[5:])[1], spread, rtol=1e-6)


def log_marginal(objective, members) -> float:
    """Log marginal likelihood against nothing from the covariance of y, b and sigma integrated, without signs."""
    held = objective.index(members)
    gram, score = objective.gram[np.ix_(held, held)], objective.score[held]
    anchor = 4.0
    logs = []
    for size in SIZES:
        covariance = np.eye(len(held)) + size**2 * gram
        left = objective.yy - size**2 * score @ np.linalg.solve(covariance, score)
        power = (objective.degrees + anchor) / 2
        density = gammaln(power) - power * np.log((left + anchor) / 2)
        nothing = gammaln(power) - power * np.log((objective.yy + anchor) / 2)
        logs.append(-0.5 * np.linalg.slogdet(covariance)[1] + density - nothing)
    weight = 1 / np.maximum(1.0, SIZES / 3.0)
    return float(logsumexp(logs, b=weight / weight.sum()))


def test_the_objective_is_prior_times_marginal_likelihood_times_the_chance_of_the_signs(objective):
    free = [i for i in range(40) if not objective.priors.positive[i]][:3]
    for members in ((free[0],), (free[0], free[1]), tuple(free)):
        expected = log_marginal(objective, members) + objective.priors.of(members)
        assert objective.value(members) == pytest.approx(expected, rel=1e-6)


def test_a_move_is_weighed_as_the_set_that_it_leads_to(objective):
    """Schur complements conditional on a set against each set solved by itself."""
    base = (0, int(np.flatnonzero(objective.compatible_pairs[0])[0]))
    for held in (base, base[:1], base[1:]):
        free = objective.compatible_pairs[list(held)].all(0)
        weights = objective._with_each(held, free)
        assert np.isneginf(weights[~free]).all()
        for k in np.flatnonzero(free)[:12]:
            if not objective.priors.positive[[*held, k]].any():
                assert weights[k] == pytest.approx(objective.value((*held, int(k))), rel=1e-7)


def test_no_compliance_is_negative():
    """A joint 3 that rises under load is one of an arm on a ceiling: gravity points the other way in its base."""
    bench = bench_of(recorded(31, law("joint-compliance", "joint-3"), [-2e-5], n=120))
    np.testing.assert_allclose(bench.chain.robot.gravity, [0, 0, 1])
    (term,) = find(bench).findings
    (row,) = bench.parameters(term.effects)
    assert (term.effect, term.where) == ("joint-compliance", "joint-3")
    assert row["value"] == pytest.approx(2e-5, abs=3 * row["std"])


def test_several_terms_of_one_joint_are_found_together():
    effects = [
        *law("transmission-harmonic", "joint-3", order=2.0),
        *law("joint-coupling", "joint-3", joint=2),
        *law("joint-compliance", "joint-3"),
        *law("zero-shift", "joint-3", after=2210.0),
    ]
    answer = found(41, effects, [4e-4, -3e-4, 6e-4, 1.5e-5, 5e-4])
    planted = {(effect.effect, "joint-3") for effect in effects}
    assert planted <= {(f.effect, f.where) for f in answer.findings}
    assert {(f.effect, f.where) for f in answer.findings if f.probability > 0.95} <= planted


def test_variants_of_one_covariate_leave_room_for_those_of_another():
    """Joint 2 has backlash by the side of approach and deflects; alone, backlash seated by gravity is likelier.

    Four variants of that kept the right one from the search, and a smooth function of torque and side took its place.
    """
    softly = [one_variant("tau2", f"softly {k}") for k in range(6)]
    by_side = one_variant("approach2", "by the side of approach")
    kept = _limit_variants([*softly, by_side, *softly], 48)
    assert by_side in kept and len(kept) == 5


def one_variant(covariate: str, label: str) -> SimpleNamespace:
    return SimpleNamespace(key=("backlash", "joint-2"), reads={covariate}, label=label)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "for_prediction", "thorough", "ends"),
    [
        (4, True, True, True),
        (6, True, True, False),
        (4, False, True, False),
        (2, False, False, True),
    ],
)
def test_a_fold_ends_where_a_set_changes_less_than_laws_are_wrong(
    gain, for_prediction, thorough, ends
):
    """Twice the gain is at 1000 degrees of freedom 1 % of the sum of squares where it is 10."""
    objective = SimpleNamespace(value=lambda set_: 100.0 + gain * (len(set_) - 1), degrees=1000.0)
    search = SimpleNamespace(for_prediction=for_prediction)
    assert _is_last(search, objective, (0, 1), (0,), thorough) == ends
    assert not _is_last(search, objective, (0,), (), thorough)


def test_a_law_that_another_variant_hides_alone_is_found_with_the_deflection():
    planted = pytest.importorskip("datasets.makers.planted", reason="MuJoCo makes the recording")
    recording = planted.make(5009, 1, 3, False).made.recording()
    names = {(f.effect, f.where) for f in found_terms(bench_of(recording))}
    laws = {("joint-compliance", "joint-2"), ("backlash", "joint-2"), ("zero-shift", "joint-4")}
    assert names == laws


def test_the_likeliest_set_does_not_depend_on_where_the_search_starts(elastic_arm):
    search = Stepwise(elastic_arm)
    keys = [h.key for h in elastic_arm.terms]
    wrong = [("joint-compliance", "joint-2"), ("link-compliance", "link-3")]
    start = tuple(keys.index(key) for key in wrong)
    assert set(search.most_probable_set(start)) == set(search.most_probable_set())


def test_probabilities_over_sets_are_a_distribution(elastic_arm):
    best = Stepwise(elastic_arm).most_probable_set()
    window = Window.near_set(elastic_arm, best, range(len(elastic_arm.terms)))
    assert window.weights.sum() == pytest.approx(1.0)
    assert len(set(window.term_sets)) == len(window.term_sets)
    assert set(window.term_sets[int(np.argmax(window.weights))]) == set(best)


def test_a_joint_is_preferred_to_a_link_that_would_be_as_soft(elastic_arm):
    """The prior of sizes decides between a joint and the link behind it where both fit alike."""
    keys = [h.key for h in elastic_arm.terms]
    joint, link = (
        keys.index(("joint-compliance", "joint-2")),
        keys.index(("link-compliance", "link-2")),
    )
    scale, terms = elastic_arm.priors.scale, elastic_arm.terms
    assert scale[joint] * terms[joint].source.typical[0] == pytest.approx(
        10 * scale[link] * terms[link].source.typical[0], rel=0.5
    )
    assert elastic_arm.priors.log_odds[joint] > elastic_arm.priors.log_odds[link] + 1


def test_masses_that_are_nearly_known_make_a_name_less_certain(elastic_arm):
    """Without the responses to masses the same data speak more strongly for one set over another."""
    bench = bench_of(datasets.read("elastic-arm"))
    problem = bench.problem(
        law("joint-compliance", "joint-2", "joint-3", "joint-5")
    ).conditional_on(())
    known = LogPosterior.of(replace(problem, mass_responses=()), elastic_arm.terms)
    keys = [h.key for h in elastic_arm.terms]
    joint, link = (keys.index((name, "joint-3" if "joint" in name else "link-3")) for name in NAMES)
    best = Stepwise(elastic_arm).most_probable_set((joint,))
    exchanged = tuple(i for i in best if i not in (joint, link)) + (link,)

    def spread(objective):
        return abs(objective.value(best) - objective.value(exchanged))

    assert joint in best
    assert spread(elastic_arm) < spread(known)


def test_a_curve_takes_in_the_harmonic_of_its_joint():
    """One error of a joint is one finding, though the search found a series and a harmonic beyond it."""

    def made(effect, label, gain):
        return Finding(effect.effect, effect.where, label, (effect,), 1e-9, 0.9, 1.0, gain)

    curve = CATALOGUE["joint-curve"]("joint-5", start=-1.0, end=1.0, terms=7)
    near = CATALOGUE["transmission-harmonic"]("joint-5", order=23)
    other = CATALOGUE["transmission-harmonic"]("joint-6", order=9)
    findings = [made(near, "order 23", 5.0), made(curve, "", 7.0), made(other, "order 9", 3.0)]
    kept = with_special_cases(findings)
    assert [(one.effect, one.where) for one in kept] == [
        ("joint-curve", "joint-5"),
        ("transmission-harmonic", "joint-6"),
    ]
    assert kept[0].effects == (curve, near) and kept[0].gain == 12.0


def test_terms_whose_refined_options_agree_are_one_term():
    """Two lines of a grid may be one wave between them; a model cannot hold the same effect twice."""
    wave = law("transmission-harmonic", "joint-3", order=59)
    search = Search(bench_of(recorded(7, wave, [1e-4, 0.0])), None, 1e-3, lambda line: None)
    search.solve()
    table = {h.label: h for h in search.full_table(()) if h.where == "joint-3"}
    term, neighbour = table["order 59"], table["order 60"]
    search.accepted = term, neighbour
    assert accept_refined(search, [term, term])
    assert search.accepted == (term,)
    assert search.stated_noise_problem.effects == term.effects


def test_a_load_has_no_probability_without_a_compliance_that_it_deflects(elastic_arm):
    terms = list(elastic_arm.terms)
    load = CATALOGUE["payload"]("tool", after=2000.0)
    assert load.needs_compliance and not any(h.needs_compliance for h in terms)
    terms[0] = replace(terms[0], effects=(load,), effect=load.effect, where="tool")
    carrier = next(i for i, h in enumerate(terms) if i and h.carries_load)
    rigid = replace(elastic_arm, terms=tuple(terms), is_rigid=True, seen={}, joined={})
    assert rigid.value((0,)) == rigid.value((0, 0)) == -np.inf
    assert np.isfinite(rigid.value((0, carrier))) and np.isfinite(rigid.value((carrier, 0)))
    allowed = np.arange(len(terms)) == 0
    assert rigid.most_probable_extension((), allowed)[0] == -np.inf
    assert np.isfinite(rigid.most_probable_extension((carrier,), allowed)[0])
    elastic = replace(rigid, is_rigid=False, seen={}, joined={})
    assert np.isfinite(elastic.value((0,))), "the baseline may hold the compliance"


def test_a_larger_effect_that_is_missing_is_no_alternative_to_one_that_is_found():
    """A harmonic of joint 2 is accepted alone; that of joint 3, which is missing, explains several times as much."""
    waves = [CATALOGUE["transmission-harmonic"](f"joint-{k}", order=o) for k, o in ((2, 3), (3, 2))]
    bench = bench_of(recorded(31, waves, [1e-4, 1e-4, 1e-3, 0.0], n=120))
    search = Search(bench, None, 0.005, lambda text: None)
    search.solve()
    named = [h for h in search.table(()) if h.key == ("transmission-harmonic", "joint-2")]
    search.accepted = (next(h for h in named if h.label == "order 3"),)
    search.solve()
    wave = finding(search, 0)
    larger = max(search.alternatives(0), key=lambda h: h.gain)
    assert larger.where == "joint-3" and larger.gain > 3 * wave.gain
    assert wave.probability > 0.9


def test_a_random_walk_of_the_base_is_one_finding():
    """Neither a function of time at the instrument nor steps take parts of it."""
    recording, rng = recorded(7, (), [], n=150), np.random.default_rng(2)
    walk, rest = np.zeros((recording.n, 3)), np.exp(-1 / 40)
    for k in range(1, recording.n):
        walk[k] = rest * walk[k - 1] + 0.1 * np.sqrt(1 - rest**2) * rng.standard_normal(3)
    columns = dict(recording.columns) | dict(
        zip(("x_mm", "y_mm", "z_mm"), (recording.points + walk).T)
    )
    terms = found_terms(bench_of(replace(recording, columns=columns)))
    assert [(f.effect, f.where, f.label) for f in terms] == [
        ("base-drift", "base", "as a random walk")
    ]
