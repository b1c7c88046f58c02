"""A load that acts all the time is found together with the compliances that it deflects, and none where there is none."""

import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.core.model import STATE_PORTS
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find

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
def test_no_load_is_found_where_there_is_none():
    _, findings = _named(5, None)
    assert {f.effect for f in findings} == {"joint-compliance"}


def test_constant_loads_are_those_that_act_through_compliances_alone():
    bench = bench_of(recorded(1))
    assert {load.effect.effect for load in bench.constant_loads} == {"payload", "mount-tilt"}
    assert all(load.effect.port in STATE_PORTS for load in bench.constant_loads)
