"""Formats that hold geometry alone get the geometry that is nearest to the complete model."""

from dataclasses import replace

import numpy as np
import pytest

from export_scenes import arm_with, flanges
from robot_model.chain import ALPHA, BETA, A
from scenes import ABB, CRAIG, SLIDING
from workbench.commands.robot.export_arm import ArmOptions, export_arm
from workbench.files.exports.geometry_alone import fit_geometry, held_by_ur_kinematics
from workbench.files.exports.mdh import calibrated_geometry, read_mdh
from workbench.files.exports.python.module import arm_data
from workbench.files.exports.python.runtime import CorrectedArm

RANGES = {f"q{k}_deg": (-40.0, 70.0) for k in range(1, 7)}
HARMONIC = ("transmission-harmonic", "joint-3", {"order": 1.0})


def harmonic_that_cancels(spec=ABB):
    """An arm whose zero offset of joint 3 holds the opposite of a harmonic, as over part of a revolution."""
    arm = arm_with(spec, [HARMONIC])
    amplitude = 3e-3
    values = dict(arm.values)
    values["joint-3.transmission-harmonic.cos1"] = amplitude
    values["joint-3.transmission-harmonic.sin1"] = 0.0
    values["joint-3.theta3"] = values["joint-3.theta3"] - amplitude
    return replace(arm, values=values, fitted_range=RANGES)


def test_the_fitted_geometry_is_nearer_to_the_complete_model():
    arm = harmonic_that_cancels()
    fit = fit_geometry(arm)
    assert fit.before_mm > 0.3
    assert fit.rms_mm < 0.5 * fit.before_mm
    assert fit.rms_mm <= fit.largest_mm
    before, after = (distance_on_fresh_poses(arm, one) for one in (arm, fit.arm))
    assert before == pytest.approx(fit.before_mm, rel=0.2)
    assert after == pytest.approx(fit.rms_mm, rel=0.2)


def distance_on_fresh_poses(arm, other):
    """RMS distance (mm) of the flange of `other` without effects from that of `arm` with them, within the ranges."""
    degrees = np.random.default_rng(5).uniform(-40, 70, (200, 6))
    complete = CorrectedArm(arm_data(arm), arm.effects, arm.effects).flange_poses(degrees)
    alone = flanges(arm.robot, np.deg2rad(degrees), calibrated_geometry(other))
    shift = (alone - complete)[:, :3, 3]
    return np.sqrt((shift**2).sum(1).mean())


def test_an_arm_without_effects_keeps_its_geometry():
    assert fit_geometry(arm_with(ABB, [])) is None


@pytest.mark.parametrize("spec", [ABB, CRAIG, SLIDING])
def test_a_constant_error_of_a_reading_becomes_geometry(spec):
    """A zero offset is geometry in other words, so that nothing is left."""
    arm = arm_with(spec, [("zero-offset", "joint-2", {})], values={})
    fit = fit_geometry(arm)
    assert fit.rms_mm < 0.02 * fit.before_mm + 1e-3


def test_what_the_format_cannot_hold_is_not_fitted():
    arm = harmonic_that_cancels()
    fit = fit_geometry(arm, held_by_ur_kinematics(arm))
    changed = calibrated_geometry(fit.arm) - calibrated_geometry(arm)
    assert not changed[-1, [A, ALPHA, BETA]].any()
    assert changed[:-1].any()


def test_the_export_says_how_far_it_is_from_the_complete_model(tmp_path, monkeypatch):
    from workbench.jobs.robot.compensation import correction_limits

    arm = harmonic_that_cancels()
    monkeypatch.setattr("workbench.files.solution_file.read_solution", lambda path: arm)
    monkeypatch.setattr(correction_limits, "checked", lambda arm, path, force: arm)
    file = tmp_path / "arm.csv"
    made = export_arm(tmp_path, "mdh-csv", file, ArmOptions())
    assert "geometry alone" in made.notes[-1]
    fitted = calibrated_geometry(fit_geometry(arm).arm)
    assert np.allclose(read_mdh(str(made.texts[file]), arm.robot), fitted)
