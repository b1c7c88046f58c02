"""A function of a joint's own angle has a name where a law of this angle makes all of it."""

from types import SimpleNamespace

import pytest

from robot_model.effects import CATALOGUE
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.search.posterior import _law_of_function

FUNCTION = Hypothesis("unknown", "joint-2", "", gain=100.0, smooth_covariates=("q2",))


def curve(where, gain, terms=15):
    effect = CATALOGUE["joint-curve"](where, start=-1.0, end=1.0, terms=terms)
    return Hypothesis("joint-curve", where, f"of {terms} terms", effects=(effect,), gain=gain)


def named(function, *laws):
    search = SimpleNamespace(accepted=(function,), conditional_hypothesis=lambda i, table: function)
    return _law_of_function(search, 0, [function, *laws])


def test_the_curve_that_makes_all_of_it_is_its_name():
    assert named(FUNCTION, curve("joint-2", 99.5)).effect == "joint-curve"


def test_of_several_the_likeliest_is_taken():
    short, long = curve("joint-2", 99.5, 7), curve("joint-2", 99.9, 31)
    likelier = Hypothesis(**{**vars(short), "evidence": 5.0})
    assert named(FUNCTION, long, likelier).label == "of 7 terms"


@pytest.mark.parametrize(
    ("function", "law"),
    [
        (FUNCTION, curve("joint-2", 90.0)),
        (FUNCTION, curve("joint-3", 99.9)),
        (
            Hypothesis("unknown", "joint-2", "", gain=100.0, smooth_covariates=("q2", "q4")),
            curve("joint-2", 99.9),
        ),
        (curve("joint-2", 100.0), curve("joint-2", 99.9, 31)),
    ],
    ids=["makes less", "another joint", "of two angles", "has a name"],
)
def test_otherwise_it_keeps_what_it_is(function, law):
    assert named(function, law) is None
