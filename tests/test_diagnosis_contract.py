"""Keys that answer.json promises of every finding: the instant, the spectrum, and in how many folds it is reselected."""

import re

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import JointCurve, dominant_cycles, periodic_share, reading_scale
from test_diagnosis_engine import recorded
from test_load_changes import COMPLIANCES, INSTANT, LOAD_KG, MOMENT
from test_real_arm_effects import without_masses
from workbench.core.effect import option_types
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.findings import finding
from workbench.diagnosis.search.select import find
from workbench.diagnosis.search.state import Search
from workbench.explanation.result import Term, _effect
from workbench.explanation.sentences.words import figures

ONE_OF_SEVERAL = (
    "target-shift"  # its instants are those of its own samples: tests/test_moved_targets.py
)
BEGINS = sorted(
    name
    for name, kind in CATALOGUE.items()
    if "after" in option_types(kind) and name != ONE_OF_SEVERAL
)


def at_an_instant(name: str):
    """The effect of a name at its first place, beginning at the instant."""
    kind = CATALOGUE[name]
    where = "joint-3" if kind.effect == "zero-shift" else "tool"
    return kind(where, after=INSTANT)


def bench_with(name: str):
    """A bench with what begins at the instant, and the keys of what a search accepts of it, the beginning last."""
    effect = at_an_instant(name)
    if effect.effect != "payload":
        sizes = [3 * p.typical for p in effect.parameters(bench_of(recorded(5)).chain)]
        return bench_of(recorded(5, (effect,), sizes)), [(effect.effect, effect.where)]
    load = CATALOGUE["payload"]("tool", after=INSTANT)
    soft = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    recording = recorded(41, [*soft, load], [*COMPLIANCES.values(), LOAD_KG, *MOMENT], n=180)
    law = "joint-compliance"
    if name != "payload":
        recording, law = without_masses(recording), "gravity-compliance"
    return bench_of(recording), [*((law, where) for where in COMPLIANCES), ("payload", "tool")]


def begun(name: str) -> Finding:
    """What begins at the instant, as a finding of a search that has accepted it where it is likeliest."""
    bench, keys = bench_with(name)
    search = Search(bench, None, 0.005, lambda line: None)
    search.solve()
    for key in keys:
        best = next(h for h in search.table(search.accepted_indices) if h.key == key)
        search.accepted = (*search.accepted, best)
        search.solve()
    return finding(search, len(search.accepted) - 1)


@pytest.mark.parametrize("name", BEGINS)
def test_what_begins_at_an_instant_says_when_and_how_well_that_is_known(name):
    made = begun(name)
    instant = _effect(Term(made), "mm")["instant"]
    assert instant["unit"] == "s" and 20.0 / np.sqrt(12) <= instant["std"] < 200.0
    assert abs(instant["value"] - INSTANT) <= 3 * instant["std"]


def test_what_begins_at_no_instant_has_none():
    wave = CATALOGUE["transmission-harmonic"]("joint-2", order=3.0)
    bench = bench_of(recorded(5, (wave,), [3e-4, 0.0]))
    (made,) = find(bench).findings
    answer = _effect(Term(made, reselected_folds=8, searched_folds=9), "mm")
    assert answer["instant"] is None and answer["spectrum"] is None
    assert answer["reselected"] == {"folds": 8, "of": 9}


def curve(made_of) -> tuple[JointCurve, np.ndarray]:
    """A series of 31 terms on 2.4 rad that follows a function of the angle."""
    effect = JointCurve("joint-2", -1.2, 1.2, 31)
    angle = np.linspace(-1.2, 1.2, 2000)
    coefficients = np.linalg.lstsq(effect.cosines(angle).T, made_of(angle), rcond=None)[0]
    return effect, coefficients


@pytest.mark.parametrize(
    "made_of, periodic",
    [
        (lambda q: np.cos(17 * q), True),
        (lambda q: np.cos(17 * q) + 0.4 * np.maximum(q, 0), True),
        (lambda q: np.maximum(q - 0.2, 0), False),
        (lambda q: np.exp(-((q - 0.3) ** 2) / 0.05), False),
    ],
)
def test_a_curve_is_periodic_where_cycles_that_repeat_make_most_of_it(made_of, periodic):
    effect, coefficients = curve(made_of)
    cycles = dominant_cycles(effect, coefficients)
    assert (periodic_share(effect, coefficients, cycles) > 0.5) == periodic


def test_the_spectrum_of_a_joint_curve_is_in_the_answer_and_its_cycles_in_the_sentence_where_it_repeats():
    effect, coefficients = curve(lambda q: 2e-4 * np.cos(17 * q))
    bench = bench_of(recorded(5, (effect,), coefficients))
    rows = bench.parameters((effect,))
    made = Finding(effect.effect, effect.where, "", (effect,), 1e-9, 1.0, 1.0, 1.0)
    spectrum = _effect(Term(made, parameters=rows), "mm")["spectrum"]
    assert spectrum["order_unit"] == "cycles per revolution" and spectrum["periodic_share"] > 0.5
    assert spectrum["cycles"][0]["order"] == pytest.approx(17, abs=0.3)
    assert spectrum["cycles"][0]["amplitude"] == pytest.approx(2e-4, rel=0.1)
    said = re.match(r"RMS (\S+) mrad, cycles per revolution: 17\S* \((\S+) mrad\)", figures(rows))
    assert said and float(said[1]) == pytest.approx(np.sqrt(0.5) * float(said[2]), rel=0.1)


def test_a_straight_curve_is_a_reading_in_a_wrong_scale():
    effect, coefficients = curve(lambda q: 4e-3 * q)
    bench = bench_of(recorded(5, (effect,), coefficients))
    rows = bench.parameters((effect,))
    made = Finding(effect.effect, effect.where, "", (effect,), 1e-9, 1.0, 1.0, 1.0)
    scale = _effect(Term(made, parameters=rows), "mm")["spectrum"]["reading_scale"]
    assert 0 < scale["std"] < 1e-3
    # the series is flat at the ends of its domain, which these readings reach: 3 % of the slope
    assert scale["factor"] == pytest.approx(1 / 1.004, abs=2e-4)
    assert re.search(r"the reading is 0\.99\S+ ± \S+ times the motion of the joint", figures(rows))


@pytest.mark.parametrize(
    "law", [lambda q: 4e-4 * q, lambda q: 4e-3 * np.sin(3 * q), lambda q: 4e-3 * np.abs(q)]
)
def test_other_curves_state_no_scale(law):
    effect, coefficients = curve(law)
    angle = np.linspace(effect.start, effect.end, 200)
    laws, covariance = effect.cosines(angle), np.eye(effect.terms)
    assert reading_scale(laws, coefficients, covariance, angle) is None


def test_of_many_parameters_only_significant_ones_are_listed():
    def row(name, value):
        return {"name": name, "value": value, "std": 1e-5, "unit": "rad", "label": f"moment {name}"}

    vague = [row(name, 1e-5) for name in "abcde"]
    assert figures(vague) == "5 parameters of which only combinations are identifiable"
    said = figures([*vague, row("f", 8e-5)])
    assert said.startswith("moment f ") and said.endswith("and 5 more") and "moment a" not in said
    assert figures(vague[:2]).count("moment") == 2
