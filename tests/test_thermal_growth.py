"""Growth with temperature: of a sensor's scale, and of links, whose expansion has a sign and an order of magnitude."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects import drift
from scenes import SLIDING, model_of, observed, scene
from workbench.core.covariates import REFERENCE_C
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.explanation.sentences.plausible_values import implausible_values

SENSOR = ("sensor-thermal-growth", "sensor")
LINK = ("link-thermal-growth", "link-2")


def warmed(
    effect: str,
    where: str,
    per_kelvin: float,
    measures: str = "ball-centre",
    seed: int = 4,
    **options,
):
    """A recording at 18 to 30 degrees Celsius of an arm or a sensor that grows."""
    made = scene(measures, n=100, seed=seed, **options)
    model = model_of(made, (effect, where, {}))
    truth = model.parameters.update({f"{where}.{effect}.per_unit": per_kelvin})
    points = observed(model, truth, np.random.default_rng(seed)).chain.measurement.measured
    columns = made.recording.columns | dict(zip(("x_mm", "y_mm", "z_mm"), points))
    return replace(made.recording, columns=columns)


def evidence(recording) -> dict:
    """(effect, place) -> log posterior weight of the best variant."""
    ranked = ranked_hypotheses(bench_of(recording).problem())
    return {h.key: h.log_weight for h in reversed(ranked)}


def test_a_sensor_whose_scale_depends_on_temperature_is_named():
    (found,) = find(bench_of(warmed(*SENSOR, 2e-5))).findings
    assert (found.effect, found.where) == SENSOR and found.probability > 0.9


def test_a_link_that_expands_like_steel_is_named():
    (found,) = find(bench_of(warmed(*LINK, 2e-5, "external-point"))).findings
    assert (found.effect, found.where) == LINK and found.probability > 0.9


@pytest.mark.parametrize(
    ("per_kelvin", "loss"), [(-3e-5, (10, np.inf)), (6e-4, (2, 3.5)), (3e-5, (-0.8, 0))]
)
def test_no_link_shrinks_and_few_grow_more_than_any_material(per_kelvin, loss, monkeypatch):
    """What the limits of an expansion take from its log evidence; a sign that is right gains log 2."""
    recording = warmed(*LINK, per_kelvin, "external-point")
    limited = evidence(recording)[LINK]
    monkeypatch.setattr(drift, "limit_expansion", lambda *args: None)
    assert loss[0] < evidence(recording)[LINK] - limited < loss[1]


@pytest.mark.parametrize(("value", "is_alarm"), [(-3e-4, True), (6e-4, True), (2e-5, False)])
def test_an_expansion_that_no_material_has_raises_an_alarm(value, is_alarm):
    row = {"name": "per_unit", "label": "link 6's growth", "effect": LINK[0]}
    row |= {"unit": "1/K", "value": value, "std": 2e-5}
    assert bool(implausible_values([row], 0.1)) == is_alarm


def test_the_screw_of_a_slide_expands_over_its_travel():
    """The d of a slide is the zero of its reading; what grows with temperature is what the carriage has travelled."""
    joints = [{**row, "a_mm": 0.0} if row.get("kind") else row for row in SLIDING["joint"]]
    arm = SLIDING | {"joint": joints}
    recording = warmed(*LINK, 2e-5, "external-point", arm=arm)
    bench = bench_of(recording)
    growth = drift.LinkThermalGrowth("link-2")
    travel = bench.chain.state.variables[1]
    degrees = recording.columns["temperature_c"] - REFERENCE_C
    np.testing.assert_allclose(growth.basis(bench.chain.state)[0, 0], travel * degrees)
    weights = evidence(recording)
    assert max(weights, key=weights.get) == LINK
