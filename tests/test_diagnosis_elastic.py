"""Names of elastic terms: sets of joints, links, bearings and pedestal compared, with masses that are nearly known."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from datasets.makers import elastic_arms
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from test_real_arm_effects import without_masses
from workbench.diagnosis.linear.evidence import Projected
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot import bench
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.robot.library import variants
from workbench.diagnosis.search.most_probable_set import accept_most_probable_set
from workbench.diagnosis.search.posterior import Window, _objective_with, exchange_terms
from workbench.diagnosis.search.prior import SECOND, elastic_prior
from workbench.diagnosis.search.select import find
from workbench.diagnosis.search.state import Search


def law(name, *places, **options):
    return [CATALOGUE[name](where, **options) for where in places]


@pytest.fixture(scope="module")
def elastic_arm():
    return bench_of(datasets.read("elastic-arm"))


def test_the_bundled_arm_has_its_joints_named_and_nothing_that_is_absent(elastic_arm):
    """Joints 2 to 5 deflect and joint 2 slips; a bearing of joint 2 and link 3 with 23 µrad/(N m) do not exist."""
    found = find(elastic_arm)
    sure = {(f.effect, f.where) for f in found.findings if f.probability >= 0.95}
    listed = {(a.effect, a.where) for f in found.findings for a in f.alternatives}
    listed |= {(f.effect, f.where) for f in found.findings}
    joints = {("joint-compliance", f"joint-{k}") for k in range(1, 7)}
    assert sure <= joints | {("zero-shift", "joint-2")}
    assert {("joint-compliance", "joint-3"), ("joint-compliance", "joint-2")} <= listed
    assert {("zero-shift", "joint-2"), ("joint-compliance", "joint-2")} <= sure


@pytest.mark.slow
def test_without_masses_the_same_arm_has_its_slip_and_its_compliances_named(elastic_arm):
    """An accepted term is never less probable than another in its place: names come from the sets that are searched."""
    found = find(bench_of(without_masses(elastic_arm.recording)))
    sure = {(f.effect, f.where) for f in found.findings if f.probability >= 0.95}
    assert {("zero-shift", "joint-2"), ("gravity-compliance", "joint-2")} <= sure
    for one in found.findings:
        assert one.probability >= max((a.probability for a in one.alternatives), default=0) - 0.2


class Odd(CATALOGUE["joint-coupling"]):
    """A law that the library does not have."""

    def basis(self, state):
        return np.sin(2 * state.variables[3] * state.variables[5])[None, None]


def test_an_exchange_of_elastic_terms_keeps_accepted_functions_without_a_law(monkeypatch):
    """Their effects are fitted functions, which a row of a table does not have."""
    exchanged = []

    def another(window, count):
        others = [members for members in window.term_sets if set(members) != set(range(count))]
        if exchanged or not others:
            return None
        exchanged.append(max(others, key=window.objective.value))
        return exchanged[0]

    monkeypatch.setattr(Window, "more_probable_set", another)
    effects = [*law("joint-compliance", "joint-2", "joint-3"), Odd("joint-5", joint=4)]
    found = find(bench_of(recorded(7, effects, [4e-6, 6e-6, 1.5e-3])))
    assert exchanged and any(one.effect == "unknown" for one in found.findings)
    assert all(one.effects for one in found.findings)


def test_a_link_without_a_length_does_not_bend(elastic_arm):
    names = {(o.effect.effect, o.effect.where) for o in variants(CATALOGUE, elastic_arm.chain)}
    assert ("link-compliance", "link-5") not in names and ("link-compliance", "link-4") in names


def is_right(finding, rows, truth) -> bool:
    """Whether a named effect exists and its value is within a factor of two of the true one."""
    values = [
        r["value"] for r in rows if (r["effect"], r["where"]) == (finding.effect, finding.where)
    ]
    true = truth.get((finding.effect, finding.where))
    return true is not None and bool(values) and 0.5 <= max(map(abs, values)) / abs(true) <= 2.0


@pytest.mark.long
def test_names_stated_with_95_percent_are_right_on_arms_of_another_engine():
    """Twenty-four arms from MuJoCo statics: all joints, links and most pedestals deflect, masses are 5 % off."""
    stated, right = 0, 0
    for seed in range(200, 224):
        made = elastic_arms.make(seed)
        bench = bench_of(made.recording())
        findings = find(bench).findings
        rows = bench.parameters([e for f in findings for e in f.effects])
        rows = [row for row in rows if "_mass_" not in row["key"]]
        sure = [f for f in findings if f.probability >= 0.95]
        stated += len(sure)
        right += sum(is_right(f, rows, made.truth) for f in sure)
    assert stated >= 60 and right >= 0.95 * stated


def test_combinations_of_masses_are_those_of_some_of_the_samples(monkeypatch):
    """States with one first moment more take kilobytes a sample; a large recording has none of all its samples."""
    arm = bench_of(datasets.read("elastic-arm"))
    monkeypatch.setattr(bench, "_LARGE", 20)
    assert arm.with_masses
    assert "unit_moments" not in arm.chain.state.__dict__


def test_once_a_part_deflects_further_ones_are_likely_with_and_without_masses(elastic_arm):
    """A second joint costs no more prior odds than any second term does: joints of one arm deflect together."""
    for recording in (elastic_arm.recording, without_masses(elastic_arm.recording)):
        problem = bench_of(recording).problem()
        names = ("joint-compliance", "gravity-compliance")
        joints = [
            h
            for h in ranked_hypotheses(problem)
            if h.effect in names and h.where.startswith("joint")
        ]
        joints = [h for h in joints if not h.label]
        priors = elastic_prior(problem, Projected(problem), joints)
        assert priors.elastic.all() and len(joints) > 2
        np.testing.assert_allclose(priors.conditional((0,)), SECOND, atol=1e-12)
        assert (priors.conditional(()) < SECOND).all()


def test_the_compliance_of_a_robot_is_estimated_next_to_what_else_is_accepted(elastic_arm):
    """Whatever an accepted law makes, its columns are fitted as well: prior sizes stay those of the arm without it."""
    problem = bench_of(elastic_arm.recording).problem()
    joints = [
        h for h in ranked_hypotheses(problem) if h.effect == "joint-compliance" and not h.label
    ]
    drift = next(h for h in ranked_hypotheses(problem) if h.effect == "base-drift").columns(problem)
    disturbed = replace(problem, residual=problem.residual + 30 * drift.sum(1), cache={})
    plain, next_to_it, alone = (
        elastic_prior(one, Projected(one), joints, others).scale
        for one, others in ((problem, drift), (disturbed, drift), (disturbed, None))
    )
    np.testing.assert_allclose(next_to_it, plain, rtol=1e-6)
    assert (alone < plain / 10).all()


def test_a_function_gives_way_to_the_law_that_is_likelier(elastic_arm):
    """Next to all that the arm has otherwise, a function of the torque on joint 2 stands for its compliance."""
    search = Search(bench_of(elastic_arm.recording), None, 1e-3, lambda line: None)
    search.solve()
    accept_most_probable_set(search)
    place = [h.key for h in search.accepted].index(("joint-compliance", "joint-2"))
    others = search.table(search.other_indices(place))
    function = next(h for h in others if h.smooth_covariates == ("tau2",) and h.where == "joint-2")
    effect = search.bench.smooth(function.source, function.value)
    accepted = list(search.accepted)
    accepted[place] = replace(function, effects=(effect,))
    search.accepted = tuple(accepted)
    search.solve()
    exchange_terms(search)
    assert not any(h.smooth_covariates for h in search.accepted)


def test_a_tilting_bearing_of_joint_1_is_not_certainly_the_pedestal():
    """A pedestal with equal compliances about x and y is the bearing of joint 1."""
    effects = law("bearing-compliance", "joint-1")
    found = find(bench_of(recorded(2, effects, [2e-5], n=120)))
    first = max(found.findings, key=lambda finding: finding.gain)
    names = {(a.effect, a.where): a.probability for a in (first, *first.alternatives)}
    assert names["bearing-compliance", "joint-1"] == pytest.approx(max(names.values()))
    assert first.effect == "bearing-compliance" or first.probability <= 0.5


def test_the_load_of_a_bearing_is_its_moment_wherever_its_axis_is(elastic_arm):
    """A twist about the axis of a joint has shifts in mm, too, which are no load."""
    state = elastic_arm.chain.state
    bearings = [c for c in elastic_arm.problem(()).candidates if c.effect == "bearing-compliance"]
    assert len(bearings) > 2
    for bearing in bearings:
        moment = bearing.effects[0].load(state)
        assert bearing.load == pytest.approx(np.sqrt((moment**2).sum(0).mean()), rel=1e-6)


def test_the_columns_of_a_load_are_those_of_the_solution_in_sets_that_lack_a_compliance(
    elastic_arm,
):
    """Without what the accepted compliances make of it, it would be another load in every other set."""
    search = Search(elastic_arm, None, 1e-3, lambda line: None)
    search.solve()
    keys = [("joint-compliance", f"joint-{k}") for k in (2, 3, 5)]
    table = search.full_table(())
    search.accepted = tuple(next(h for h in table if h.key == key) for key in keys)
    search.solve()
    load = next(h for h in search.full_table((0, 1, 2)) if h.effect == "payload-centre")
    search.accepted = (*search.accepted, load)
    search.solve()
    objective = _objective_with(search, [])
    problem = search.problem.conditional_on(())
    y = problem.orthogonalise(problem.residual)
    terms = search.current_terms()
    for members in ((0, 2, 3), (0, 1, 3)):
        columns = np.concatenate([terms[i].columns(problem) for i in members], 1)
        basis = np.linalg.qr(problem.orthogonalise(columns))[0]
        remaining = float(y @ y - ((basis.T @ y) ** 2).sum()) / Projected(problem).design_effect
        assert objective.yy - objective.gain(members) == pytest.approx(remaining, rel=1e-2)
