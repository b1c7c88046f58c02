"""What the measurements do not show of the frames of an arm keeps its nominal value, whatever effects are missing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from plain_frames import frames_of
from robot_model import load_robot
from workbench.core.solution import Stage
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate

REFLECTOR = np.array([62.0, -35.0, -48.0])
TILT = ("gravity-pedestal-compliance", "base", {})


def scara(errors=None):
    """Keys of an arm with four parallel axes; errors: (4, 4) of theta, a, alpha and beta in deg and mm."""
    errors = np.zeros((4, 4)) if errors is None else errors
    nominal = [(410.0, 280.0, 0.0), (0.0, 245.0, 180.0), (0.0, 0.0, 0.0), (45.0, 0.0, 0.0)]
    rows = []
    for (d, a, alpha), (theta_error, a_error, alpha_error, beta) in zip(nominal, errors.tolist()):
        row = {"theta_deg": theta_error, "d_mm": d, "a_mm": a + a_error}
        rows.append(row | {"alpha_deg": alpha + alpha_error, "beta_deg": beta})
    rows[2]["kind"] = "prismatic"
    return {"name": "scara", "convention": "distal", "joint": rows}


def recorded(seed: int, sag_rad: float, sigma: float = 0.015, n: int = 90) -> tuple:
    """A recording of a SCARA with errors, whose first link tilts with the reach of the second, and its errors."""
    rng = np.random.default_rng(seed)
    errors = rng.normal(0, 1, (4, 4)) * [0.1, 0.3, 0.03, 0.03]
    errors[2, [0, 1, 3]] = errors[3] = 0.0  # confounded with the tool
    arm = load_robot(scara(errors))
    readings = rng.uniform([-2, -2.2, 5, -3], [2, 2.2, 160, 3], (n, 4))
    frames = frames_of(arm, readings)
    points = frames[-1][:, :3, :3] @ REFLECTOR + frames[-1][:, :3, 3]
    # the tilt about the horizontal axis across link 1, by the moment of link 2 about its end
    across = np.stack([-np.sin(readings[:, 0]), np.cos(readings[:, 0]), 0 * readings[:, 0]], 1)
    tilts = Rotation.from_rotvec(across * (sag_rad * np.cos(readings[:, 1]))[:, None])
    points = tilts.apply(points)
    pose = Rotation.from_rotvec(rng.normal(0, 1, 3))
    seen = pose.apply(points) + rng.normal(0, 1500, 3) + rng.normal(0, sigma, (n, 3))
    columns = {"q1_deg": np.rad2deg(readings[:, 0]), "q2_deg": np.rad2deg(readings[:, 1])}
    columns |= {"q3_mm": readings[:, 2], "q4_deg": np.rad2deg(readings[:, 3])}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), seen.T))
    return Recording("external-point", columns, scara(), sigma_mm=sigma, name="scara"), errors


@pytest.mark.parametrize("seed", range(3))
def test_a_height_that_only_tilts_of_the_axes_show_is_held_and_named(seed):
    """The reflector stays near the flange, and theta2 is wrong by no more than its standard deviations say."""
    recording, errors = recorded(seed, 2e-4)
    calibration = calibrate(recording, (geometry(load_robot(scara())),), folds=3)
    assert abs(calibration.solution.parameters["tool.reflector1_z"]) < 100
    assert any("do not determine reflector 1 z on the flange" in w for w in calibration.warnings)
    rows = {f"{row['where']}.{row['name']}": row for row in calibration.parameters}
    assert rows["tool.reflector1_z"]["status"] == "not identifiable"
    theta = rows["joint-2.theta2"]
    assert theta["std"] < np.deg2rad(0.1)
    assert abs(theta["deviation"] - np.deg2rad(errors[1, 0])) < 3 * theta["std"]


@pytest.mark.parametrize("seed", range(3))
def test_a_tilt_of_the_base_does_not_turn_the_root_frame(seed):
    """The tracker sees no rotation of the root about the vertical: only the direction of a small tilt depends on it."""
    recording, _ = recorded(seed, 2e-4)
    stages = (
        geometry(load_robot(scara())),
        Stage("base", "the base tilts", (TILT,), earn=False),
    )
    solution = calibrate(recording, stages, folds=3).solution
    assert not solution.parameters.mask[solution.parameters.index["joint-1.theta1"]]
    assert solution.parameters["joint-1.theta1"] == 0.0
    assert "joint-1.theta1" in solution.single.tied()


def test_an_arm_with_axes_in_all_directions_keeps_its_tool(tmp_path):
    """Six joints determine the reflector: nothing is held."""
    from scenes import ABB, scene

    made = scene("external-point", 80, 4, reflectors={1: (30.0, -40.0, 100.0)})
    rng = np.random.default_rng(1)
    columns = {
        k: v + rng.normal(0, 0.02, 80)
        for k, v in made.recording.columns.items()
        if k in ("x_mm", "y_mm", "z_mm")
    }
    recording = replace(made.recording, columns=made.recording.columns | columns)
    calibration = calibrate(recording, (geometry(load_robot(ABB)),), folds=3)
    assert calibration.solution.parameters.mask[
        [calibration.solution.parameters.index[f"tool.reflector1_{c}"] for c in "xyz"]
    ].all()
    assert not any("do not determine reflector" in w for w in calibration.warnings)
