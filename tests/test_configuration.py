"""The configuration of an arm: its three signs distinguish all solutions of the inverse kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import datasets
from conftest import mostly_slow
from robot_model import load_robot
from robot_model.postures.configuration import (
    configuration_name,
    configuration_signs,
    has_configurations,
)
from scenes import SLIDING, scene
from test_correction_limits import ABB, answer_of, solution
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_vector
from workbench.files.targets import Programme
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.jobs.robot.compensation.configurations import configuration_changes, with_start

ARM = load_robot(ABB, "test")


def solutions(robot, wanted, tries=150):
    """(k, R) all different readings, up to full turns, that bring the nominal flange to `wanted` (4, 4)."""
    random, found = np.random.default_rng(0), []

    def gap(readings):
        pose = nominal_poses(robot, readings[None])[0]
        turn = rotation_vector((wanted[:3, :3].T @ pose[:3, :3])[None])[0]
        return np.concatenate([(pose[:3, 3] - wanted[:3, 3]) / 200, turn])

    for _ in range(tries):
        made = least_squares(gap, random.uniform(-np.pi, np.pi, 6), method="lm", max_nfev=400)
        if np.abs(made.fun).max() > 1e-8:
            continue
        if all(np.abs(np.sin((made.x - one) / 2)).max() > 1e-4 for one in found):
            found.append(made.x)
    return np.array(found)


@pytest.mark.parametrize("name", mostly_slow(["ur10", "abb_irb120", "kuka_kr6_r900"], 0, 2))
def test_solutions_of_one_pose_have_different_signs(name):
    robot = load_robot({"builtin": name}, "test")
    assert has_configurations(robot)
    wanted = nominal_poses(robot, np.array([[0.3, -0.9, 1.1, 0.5, 0.8, -0.4]]))[0]
    found = solutions(robot, wanted)
    signs = configuration_signs(robot, found)
    assert len(found) == 8 and len(np.unique(signs, axis=0)) == 8


def test_a_wrist_that_is_bent_to_the_other_side_has_another_sign():
    readings = np.deg2rad([[10, 10, 10, 0, 30, 0], [10, 10, 10, 180, -30, 180]])
    poses = nominal_poses(ARM, readings)
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)
    first, second = configuration_signs(ARM, readings)
    assert first[2] == -second[2] != 0 and (first[:2] == second[:2]).all()
    assert configuration_name(first).startswith("shoulder ")


def test_arms_of_another_build_have_no_names():
    rows = [{"theta_deg": 0.0, "d_mm": 100.0, "a_mm": 200.0, "alpha_deg": 0.0}] * 4
    scara = load_robot({"name": "four", "convention": "distal", "joint": rows}, "test")
    assert not has_configurations(scara)
    assert configuration_changes(scara, np.zeros((3, 4))) == []
    assert (
        "180 deg between targets 1 and 2 (joint 1, 200 deg)"
        in (configuration_changes(scara, np.deg2rad([[100.0, 0, 0, 0], [-100, 0, 0, 0]]))[0])
    )


def test_changes_between_targets_are_named():
    readings = np.deg2rad(
        [[10, 10, 10, 0, 30, 0], [12, 10, 10, 0, 30, 0], [10, 10, 10, 170, -30, -170]]
    )
    (sentence,) = configuration_changes(ARM, readings)
    assert "changes between targets 2 and 3 (shoulder" in sentence and "--start" in sentence
    assert configuration_changes(ARM, readings[:2]) == []
    readings[1] = np.nan
    assert "between targets 1 and 3" in configuration_changes(ARM, readings)[0]


def pose_table(readings):
    """Text of a table of the nominal poses at readings (n, 6) in deg."""
    poses = nominal_poses(ARM, np.deg2rad(readings))
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    rows = np.column_stack([poses[:, :3, 3], turns])
    lines = [",".join(f"{value:.9f}" for value in row) for row in rows]
    return "x_mm,y_mm,z_mm,qw,qx,qy,qz\n" + "\n".join(lines) + "\n"


def test_a_stated_start_chooses_the_configuration(workbench, tmp_path):
    solution(tmp_path / "arm")
    readings = np.array([[0.0, 10, 10, 40, 40, -45], [5.0, 12, 8, 40, 42, -45]])
    text = pose_table(readings)
    chosen = {}
    for start in ("0,10,10,40,40,-45", "0,10,10,-140,-40,135"):
        answer, rows, done = answer_of(workbench, tmp_path, text, "--start", start, status=0)
        (one,) = answer["configurations"]
        assert one["rows"] == [1, 2] and one["configuration"] in done.stdout
        chosen[start] = one["configuration"]
        assert abs(float(rows[0]["q5_deg"]) - float(start.split(",")[4])) < 2
    assert len(set(chosen.values())) == 2


def test_the_start_of_a_recording_is_its_nearest_pose(tmp_path):
    made = scene("external-point", n=40, arm=ABB).recording
    folder = datasets.write(made, tmp_path / "made")
    low, high = ARM.limits.T
    is_within = ((made.joints > low) & (made.joints < high)).all(1)
    within, beyond = np.flatnonzero(is_within)[[7, 3]], np.flatnonzero(~is_within)[:1]
    poses = nominal_poses(ARM, made.joints[np.r_[within, beyond]])
    programme = Programme(None, np.zeros((3, 6)), poses, {}, True)
    found = with_start(programme, ARM, str(folder)).readings
    np.testing.assert_allclose(found[:2], made.joints[within], atol=1e-9)
    assert ((found[2] > low) & (found[2] < high)).all()


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("1,2", "expected 6 joint readings"),
        ("0,0,0,0,0,999", "found 999 for joint 6"),
        ("nan,0,0,0,0,0", "expected finite joint readings .*found nan in place 1"),
        ("0,0,0,0,0,inf", "found inf in place 6"),
    ],
)
def test_wrong_starts_are_a_sentence(start, message):
    programme = Programme(None, np.zeros((1, 6)), np.eye(4)[None], {}, True)
    with pytest.raises(InputError, match=message):
        with_start(programme, ARM, start)


def test_a_start_with_targets_that_are_readings_is_refused():
    with pytest.raises(InputError, match="found joint readings, which state the configuration"):
        with_start(Programme(None, np.zeros((1, 6)), None, {}), ARM, "0,0,0,0,0,0")


def test_targets_without_readings_have_no_sign():
    signs = configuration_signs(ARM, np.full((2, 6), np.nan))
    assert signs.shape == (2, 3) and (signs == 0).all()


@pytest.mark.parametrize("arm", [SLIDING, {"builtin": "ur10"}])
def test_the_start_of_a_recording_of_another_robot_is_refused(tmp_path, arm):
    folder = datasets.write(scene("external-point", n=20, arm=arm).recording, tmp_path / "other")
    programme = Programme(None, np.zeros((1, 6)), np.eye(4)[None], {}, True)
    with pytest.raises(InputError, match="expected a recording of the robot .*found one of"):
        with_start(programme, ARM, str(folder))


def test_the_start_of_a_recording_beyond_the_limits_is_refused(tmp_path):
    made = scene("external-point", n=20, arm=ABB).recording
    folder = datasets.write(made, tmp_path / "made")
    programme = Programme(None, np.zeros((1, 6)), np.eye(4)[None], {}, True)
    narrow = replace(ARM, limits=np.tile([4.0, 5.0], (6, 1)))
    with pytest.raises(InputError, match="samples within the limits of the joints, found none"):
        with_start(programme, narrow, str(folder))


def test_a_straight_wrist_has_no_side():
    """Corrections of 0.001 deg about a straight wrist change no configuration; a bend of 20 deg does."""
    bends = [0, 1e-3, -1e-3, 0.3]
    readings = np.deg2rad([[10 * k, 5, 5, 0, bend, 0] for k, bend in enumerate(bends)])
    assert (configuration_signs(ARM, readings)[:, 2] == 0).all()
    assert configuration_changes(ARM, readings) == []
    readings[0, 4], readings[3, 4] = np.deg2rad([20, 20])
    assert configuration_changes(ARM, readings) == []
    readings[3, 4] = np.deg2rad(-20)
    (sentence,) = configuration_changes(ARM, readings)
    assert "between targets 3 and 4 (" in sentence and "wrist +, then" in sentence


def test_few_postures_are_singular():
    readings = np.random.default_rng(4).uniform(-1.5, 1.5, (50, 6))
    for name in ("abb_irb120", "ur10", "kuka_kr6_r900"):
        signs = configuration_signs(load_robot({"builtin": name}, "test"), readings)
        assert (signs != 0).mean() > 0.95
