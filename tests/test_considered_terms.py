"""Terms that a diagnosis found and refused: none is lost, and each counts where the targets lack what it reads."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from robot_model import load_robot
from robot_model.effects import CATALOGUE
from workbench.core.errors import InputError
from workbench.core.solution import Stage
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.output import corrected_model
from workbench.explanation.output.considered_terms import considered_terms
from workbench.files.solution_file import read_solution, solution_keys
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.compensation.compensate import (
    compensate,
    considered_covariates,
    covariates_read,
)
from workbench.jobs.robot.compensation.correction_limits import Limits, judge_targets
from workbench.jobs.robot.compensation.model_error import remaining_error_mm
from workbench.jobs.robot.simulate import simulate

SCENE = {
    "robot": "abb_irb120",
    "samples": 60,
    "seed": 3,
    "sigma_mm": 0.02,
    "reflectors": [[30.0, -40.0, 100.0]],
    "approach": True,
    "effect": [{"effect": "backlash", "where": "joint-3", "values": {"half_gap": 4e-4}}],
}
GAP, COMPLIANCE = "joint-3.backlash.half_gap", "joint-2.joint-compliance.compliance"


def refused(effect, where, t, **options):
    """A term of a diagnosis with one effect whose held-out gain has the statistic t."""
    made = CATALOGUE[effect](where, **options)
    return Term(Finding(effect, where, "", (made,), 0.01, 0.9, 0.1, 0.1), t_fall=t)


def row_of(effect):
    """The row of a plan of an effect."""
    return effect.effect, effect.where, dict(effect.options)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE))
    return simulate(path)


def calibrated(recording, *effects):
    """The calibration of geometry and effects, and its stages."""
    stages = [geometry(load_robot(recording.robot))]
    rows = tuple(row_of(effect) for effect in effects)
    if rows:
        stages.append(Stage("kept", "kept", rows, loss="linear", earn=False))
    return calibrate(recording, tuple(stages), folds=2), tuple(stages)


def arm_with(terms, calibration, stages, folder):
    """The calibrated arm as its solution.json gives it back, with its considered terms."""
    keys = solution_keys(calibration)
    keys["considered"] = considered_terms(terms, calibration, stages, row_of).as_json()
    (folder / "solution.json").write_text(json.dumps(keys))
    return read_solution(folder)


def test_a_variant_of_a_likelier_term_is_left_out_alone(recording):
    calibration, stages = calibrated(recording)
    compliance = refused("joint-compliance", "joint-2", 8.0)
    likelier = refused("backlash", "joint-3", 3.0, seat="approach")
    variant = refused("backlash", "joint-3", 1.0, seat="gravity")
    found = considered_terms([compliance, variant, likelier], calibration, stages, row_of)
    assert [one.effect for one in found.effects] == ["joint-compliance", "backlash"]
    assert found.effects[1].options["seat"] == "approach"


def test_a_variant_of_a_kept_term_is_left_out_alone(recording):
    calibration, stages = calibrated(recording, CATALOGUE["backlash"]("joint-3"))
    compliance = refused("joint-compliance", "joint-2", 8.0)
    variant = refused("backlash", "joint-3", 8.0, seat="gravity")
    found = considered_terms([variant, compliance], calibration, stages, row_of)
    (model,) = found.models
    assert COMPLIANCE in model.free and len(found.effects) == 1


def test_terms_that_cannot_be_considered_are_named(recording, tmp_path, monkeypatch):
    def fails(*words):
        raise InputError("the recording is too short")

    calibration, _ = calibrated(recording)
    monkeypatch.setattr(corrected_model, "considered_terms", fails)
    monkeypatch.setattr(corrected_model, "calibrate", lambda *words, **more: calibration)
    made = SimpleNamespace(unit="mm", robot_keys=None, outliers=(), given=(), terms=())
    made = SimpleNamespace(
        **vars(made), recording="r", verdict="explained", title="r", baseline="geometry", refused=()
    )
    files = corrected_model.write_model(made, recording, tmp_path)
    assert files.solution and "the recording is too short" in " ".join(files.left_out)


def test_a_missing_column_of_a_considered_term_counts_with_its_worst_value(recording, tmp_path):
    calibration, stages = calibrated(recording)
    term = refused("backlash", "joint-3", 8.0)
    arm = arm_with([term], calibration, stages, tmp_path)
    assert covariates_read(arm) == frozenset() and considered_covariates(arm) == {"approach3"}
    readings = np.deg2rad(np.random.default_rng(8).uniform(-50, 50, (40, 6)))
    alone = compensate(replace(arm, considered=None), readings).sigma_mm
    sides = [compensate(arm, readings, covariates={"approach3": s}).sigma_mm for s in (-1.0, 1.0)]
    unknown = compensate(arm, readings)
    np.testing.assert_allclose(unknown.sigma_mm, np.maximum(*sides), rtol=1e-6)
    assert np.sqrt((unknown.sigma_mm**2).mean()) > 2 * np.sqrt((alone**2).mean())
    programme = SimpleNamespace(
        covariates={}, poses=None, readings=readings, is_joint=np.ones(40, bool)
    )
    said = judge_targets(arm, programme, unknown, Limits()).warnings
    assert any("no column approach3 (-1 to 1)" in one for one in said)
    programme.covariates = {"approach3": np.ones(40)}
    assert not any(
        "approach3" in one for one in judge_targets(arm, programme, unknown, Limits()).warnings
    )


def test_a_considered_term_that_is_there_counts_once(recording, tmp_path):
    """It makes most of the held-out error, and sigma at the recorded poses is what it makes there."""
    calibration, stages = calibrated(recording)
    arm = arm_with([refused("backlash", "joint-3", 8.0)], calibration, stages, tmp_path)
    readings, columns = recording.joints, {"approach3": recording.columns["approach3"]}
    done = compensate(arm, readings, covariates=columns)
    alone = compensate(replace(arm, considered=None), readings, covariates=columns)
    added = np.sqrt((done.sigma_mm**2 - alone.sigma_mm**2).mean())
    assert arm.considered.recorded_rms_mm == pytest.approx(added, rel=0.05)
    assert remaining_error_mm(arm) < 0.7 * remaining_error_mm(replace(arm, considered=None))
    assert np.sqrt((done.uncertainty_mm**2).mean()) < 1.3 * arm.held_out_mm


def test_a_term_that_other_parameters_imitate_adds_little(recording, tmp_path):
    """Under a fixed gravity the weight of the links bends joint 2 by a first harmonic of its angle, or nearly."""
    harmonics = [CATALOGUE["transmission-harmonic"](f"joint-{k}", order=1.0) for k in (2, 3)]
    calibration, stages = calibrated(recording, CATALOGUE["backlash"]("joint-3"), *harmonics)
    arm = arm_with([refused("link-self-weight", "joint-2", 3.0)], calibration, stages, tmp_path)
    columns = {"approach3": recording.columns["approach3"]}
    with_term = compensate(arm, recording.joints, covariates=columns).sigma_mm
    alone = compensate(replace(arm, considered=None), recording.joints, covariates=columns).sigma_mm
    assert np.median(with_term) < 1.1 * np.median(alone)
    (model,) = arm.considered.models
    place = model.free.index("joint-2.link-self-weight.compliance")
    deflection = 100 * np.sqrt(model.covariance[place, place])  # rad, under 100 N m
    assert 500 * deflection > np.median(alone)  # at 500 mm from the joint
