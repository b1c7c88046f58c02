"""The diagnosis says which effects a recording without their columns cannot show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from import_scenes import SCENE, simulated
from robot_model import load_robot
from robot_model.measurements import samples_of
from robot_model.system import bind
from workbench.explanation.planning.experiment import (
    SIDES_FROM_MOVES,
    _resembles_backlash,
    sides_from_moves,
)


def test_backlash_without_sides_of_approach_is_named(tmp_path):
    samples = samples_of(simulated(tmp_path, SCENE))
    robot = load_robot("ur10")
    assert sides_from_moves(bind(robot, samples)) == SIDES_FROM_MOVES
    sides = {"approach2": np.tile([1.0, -1.0], samples.n // 2)}
    recorded = replace(samples, columns={**samples.columns, **sides})
    assert sides_from_moves(bind(robot, recorded)) == ""


def test_a_chain_without_a_robot_has_no_backlash():
    assert sides_from_moves(None) == ""


def finding(effect, depends_on):
    return SimpleNamespace(effect=effect, depends_on=depends_on)


def test_backlash_is_asked_for_only_where_it_would_explain_what_is_seen():
    assert _resembles_backlash(finding("joint-hysteresis", ()))
    assert _resembles_backlash(finding("unknown", ("move2_side", "q2_deg")))
    assert _resembles_backlash(finding("unknown", ()))
    assert not _resembles_backlash(finding("unknown", ("q2_deg",)))
    assert not _resembles_backlash(finding("unknown", ("time_s",)))
    assert not _resembles_backlash(finding("joint-compliance", ("tau2",)))
