"""Sets of terms that a search leaves: negative compliances, and masses estimated where the stated ones explain as much."""

import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.constant_load import prefer_stated_masses
from workbench.diagnosis.search.state import Search

LOAD = (12.0, 900.0, -700.0, 1500.0)  # kg, kg mm in the flange frame


def search_of(compliances, load=None) -> Search:
    """A search in a recording with these compliances and load; nothing is accepted yet."""
    effects = [CATALOGUE["joint-compliance"](where) for where in compliances]
    values = list(compliances.values())
    if load:
        effects, values = [*effects, CATALOGUE["payload"]("tool")], [*values, *load]
    search = Search(bench_of(recorded(5, effects, values)), None, UNMODELLED_LEVEL, lambda _: None)
    search.solve()
    return search


def laws_of(search, *names):
    """The joint compliances with given places and labels."""
    table = search.full_table(())
    rows = {(h.where, h.label): h for h in table if h.effect == "joint-compliance"}
    return tuple(rows[name] for name in names)


@pytest.mark.parametrize(
    "compliances, left",
    [
        ({"joint-2": 3e-5, "joint-3": -8e-6}, {"joint-2"}),
        ({"joint-2": -1e-6, "joint-3": 1e-6}, {"joint-3"}),
        ({"joint-2": 8e-6, "joint-3": 3e-5}, {"joint-2", "joint-3"}),
    ],
)
def test_a_negative_compliance_next_to_a_positive_one_is_no_compliance(compliances, left):
    search = search_of(compliances)
    search.accepted = laws_of(search, *((where, "") for where in compliances))
    search.solve_feasible()
    assert {h.where for h in search.accepted} == left
    assert {name[1] for name in search.infeasible} == set(compliances) - left


def test_masses_are_as_stated_where_a_load_explains_what_they_were_estimated_for():
    compliances = {"joint-2": 4e-6, "joint-3": 9e-6, "joint-5": 5e-5}
    search = search_of(compliances, LOAD)
    search.accepted = laws_of(search, ("joint-2", ""), ("joint-3", ""), ("joint-5", LABEL))
    search.solve()
    table = search.full_table(search.accepted_indices)
    load = next(h for h in table if (h.effect, h.label) == ("payload", "constant"))
    search.accepted = (*search.accepted, load)
    search.solve_feasible()
    prefer_stated_masses(search)
    assert {(h.where, h.label) for h in search.accepted} == {
        *((where, "") for where in compliances),
        ("tool", "constant"),
    }
