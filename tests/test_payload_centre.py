"""The centre of a recorded load that the robot file does not state is found without masses, and not where it is right."""

import numpy as np
import pytest

from elastic_arm import POINT, ElasticArm, measured, robot_file
from robot_model.effects.load import PayloadCentre
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find

COMPLIANCE = np.array([0.0, 4e-6, 6e-6, 0.0, 2.5e-5, 0.0])
OFFSET = np.array([60.0, -40.0, 120.0])


def found(offset, loads=(0.0, 40.0)):
    """The bench of an arm whose load is off by `offset` mm from the measured point, and what the search finds."""
    arm = ElasticArm(COMPLIANCE, POINT + offset)
    bench = bench_of(measured(arm, robot_file(), loads))
    return bench, find(bench).findings


def test_the_centre_is_found_next_to_the_compliances_that_the_load_deflects():
    bench, findings = found(OFFSET)
    names = {(f.effect, f.where) for f in findings}
    joints = {("joint-compliance", f"joint-{k}") for k in (2, 3, 5)}
    assert names == {("payload-centre", "tool"), *joints}
    rows = {row["key"]: row for row in bench.parameters([e for f in findings for e in f.effects])}
    for axis, expected in zip("xyz", OFFSET):
        row = rows[f"tool.payload-centre.{axis}"]
        assert abs(row["value"] - expected) < 4 * row["std"] < 40


def test_a_load_at_the_measured_point_needs_no_other_centre():
    _, findings = found(np.zeros(3))
    assert {f.effect for f in findings} == {"joint-compliance"}


@pytest.mark.parametrize(("loads", "is_tested"), [((0.0, 40.0), True), ((40.0,), False)])
def test_it_is_tested_where_the_recorded_load_changes(loads, is_tested):
    bench = bench_of(measured(ElasticArm(COMPLIANCE), robot_file(), loads, n=30))
    assert bool(list(PayloadCentre.candidates(bench.chain))) == is_tested
