"""A load that acts all the time is found together with the compliances that it deflects, and none where there is none."""

import pytest

import datasets
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.core.model import STATE_PORTS
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.constant_load import (
    UNSTATED_LOAD,
    _gain,
    _solved_with,
    unstated_load,
)
from workbench.diagnosis.search.findings import finding
from workbench.diagnosis.search.select import find
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.validation.proof import _retained_terms

COMPLIANCES = {"joint-2": 4e-6, "joint-3": 9e-6, "joint-4": 5e-5}
LOAD = (12.0, 900.0, -700.0, 1500.0)  # kg, kg mm in the flange frame


def _named(seed, load):
    effects = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    values = list(COMPLIANCES.values())
    if load:
        effects, values = [*effects, CATALOGUE["payload"]("tool")], [*values, *LOAD]
    bench = bench_of(recorded(seed, effects, values))
    return bench, find(bench).findings


@pytest.mark.slow
def test_a_load_that_acts_all_the_time_is_found_with_the_compliances_that_it_deflects():
    """Without the load in the search, compliances of other parts with masses of their own take its place."""
    bench, findings = _named(5, LOAD)
    assert {(f.effect, f.where) for f in findings} == {
        ("payload", "tool"),
        *(("joint-compliance", where) for where in COMPLIANCES),
    }
    rows = {row["key"]: row for row in bench.parameters([e for f in findings for e in f.effects])}
    mass = rows["tool.payload.mass"]
    assert abs(mass["value"] - LOAD[0]) < 3 * mass["std"] < 3 * LOAD[0]
    assert not [
        name for f in findings for e in f.effects for name in e.options
    ]  # None is no option


@pytest.mark.slow
def test_the_gain_of_a_load_depends_neither_on_repeats_nor_on_the_unit_of_length():
    """The numbers that repeats are worth are the same for both solutions, and so is the unit that their densities have."""
    gains = [_gain_of_load(scale) for scale in (1.0, 5.0)]
    assert min(gains) > 10  # 20,000 to 1
    assert gains[0] == pytest.approx(gains[1], rel=0.2)


def _gain_of_load(scale: float) -> float:
    """Log posterior that a load adds to its compliances in poses measured four times, at some scale of all lengths."""
    effects = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    values = [*(scale * value for value in COMPLIANCES.values()), *LOAD]
    effects = [*effects, CATALOGUE["payload"]("tool")]
    made = recorded(5, effects, values, repeats=4, sigma=0.02 * scale)
    search = Search(bench_of(made), None, UNMODELLED_LEVEL, lambda line: None)
    search.solve()
    table = {h.where: h for h in search.full_table(()) if h.effect == "joint-compliance"}
    laws = [h for where, h in table.items() if where in COMPLIANCES and not h.label]
    search.accepted = tuple(laws)
    search.solve()
    (load,) = [one for one in search.bench.constant_loads if one.effect.effect == "payload"]
    return _gain(search, _solved_with(search, laws, load))


def _finding(effect):
    return Finding(effect.effect, effect.where, "", (effect,), 1e-6, 0.9, 1.0, 30.0)


@pytest.mark.parametrize(("kg", "seed"), [(0.0, 2), (0.0, 3), (60.0, 2)])
def test_the_gain_of_a_load_is_that_over_compliances_under_the_links_alone(kg, seed):
    """Compliances about the solution with a load keep its torque: without it they lose too little, or far too much."""
    load = CATALOGUE["payload"]("tool")
    laws = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    values = [3e-6, 6e-6, 3e-5, *(kg * part for part in (1.0, 20.0, -30.0, 110.0))]
    bench = bench_of(recorded(seed, [*laws, load], values, n=120))
    terms, _ = _retained_terms(bench, [_finding(e) for e in (*laws, load)], None)
    found = {term.finding.where for term in terms}
    assert {"joint-2", "joint-3"} <= found
    assert ("tool" in found) == (kg > 0)


@pytest.mark.slow
def test_no_load_is_found_where_there_is_none():
    _, findings = _named(5, None)
    assert {f.effect for f in findings} == {"joint-compliance"}


def test_constant_loads_are_those_that_act_through_compliances_alone():
    bench = bench_of(recorded(1))
    assert {load.effect.effect for load in bench.constant_loads} == {"payload", "mount-tilt"}
    assert all(load.effect.port in STATE_PORTS for load in bench.constant_loads)


def _with_compliances(bench):
    """A search that has accepted the compliances of joints 2 and 3."""
    search = Search(bench, None, UNMODELLED_LEVEL, lambda line: None)
    search.solve()
    table = {h.where: h for h in search.full_table(()) if h.effect == "joint-compliance"}
    search.accepted = (table["joint-2"], table["joint-3"])
    search.solve()
    return search


def test_a_load_that_is_not_recorded_is_an_alternative_where_the_poses_do_not_distinguish_it():
    """Its torque about a joint is nearly that of the links; next to recorded loads it is not."""
    laws = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    search = _with_compliances(bench_of(recorded(2, laws, list(COMPLIANCES.values()))))
    for i in search.accepted_indices:
        load = unstated_load(search, i)
        assert (load.effect, load.where, load.why) == ("payload", "tool", UNSTATED_LOAD)
        assert load.squared_correlation > 0.9 and load.probability < 0.05
    assert finding(search, 0).alternatives[-1] == unstated_load(search, 0)
    with_loads = _with_compliances(bench_of(datasets.read("elastic-arm")))
    assert not any(unstated_load(with_loads, i) for i in with_loads.accepted_indices)
