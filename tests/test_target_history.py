"""Targets have no history: loops of hysteresis count with their centre and half their width, unless a side is stated."""

import json
from dataclasses import replace

import numpy as np
import pytest

from export_scenes import arm_with
from scenes import ABB
from test_correction_limits import JOINTS, RANGE, answer_of, solution
from workbench.files.exports.check import check_python
from workbench.files.exports.python import python_module
from workbench.files.exports.python.module import arm_data, observed_effects
from workbench.files.exports.python.runtime import CorrectedArm
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.compensation.compensate import actual_poses, half_loops_mm

HYSTERESIS = {"effect": "joint-hysteresis", "where": "joint-3", "width": 0.003}
SIZES = {"joint-3.joint-hysteresis.wind_up": 1e-4, "joint-3.joint-hysteresis.by_load": 0.0}
TARGET = "0,10,10,0,30,0"


def test_a_loop_counts_with_its_centre_and_half_its_width(workbench, tmp_path):
    solution(tmp_path / "arm", [HYSTERESIS], SIZES)
    plain, without_side, _ = answer_of(workbench, tmp_path, f"{JOINTS}\n{TARGET}\n", status=0)
    said = [one for one in plain["warnings"] if "joint-hysteresis at joint-3" in one]
    assert len(said) == 1 and "approach3" in said[0]
    # joint 3 of the IRB 120 carries the flange some 0.3 to 0.45 m away
    half = float(without_side[0]["sigma_mm"])
    assert 0.03 < half < 0.045 and f"up to {half:.2g} mm" in said[0]
    text = f"{JOINTS},approach3\n{TARGET},1\n{TARGET},-1\n"
    stated, rows, _ = answer_of(workbench, tmp_path, text, status=0)
    assert not any("joint-hysteresis" in one for one in stated["warnings"])
    assert all(float(row["sigma_mm"]) < 0.01 for row in rows)
    readings = [float(row["q3_deg"]) for row in (*rows, *without_side)]
    assert readings[1] - readings[0] == pytest.approx(2 * np.rad2deg(1e-4), rel=0.01)
    assert readings[2] == pytest.approx(np.mean(readings[:2]), abs=1e-6)


def test_a_wide_loop_of_unknown_side_refuses_no_target(workbench, tmp_path):
    """Without a correction the arm has the same loop: the model that knows it is no worse than one that does not."""
    wide = {name: 10 * value for name, value in SIZES.items()}
    folder = solution(tmp_path / "arm", [HYSTERESIS], wide)
    held_out = read_solution(folder).held_out_mm
    answer, rows, _ = answer_of(workbench, tmp_path, f"{JOINTS}\n{TARGET}\n", status=0)
    assert float(rows[0]["sigma_mm"]) > 3 * held_out and not answer["refused"]
    stated = answer_of(workbench, tmp_path, f"{JOINTS}\n{TARGET}\n", "--max-sigma-mm", "0.1")[0]
    assert "standard uncertainty" in stated["refused"][0]["why"]


def test_loops_of_several_joints_add_up_in_squares(tmp_path):
    backlash = {"effect": "backlash", "where": "joint-2"}
    changes = SIZES | {"joint-2.backlash.half_gap": 2e-4}
    ranges = RANGE | {"payload_kg": [0.0, 1.0], "approach2": [-1.0, 1.0]}
    folder = solution(tmp_path / "arm", [HYSTERESIS, backlash], changes, fitted_range=ranges)
    arm = read_solution(folder)
    readings = np.deg2rad([[0.0, 10, 10, 0, 30, 0], [50, -20, 30, 10, 40, 70]])
    sides = np.ones(2)
    both = half_loops_mm(arm, readings)
    alone = [half_loops_mm(arm, readings, {name: sides}) for name in ("approach2", "approach3")]
    np.testing.assert_allclose(both, np.hypot(*alone), rtol=1e-3)
    assert (half_loops_mm(arm, readings, {"approach2": sides, "approach3": sides}) == 0).all()


def test_a_loop_that_was_found_and_not_retained_counts_in_sigma(workbench, tmp_path):
    folder = solution(tmp_path / "arm")
    keys = json.loads((folder / "solution.json").read_text())
    names, size = list(SIZES), len(keys["free"])
    covariance = np.zeros((size + 2, size + 2))
    covariance[:size, :size] = keys["covariance"]
    covariance[size, size] = 1e-4**2
    model = {"effects": [HYSTERESIS], "values": keys["values"] | dict.fromkeys(names, 0.0)}
    model |= {"free": [*keys["free"], *names], "covariance": covariance.tolist()}
    considered = {"models": [model | {"probability": 1.0}], "recorded_rms_mm": 0.0}
    solution(tmp_path / "arm", considered=considered)
    _, rows, _ = answer_of(workbench, tmp_path, f"{JOINTS}\n{TARGET}\n", status=0)
    assert 0.03 < float(rows[0]["sigma_mm"]) < 0.045


def test_the_exported_module_needs_no_history_and_takes_a_side():
    ranges = {f"q{k}_deg": (-40.0, 40.0) for k in range(1, 7)} | {"payload_kg": (0.0, 3.0)}
    rows = [("joint-hysteresis", "joint-3", {"width": 0.01}), ("reading-lag", "time", {})]
    arm = replace(arm_with(ABB, rows, values=SIZES), fitted_range=ranges)
    text = python_module(arm)
    check_python(arm, text)
    assert "unless covariates hold approach3" in text
    plain = CorrectedArm(arm_data(arm), arm.acting_effects, observed_effects(arm))
    readings = np.array([[0.0, 10, 10, 0, 30, 0]])
    for covariates in ({}, {"approach3": 1.0}):
        wanted = actual_poses(arm, np.deg2rad(readings), covariates)
        np.testing.assert_allclose(plain.flange_poses(readings, covariates), wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("where", "is_corrected"), [("base", False), ("tool", False), ("link-2", True)]
)
def test_a_step_beyond_base_or_flange_is_no_error_of_the_arm(tmp_path, where, is_corrected):
    """A moved instrument or a remounted reflector makes the same: 8 mm of it would send every target 8 mm off."""
    step = {"effect": "shift", "where": where, "after": 40.5}
    keys = dict.fromkeys((f"{where}.shift.{name}" for name in ("y", "z", "rx", "ry", "rz")), 0.0)
    keys[f"{where}.shift.x"] = 8.0
    corrections = []
    for folder, effects, values in (("arm", [], {}), ("moved", [step], keys)):
        arm = read_solution(solution(tmp_path / folder, effects, values, rows=100))
        corrections.append(actual_poses(arm, np.deg2rad([[0.0, 10, 10, 0, 30, 0]]), {})[0, :3, 3])
    moved = np.linalg.norm(corrections[1] - corrections[0])
    assert moved == pytest.approx(8.0 if is_corrected else 0.0, abs=1e-6)
