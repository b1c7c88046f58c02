"""Joint stiffness as it is shown: one unit, rounding by the uncertainty, and what the centre of the load changes."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects.elastic import FirstMoment
from robot_model.stiffness import stiffness_rows
from scenes import model_of, observed, scene
from test_report import STIFFNESS
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.text.stiffness_text import CENTRE_HEAD, holds_for, stiffness_table
from workbench.fitting.calibration_plans.missing_masses import wrong_mass_warnings
from workbench.fitting.calibration_plans.plans import frames_of

KEYS = ("joint-2.joint-compliance.compliance", "joint-4.joint-compliance.compliance")
ROW = STIFFNESS | {"centre_per_mm": None}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "24,900 ± 1,100 N m/rad"),
        ({"stiffness": 912.34, "stiffness_std": 0.234}, "912.34 ± 0.23 N m/rad"),
        ({"stiffness": 12345678.0, "stiffness_std": 9961.0}, "12,346,000 ± 10,000 N m/rad"),
        ({"stiffness": None, "clear": False}, "40 ± 2 µrad/(N m), not significant"),
        ({"stiffness": None, "clear": False, "std": None}, "not determined"),
        ({"stiffness": None, "unit": "rad", "value": 4e-4, "std": 1e-5}, "0.4 ± 0.01 mrad"),
    ],
)
def test_a_stiffness_is_rounded_by_its_uncertainty_and_has_one_unit(change, words):
    _, head, rows = stiffness_table([ROW | change])
    assert rows == [["joint 2", "recorded loads", words]] and len(head) == 3


def test_the_table_says_what_the_centre_of_the_load_changes():
    loaded = ROW | {"centre_per_mm": 0.012, "load_centre_mm": (1.0, -2.0, 149.6)}
    _, head, rows = stiffness_table([loaded, ROW])
    assert head[-1] == CENTRE_HEAD and [row[-1] for row in rows] == ["12 %", ""]
    assert "at 1, -2, 150 mm" in holds_for([loaded]) and not holds_for([ROW])


def test_the_sensitivity_to_the_centre_of_the_load_is_that_of_another_fit():
    """Loads of 0.5 to 3 kg hang 4 mm farther out than stated: the compliances move as the rows say."""
    made = scene("external-point", n=80, seed=4)
    terms = [("joint-compliance", "joint-2", {}), ("joint-compliance", "joint-4", {})]
    model = model_of(made, *terms)
    values = model.parameters.values.copy()
    values[[model.parameters.index[key] for key in KEYS]] = 2e-5, 4e-4
    truth = replace(model.parameters, values=values)
    seen = observed(model, truth)
    free = truth.only(truth.matching(*frames_of(truth)) | np.isin(truth.keys, KEYS))
    std = dict.fromkeys(KEYS, 1e-7)
    rows = stiffness_rows(seen, free, std)
    worst = []
    for axis in 2.0 * np.eye(3):
        there, back = (_compliances(seen, free, side * axis) for side in (1, -1))
        worst.append((there - back) / 4)
    changes = np.linalg.norm(worst, axis=0) / values[[free.index[key] for key in KEYS]]
    assert [row.centre_per_mm for row in rows] == pytest.approx(changes, rel=0.03)
    assert changes.max() > 0.002


def _compliances(model, free, shift) -> np.ndarray:
    """(2,) of a fit whose load hangs `shift` (3,) mm elsewhere."""
    state = replace(model.chain.state, load_centre=model.chain.state.load_centre + shift)
    fit = solve(Model(replace(model.chain, state=state), model.effects), free)
    return fit.parameters.values[[free.index[key] for key in KEYS]]


def test_the_table_says_that_unmodelled_effects_may_be_in_a_stiffness():
    assert "unmodelled effects" in holds_for([ROW], is_misfit=True)
    assert not holds_for([ROW | {"stiffness": None}], is_misfit=True)


def test_a_load_next_to_stated_masses_is_said_to_be_used():
    made = scene("external-point", n=40, seed=4)
    model = model_of(made, ("joint-compliance", "joint-2", {}))
    values = model.parameters.values.copy()
    values[model.parameters.index[KEYS[0]]] = 2e-5
    parameters = replace(model.parameters, values=values)
    free = parameters.only(np.isin(parameters.keys, KEYS))
    (row,) = stiffness_rows(model, free, {KEYS[0]: 1e-7})
    assert row.known_from == "recorded loads and stated masses"
    assert row.load_centre_mm == tuple(model.chain.state.load_centre)


@pytest.mark.parametrize(("deviation", "count"), [(3.0, 0), (7.0, 1), (-7.0, 1)])
def test_masses_that_the_loads_contradict_are_named(deviation, count):
    made = scene("external-point", n=20)
    terms = ("joint-compliance", "joint-2", {}), ("first-moment", "link-2", {})
    parameters = model_of(made, *terms).parameters
    key = "link-2.first-moment.mx"
    size = FirstMoment.prior_size(made.robot)
    moved = parameters.update({key: deviation * size})
    warnings = wrong_mass_warnings(moved.only(np.isin(moved.keys, [key])), made.robot)
    assert len(warnings) == count
    assert all("differs by 7.0 prior standard deviations" in text for text in warnings)
    massless = replace(made.robot, mass=0 * made.robot.mass)
    assert not wrong_mass_warnings(moved.only(np.isin(moved.keys, [key])), massless)
