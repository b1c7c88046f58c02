"""Uncertainty of corrections from a sensor on the flange: the artefact's own pose is no error of the arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot_model import load_robot
from scenes import BALLS, scene
from workbench.files.solution_file import read_solution
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.compensation.compensate import compensate, model_at, nominal_poses
from workbench.jobs.robot.compensation.point_uncertainty import (
    position_derivative,
    seen_point,
    without_common_motion,
)

POSES = 45
TWO = {1: BALLS[1], 2: BALLS[2]}
NEARLY_IN_LINE = TWO | {3: (60.0, 6.0, -1.0, 15.0)}


def calibrated(balls, folder, turn=(0.0, 0.0, 0.0)):
    """Arm and readings of a recording with noise; turn: rotation vector (rad) of the frame of the artefact."""
    recording = scene("ball-centre", n=POSES, seed=11, balls=balls, angle=0.4).recording
    rotation = Rotation.from_rotvec(turn)
    turned = {k: (*(rotation.apply(v[:3]) + 40 * np.array(turn)), v[3]) for k, v in balls.items()}
    noise = 0.02 * np.random.default_rng(3).standard_normal((3, POSES))
    columns = dict(recording.columns)
    for axis, error in zip("xyz", noise):
        columns[f"{axis}_mm"] = columns[f"{axis}_mm"] + error
    measured = replace(recording, columns=columns, balls=turned)
    save(calibrate(measured, [geometry(load_robot(measured.robot))], folds=3), folder)
    return read_solution(folder), recording.joints


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    cases = {"one": {1: BALLS[1]}, "two": TWO, "line": NEARLY_IN_LINE, "four": BALLS}
    return {name: calibrated(balls, tmp_path_factory.mktemp(name)) for name, balls in cases.items()}


def rms_sigma(arm, readings):
    return float(np.sqrt((compensate(arm, readings).sigma_mm ** 2).mean()))


@pytest.mark.parametrize("name", ["two", "line", "four"])
def test_more_balls_make_the_arm_no_less_certain(arms, name):
    one, several = rms_sigma(*arms["one"]), rms_sigma(*arms[name])
    assert several < 1.3 * one


def test_sigma_does_not_depend_on_the_frame_of_the_artefact(arms, tmp_path):
    turned = calibrated(TWO, tmp_path, turn=(0.7, -1.1, 0.4))
    assert rms_sigma(*turned) == pytest.approx(rms_sigma(*arms["two"]), rel=0.05)


def test_the_rows_of_the_hand_eye_rotation_are_those_of_finite_differences(arms):
    arm, readings = arms["four"]
    model = model_at(arm, readings, nominal_poses(arm.robot, readings), None)
    point = seen_point(arm)
    rows, _, parameters = position_derivative(model, arm, point)
    step = 1e-5
    for k, key in enumerate(("sensor.rx", "sensor.ry", "sensor.rz")):
        ends = []
        for sign in (-1, 1):
            other = replace(arm, values=arm.values | {key: arm.values[key] + sign * step})
            ends.append(model.residual(position_derivative(model, other, point)[2])[:3])
        # the rows of the rotation are the last ones
        assert rows[k - 3] == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-4)
    assert np.linalg.norm(point) > 50  # the ball is not the origin of the sensor


def test_a_rigid_motion_of_the_world_leaves_nothing():
    rng = np.random.default_rng(5)
    places, recorded = rng.normal(0, 300, (3, 7)), rng.normal(0, 300, (3, 20))
    shift, turn = rng.normal(size=(2, 3))

    def moved(p):
        return (shift[:, None] + np.cross(turn, p.T).T)[None]

    left = without_common_motion(places, moved(places), recorded, moved(recorded))
    assert np.abs(left).max() < 1e-9
    other = moved(places) + places[None] / 300  # a growing arm is no rigid motion
    assert np.abs(without_common_motion(places, other, recorded, moved(recorded))).max() > 0.5
