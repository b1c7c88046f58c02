"""Which of several doubtful findings the next experiment is planned for, and with which solution."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from workbench.explanation.planning import experiment
from workbench.explanation.planning.experiment import ConfoundedPair


def rows_with(*samples_needed):
    return [({"samples_needed": needed}, None) for needed in samples_needed]


@pytest.mark.parametrize(
    "needed, planned, asked",
    [
        ([(0.0,), (40.0,), (7.0,)], 1, 2),
        ([(3.0,), (40.0,)], 0, 1),
        ([(0.0,), (0.0, 5.0)], 0, 2),
        ([(), (9.0,), (1.0,)], 1, 2),
        ([(), ()], 0, 2),
    ],
)
def test_the_first_term_that_the_poses_do_not_decide_is_asked_and_no_other_one_after_it(
    monkeypatch, needed, planned, asked
):
    """Rows are in the order of `samples_needed`; 0 or no row: no further experiment decides anything."""
    calls = []

    def answer(bench, terms, term, problem, kinds):
        calls.append(term)
        return (), f"pair {term}", rows_with(*needed[term])

    monkeypatch.setattr(experiment, "_asked", answer)
    terms = list(range(len(needed)))
    found = experiment._first_undecided(None, terms, terms, None, ())
    assert found == (planned, (), f"pair {planned}", rows_with(*needed[planned]))
    assert calls == terms[:asked]


def test_the_model_of_a_pair_has_the_order_in_which_the_bench_solved_it():
    own, other = (CATALOGUE["backlash"](f"joint-{k}") for k in (2, 3))
    alternative = (CATALOGUE["joint-thermal-drift"]("joint-2"),)
    pair = ConfoundedPair((own,), np.array([1e-5]), alternative, "one", "other")
    assert pair.model_effects((other,)) == (other, own)
    solved = ConfoundedPair((own,), np.array([1e-5]), alternative, "one", "other", (own, other))
    assert solved.model_effects((other,)) == (own, other)
