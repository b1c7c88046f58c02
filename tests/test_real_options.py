"""Options that are real numbers: what lies between two values of the grid is one finding, its value right within 3 sigma."""

from types import SimpleNamespace

import numpy as np
import pytest

import test_diagnosis_sensor_recorded as sensor_cases
from conftest import mostly_slow
from robot_model.effects import CATALOGUE
from robot_model.effects.nonparametric import PeriodicMotion
from sensors.effects import CATALOGUE as SENSOR_EFFECTS
from sensors.effects.covariates import time_constants
from simulated_images import simulated
from test_diagnosis_engine import SIGMA, recorded
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.search import options
from workbench.diagnosis.search.select import find
from workbench.explanation.sentences.statements import label_of

SPAN = 20.0 * 219  # s, of `recorded`
CONSTANTS = SPAN * np.geomspace(0.03, 1.0, 10)
SIZE = 100 * SIGMA  # mm, RMS of an effect at the measured point
LEVER = 500.0  # mm, about the distance of the point from a joint


def order(value):
    """A harmonic at joint 2."""
    amplitude = SIZE / LEVER
    return CATALOGUE["transmission-harmonic"]("joint-2", value), [amplitude, -amplitude]


def warm_up(value):
    """Joint 2 warming up."""
    variants = CATALOGUE["warm-up"].candidates(bench_of(recorded(1)).chain)
    kind = next(type(v.effect) for v in variants if v.effect.where == "joint-2")
    return kind("joint-2", value), [4 * SIZE / LEVER]


def hysteresis(value):
    """Friction of joint 2 that winds up within an angle."""
    return CATALOGUE["joint-hysteresis"]("joint-2", value), [4 * SIZE / LEVER, 0.0]


def dahl(value):
    """The same by Dahl's law."""
    return CATALOGUE["joint-hysteresis"]("joint-2", value, "dahl"), [4 * SIZE / LEVER, 0.0]


def soft_backlash(value):
    """Backlash of joint 3 that gravity closes over a range of torques."""
    return CATALOGUE["backlash"]("joint-3", "gravity", value), [4 * SIZE / LEVER]


def floor(value):
    """The base moving to and fro along x and y."""
    effect = PeriodicMotion("base", value, ["mm"] * 3 + ["rad"] * 3, [0.05] * 3 + [3e-4] * 3)
    return effect, [SIZE, 0.0, 0.0, SIZE, *np.zeros(8)]


@pytest.mark.parametrize(
    ("make", "value"),
    [
        (order, 17.25),
        (order, 88.5),
        (warm_up, float(np.mean(CONSTANTS[3:5]))),
        (hysteresis, 0.2),
        pytest.param(hysteresis, 0.6, marks=pytest.mark.slow),
        (dahl, 0.45),
        (soft_backlash, 3.7),
        pytest.param(floor, 2 * np.pi * 12.25 / SPAN, marks=pytest.mark.slow),
    ],
)
def test_an_option_between_two_values_of_the_grid_is_one_finding_of_an_arm(make, value):
    effect, values = make(value)
    found = find(bench_of(recorded(11, [effect], values)))
    assert_one_finding(found, effect, value)


def assert_one_finding(found, effect, value):
    """One finding, whose option is known and right."""
    assert [(one.effect, one.where) for one in found.findings] == [(effect.effect, effect.where)], (
        found.history
    )
    assert found.findings[0].effects[0].options.get("law") == effect.options.get("law")
    option = found.findings[0].option
    assert 0 < option.std < 0.02 * value
    assert abs(option.value - value) < 3 * option.std
    assert option.value == getattr(found.findings[0].effects[0], option.name)


def test_the_uncertainty_of_a_size_contains_that_of_the_option():
    """A wider hysteresis is larger: the size moves with the width, which is known to one standard deviation."""
    truth, values = hysteresis(0.2)
    bench = bench_of(recorded(13, [truth], values))
    (one,) = find(bench).findings
    (effect,), option = one.effects, one.option
    row = bench.parameters([effect], options={effect: option})[0]
    moved = bench.parameters([option.changed(effect, 1.0)])[0]["value"] - row["value"]
    assert abs(moved) > 0.3 * row["conditional_std"]
    assert label_of(one).startswith("wound up within 0.2") and " ± 0.0" in label_of(one)
    assert row["std"] == pytest.approx(np.hypot(row["conditional_std"], moved), rel=0.05)


@pytest.mark.parametrize(
    ("make", "value"),
    [(order, 17.0), (order, 4.0)],
)
def test_an_order_that_is_a_whole_number_stays_one(make, value):
    effect, values = make(value)
    found = find(bench_of(recorded(12, [effect], values)))
    assert [one.effects[0].order for one in found.findings] == [value]


@pytest.mark.parametrize("number", mostly_slow([0, 20], 0, 1))
def test_a_vibration_between_two_frequencies_of_the_grid_is_one_finding(number):
    kind = SENSOR_EFFECTS["mirror-vibration"]
    (grid,) = kind.grids(sensor.SensorBench(sensor_cases.true()).kind)
    value = float(grid.values[number : number + 2].mean())
    key = "mirror.mirror-vibration."
    sizes = {key + "cos": 2e-3, key + "sin": 1e-3}
    effect = kind("mirror", value)
    made = simulated(sensor_cases.true(), (effect,), sizes, 5)
    assert_one_finding(find(sensor.SensorBench(made)), effect, value)


@pytest.mark.slow
def test_a_warm_up_between_two_time_constants_of_the_grid_is_one_finding():
    constants, start = time_constants(sensor.SensorBench(sensor_cases.true()).kind.times)
    value = float(np.mean(constants[8:10]))
    effect = SENSOR_EFFECTS["laser-drift"]("laser", value, start)
    made = simulated(sensor_cases.true(), (effect,), {"laser.laser-drift.amplitude": 5e-3}, 6)
    assert_one_finding(find(sensor.SensorBench(made)), effect, value)


def test_a_warm_up_is_not_over_before_the_second_image():
    """Its shape is then that of one image alone, and without this image it is a constant."""
    times = 10.0 * np.arange(12)
    constants, start = time_constants(times)
    assert start == 0 and np.exp(-times[1] / constants[0]) > 0.04
    assert time_constants(0.5 * np.arange(400))[0][0] == pytest.approx(200 / 60, rel=0.01)


def test_options_that_lead_back_to_one_another_end_the_refinement(monkeypatch):
    """Two rounded values, each of which is the likeliest about the solution with the other."""
    terms = {label: SimpleNamespace(key=("wave", "joint-2"), label=label) for label in ("a", "b")}
    search = SimpleNamespace(accepted=(terms["a"],), solved=0, other_indices=lambda i: ())

    def solve_feasible():
        search.solved += 1

    def refined(likelihood, term):
        return terms["b" if term.label == "a" else "a"]

    search.solve_feasible = solve_feasible
    monkeypatch.setattr(options._Profile, "of", lambda *about: None)
    monkeypatch.setattr(options, "_refined", refined)
    options.refine_options(search)
    assert search.solved == 1
    assert search.accepted == (terms["b"],)
