"""A new effect is one class and one line of the catalogue: all else follows from it.

The toy effect is registered for this test alone. It is then simulated, fitted by a plan, named by the diagnosis,
planted by the blind benchmark, reported and documented, with no other change anywhere.
"""

import sys

import numpy as np
import pytest
import tomli_w

import datasets
from conftest import ROOT
from robot_model.effects import CATALOGUE
from workbench.core.effect import Effect
from workbench.explanation.answer import diagnose
from workbench.explanation.sentences import words
from workbench.fitting.calibration_plans.plans import read_plan
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.simulate import simulate
from workbench.proving import planting

NAME, WHERE, TRUE = "payload-bump", "joint-3", 4e-4
SCENE = {
    "robot": "abb_irb120",
    "measures": "external-point",
    "samples": 120,
    "seed": 6,
    "payload_kg": [0.0, 3.0],
    "reflectors": [[30.0, -40.0, 100.0], [-60.0, 10.0, 80.0], [15.0, 75.0, 60.0]],
    "base": {"xyz_mm": [1500.0, 100.0, 300.0], "rpy_deg": [2.0, -1.0, 140.0]},
    "effect": [{"effect": NAME, "where": WHERE, "values": {"per_kg": TRUE}}],
}
PLAN = f"""
[[stage]]
name = "geometry"
why = "lengths differ"
free = ["base.*", "tool.*", "joint-*.*"]
earn = false

[[stage]]
name = "bumps"
why = "the joint shifts with the payload"
effects = [{{ effect = "{NAME}", where = "{WHERE}" }}]
"""


class PayloadBump(Effect):
    """Joint K is displaced in proportion to the payload, whatever the pose of the arm."""

    effect = NAME
    port = "joint"
    places = ("joint",)
    needs = ("payload_kg",)
    reads = ("payload",)
    equation = "dq = c m"
    source = "made up for this test"
    plant_weight = 1e9

    def table(self, chain):
        return (self.parameter("per_kg", "rad/kg", 1e-4, "the displacement by the payload"),)

    def basis(self, state):
        return state.covariate("payload_kg")[None, None]

    @classmethod
    def planted(cls, readings, joint, rng):
        """In proportion to the recorded payload."""
        payload = readings.columns["payload_kg"]
        return {}, payload - payload.mean()


@pytest.fixture(scope="module", autouse=True)
def catalogue():
    """The catalogue with its one new line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(CATALOGUE, NAME, PayloadBump)
        yield


@pytest.fixture(scope="module")
def recording(catalogue, tmp_path_factory):
    """What `workbench simulate` makes of a scene with the effect."""
    folder = tmp_path_factory.mktemp("toy")
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE))
    return datasets.read(datasets.write(simulate(folder / "scene.toml"), folder / "recording"))


@pytest.fixture(scope="module")
def diagnosis(recording):
    return diagnose(recording)


def test_it_is_simulated_and_fitted_by_a_plan(recording, tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    assert read_plan(tmp_path / "plan.toml")[1].effects == ((NAME, WHERE, {}),)
    made = calibrate(recording, tmp_path / "plan.toml", folds=3)
    rows = [row for row in made.parameters if row["name"].endswith("per_kg")]
    assert [row["where"] for row in rows] == [WHERE]
    assert rows[0]["value"] == pytest.approx(TRUE, abs=4 * rows[0]["std"])
    assert rows[0]["std"] < TRUE / 10


def test_it_is_named_by_the_diagnosis(diagnosis):
    named = [(term.finding.effect, term.finding.where) for term in diagnosis.terms]
    assert named == [(NAME, WHERE)]
    assert diagnosis.terms[0].finding.probability > 0.9


def test_it_is_reported(diagnosis):
    from workbench.report.diagnosis.page import page

    assert words.law(NAME, WHERE).startswith("Joint 3 is displaced in proportion to the payload")
    assert "is displaced in proportion to the payload" in diagnosis.terms[0].statement
    assert "is displaced in proportion to the payload" in str(page(diagnosis))


def test_it_is_planted_by_the_blind_benchmark(recording):
    changed, truth = planting.plant(recording, np.random.default_rng(3), 5.0)
    assert truth["effect"] == NAME and truth["value"]
    assert not np.allclose(changed.joints, recording.joints)


def test_it_is_documented(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import effects_page

    row = next(line for line in effects_page.page().splitlines() if f"`{NAME}`" in line)
    assert "`dq = c m`" in row and "Where payload_kg varies." in row
    sys.modules.pop("effects_page")
