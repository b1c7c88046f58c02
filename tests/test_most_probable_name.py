"""The name of a finding is the most probable one, and the probabilities of exclusive names add up to at most 1."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects.curve import JointCurve
from robot_model.effects.steps import Shift
from robot_model.effects.transmission import TransmissionHarmonic
from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.findings import with_special_cases
from workbench.diagnosis.search.posterior import exchange_terms
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.validation import stability
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.sentences.statements import statement

CURVE = JointCurve("joint-2", -1.4, 1.4, 3)


def test_a_first_harmonic_gives_way_to_a_more_probable_curve():
    """An error curve is no harmonic; the search may have come to the harmonic first."""
    bench = bench_of(recorded(5, (CURVE,), [6e-4, 5e-4, -6e-4], n=120))
    search = Search(bench, None, 0.005, lambda line: None)
    search.solve()
    wave = next(
        h
        for h in search.table(())
        if h.key == ("transmission-harmonic", "joint-2") and h.label == "order 1"
    )
    search.accepted = (wave,)
    search.solve()
    table = search.alternatives(0)
    exchange_terms(search)
    assert search.accepted[0].log_weight >= 0
    best = max(table, key=lambda h: h.log_weight if not h.smooth_covariates else -np.inf)
    assert search.accepted[0].key == best.key != wave.key


@pytest.mark.parametrize("of_part", [0.94, 0.5])
def test_a_curve_with_its_harmonics_shares_its_probability_with_the_alternatives(of_part):
    unnamed = Alternative("unknown", "joint-2", "one cause", 0.13, 1.0, "")
    curve = Finding("joint-curve", "joint-2", "of 3 terms", (CURVE,), 1e-9, 0.87, 1.0, 9.0)
    part = replace(
        curve,
        effect=TransmissionHarmonic.effect,
        effects=(TransmissionHarmonic("joint-2", 2.0),),
        probability=of_part,
    )
    (merged,) = with_special_cases([replace(curve, alternatives=(unnamed,)), part])
    total = merged.probability + sum(a.probability for a in merged.alternatives)
    assert total <= 1 + 1e-12 and merged.probability == max(0.87, of_part)


def said(term: Term) -> str:
    return statement(term, "the reflector", "mm")


def test_a_sentence_states_the_most_probable_cause_first():
    curve = Alternative("joint-curve", "joint-1", "of 3 terms", 0.91, 1.0, "")
    wave = Finding("transmission-harmonic", "joint-1", "order 1", (), 1e-9, 0.04, 1.0, 9.0)
    text = said(Term(replace(wave, alternatives=(curve,))))
    assert (
        "another cause is more probable: joint-curve at joint 1 (of 3 terms) 0.91; this"
        in text.lower()
    )
    alike = said(
        Term(replace(wave, probability=0.5, alternatives=(replace(curve, probability=0.5),)))
    )
    assert "the name is not certain" in alike


@pytest.mark.parametrize(
    ("gain", "t", "words"),
    [
        (-1.2e-3, 0.8, "does not change the held-out RMS error significantly (t = 0.8)"),
        (1.2e-3, 3.8, "reduces the held-out RMS error by 1.2 µm (t = 3.8)"),
    ],
)
def test_a_gain_and_its_t_have_one_sign_in_a_sentence(gain, t, words):
    wave = Finding("transmission-harmonic", "joint-1", "order 1", (), 1e-9, 1.0, 1.0, 9.0)
    assert words in said(Term(wave, gain=gain, t=t))


def fold(made: np.ndarray, finding: Finding) -> stability._SolvedFold:
    return stability._SolvedFold([finding], None, [made])


def test_a_fold_holds_a_term_by_its_name_or_by_what_is_confounded_with_it():
    """What other terms make together is no reason to say that the term itself is found again."""
    rng = np.random.default_rng(1)
    moved, other = rng.normal(size=(2, 50))
    mine = Finding("backlash", "joint-2", "", (), 1e-9, 1.0, 1.0, 9.0)
    stranger = replace(mine, where="joint-5")
    assert fold(other, mine).holds(mine, moved)
    assert fold(2 * moved, stranger).holds(mine, moved)
    assert not fold(moved + other, stranger).holds(mine, moved)


def test_a_function_without_a_law_gives_way_to_a_law():
    step = [0.3, -0.2, 0.1, 4e-4, -3e-4, 2e-4]
    bench = bench_of(recorded(5, (Shift("base", 1210.0),), step, n=120))
    search = Search(bench, None, 0.005, lambda line: None)
    search.solve()
    smooth = (h for h in search.table(()) if h.smooth_covariates and h.where == "base")
    search.accepted = (next(h for h in smooth if h.smooth_covariates[0].startswith("time")),)
    search.solve()
    exchange_terms(search)
    assert search.accepted[0].key == ("shift", "base")
