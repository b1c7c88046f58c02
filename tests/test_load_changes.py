"""Change of load: it acts through the compliances of the arm and is no name for the compliance itself."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import found, recorded
from test_real_arm_effects import without_masses
from workbench.diagnosis.linear.evidence import Projected, scan_moments
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.validation import proof
from workbench.diagnosis.validation.judging import require_compliances
from workbench.diagnosis.validation.terms import Term

COMPLIANCES = {"joint-2": 8e-6, "joint-3": 1.2e-5, "joint-5": 1.5e-4}  # rad/(N m)
INSTANT, LOAD_KG, MOMENT = 1810.0, 4.0, [160.0, -80.0, 320.0]  # kg mm


def soft():
    return [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]


@cache
def of_changed_load():
    """What the search finds where a load of unknown mass is picked up in the course of the recording."""
    load = CATALOGUE["payload"]("tool", after=INSTANT)
    return found(41, [*soft(), load], [*COMPLIANCES.values(), LOAD_KG, *MOMENT], n=180)


def test_a_change_of_load_is_found_with_its_instant_next_to_the_compliances():
    names = [(f.effect, f.where) for f in of_changed_load().findings]
    assert names[-1] == ("payload", "tool") and names.count(("payload", "tool")) == 1
    assert {("joint-compliance", where) for where in COMPLIANCES} == set(names[:-1])
    (effect,) = of_changed_load().findings[-1].effects
    assert abs(effect.after - INSTANT) <= 60.0  # three samples


def test_the_mass_of_a_change_of_load_is_estimated():
    load = CATALOGUE["payload"]("tool", after=INSTANT)
    effects = [*soft(), load]
    bench = bench_of(recorded(41, effects, [*COMPLIANCES.values(), LOAD_KG, *MOMENT], n=180))
    rows = {row["name"]: row for row in bench.parameters(effects)}
    mass = rows[f"mass_after_{INSTANT:g}"]
    assert abs(mass["value"] - LOAD_KG) <= 4 * mass["std"] and mass["std"] < 0.1 * LOAD_KG


def test_compliances_without_a_load_are_no_change_of_load():
    answer = found(42, soft(), list(COMPLIANCES.values()), n=180)
    assert "payload" not in {f.effect for f in answer.findings}
    assert answer.findings[0].effect == "joint-compliance"


@pytest.mark.parametrize("masses", [True, False], ids=["masses", "no masses"])
def test_a_change_of_load_is_tested_only_next_to_a_compliance(masses):
    recording = recorded(43, n=60) if masses else without_masses(recorded(43, n=60))
    kind = "joint-compliance" if masses else "gravity-compliance"
    bench = bench_of(recording)

    def has_change(problem) -> bool:
        return any(scan.effect == "payload" for scan in problem.scans)

    assert not has_change(bench.problem())
    assert has_change(bench.problem([CATALOGUE[kind]("joint-2")]))


def test_the_evidence_of_a_change_without_masses_is_that_of_what_changes():
    """Near the first sample a load acts all the time: its centred columns are next to nothing."""
    bench = bench_of(without_masses(recorded(44, n=80)))
    problem = bench.problem([CATALOGUE["gravity-compliance"]("joint-2")]).conditional_on()
    scan = next(one for one in problem.scans if one.effect == "payload")
    middle, projected = len(scan.options) // 2, Projected(problem)
    moments = scan_moments(projected, scan)
    for i in (0, middle):
        columns = problem.orthogonalise(scan.columns_at(problem, scan.options[i]))
        scale = 1e-6 * moments.raw[i]
        assert moments.gram[i] == pytest.approx(columns.T @ columns, rel=1e-6, abs=scale)
        assert moments.score[i] == pytest.approx(columns.T @ projected.y, rel=1e-6, abs=1e-5)
    assert np.trace(moments.gram[0]) < 0.3 * np.trace(moments.gram[middle])


def of_effects(*effects):
    return [Finding(e.effect, e.where, "", (e,), 0.0, 1.0, 0.0, 0.0) for e in effects]


def test_a_compliance_is_judged_without_the_load_that_acts_through_it():
    """What a load makes contains the deflection of each joint: next to it a compliance alone gains next to nothing."""
    load = CATALOGUE["payload"]("tool")
    bench = bench_of(recorded(45, [*soft()[:1], load], [1e-5, 12.0, *MOMENT], n=120))
    joint, added = of_effects(soft()[0], load)
    kept, refused = proof._retained_terms(bench, [joint, added], None)
    assert not refused and {term.finding.effect for term in kept} == {joint.effect, added.effect}
    alone, _ = proof._retained_terms(bench, [joint], None)
    t = {term.finding.effect: term.t for term in kept}
    assert t[joint.effect] > 0.8 * alone[0].t > 5.0


def test_a_load_is_refused_where_no_compliance_is_retained():
    bench = bench_of(recorded(46, n=60))
    load, joint = CATALOGUE["payload"]("tool"), CATALOGUE["joint-compliance"]("joint-2")
    terms = [Term(finding) for finding in of_effects(load, joint)]
    assert require_compliances(bench, terms) == (terms, [])
    kept, refused = require_compliances(bench, terms[:1])
    assert kept == [] and not refused[0].kept and "compliance" in refused[0].reason


def test_a_search_goes_on_without_a_load_of_negative_mass():
    """What a term explains counts again for others once its values are known to be impossible."""
    recording = recorded(48, soft(), list(COMPLIANCES.values()), n=120)
    robot = {key: value for key, value in recording.robot.items() if key != "payload"}
    bench = bench_of(replace(recording, robot=robot))
    search = Search(bench, None, 0.01, lambda text: None)
    (variant,) = CATALOGUE["payload"].candidates(bench.chain)
    search.accepted = (variant_of(soft()[0]), variant_of(variant.effect, "constant"))
    row = {"key": "tool.payload.mass", "value": -2.0, "std": 0.5, "unit": "kg"}
    bench.parameters = lambda effects, samples: (row,)
    search.solve_feasible()
    assert [h.effect for h in search.accepted] == ["joint-compliance"]
    table = search.table(search.accepted_indices)
    assert not any(h.effect == "payload" and h.label == "constant" for h in table)
    assert any(h.effect == "payload" for h in table)


def variant_of(effect, label=""):
    """A hypothesis with no more than what the search needs to solve with it."""
    return Hypothesis(effect.effect, effect.where, label, effect.effect, (effect,))


def test_a_change_of_load_with_deflections_of_its_own_needs_no_other_compliance():
    """The weight of light links may deflect an arm by too little to be retained, and a load by ten times as much."""
    bench = bench_of(without_masses(recorded(41, n=60)))
    change = CATALOGUE["load-deflection"]("tool", after=INSTANT)
    curve = CATALOGUE["joint-coupling"]("joint-3", joint=2)
    terms = [
        Term(Finding(effect.effect, effect.where, "", (effect,), 1e-9, 1.0, 0.1, 10.0))
        for effect in (curve, change)
    ]
    retained, refused = require_compliances(bench, terms)
    assert retained == terms and not refused
    mass = CATALOGUE["payload"]("tool", after=INSTANT)
    added = Term(Finding(mass.effect, mass.where, "", (mass,), 1e-9, 1.0, 0.1, 10.0))
    retained, refused = require_compliances(bench, [*terms, added])
    assert retained == terms and [term.finding.effects for term in refused] == [(mass,)]
