"""Mistakes in recordings of arms with seven axes and of a SCARA, whose columns are in degrees and in millimetres."""

from dataclasses import replace

import numpy as np
import pytest

import user_error_changes as changes
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from user_errors_more import robot_twist
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.robot_files.gravity_direction import GravityDirection

NOISE_MM = 0.03
# theta (deg), d, a (mm), alpha (deg), range of the reading (deg; mm of a slide)
SEVEN = (
    (0, 305, 14, -90, 150),
    (0, -38, 0, 90, 95),
    (0, 352, 61, 90, 150),
    (0, 22, -61, -90, 110),
    (0, 337, 0, -90, 150),
    (0, 0, 76, 90, 100),
    (30, 121, 0, 0, 160),
)
SCARA = ((0, 498, 421, 0, 120), (0, 81, 309, 180, 135), (0, 35, 0, 0, 280), (0, 66, 0, 0, 165))
SLIDES = {"seven": (), "scara": (3,)}


def recording(name: str, rows, n: int = 120) -> Recording:
    """Points of random poses; every length and angle of the arm is a little off."""
    joints = []
    for number, (theta, d, a, alpha, _) in enumerate(rows, 1):
        joint = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        joints.append(joint | ({"kind": "prismatic"} if number in SLIDES[name] else {}))
    keys = {"name": name, "convention": "distal", "joint": joints}
    rng = np.random.default_rng(4)
    readings = rng.uniform(-1, 1, (n, len(rows))) * [row[-1] for row in rows]
    slides = np.array([number in SLIDES[name] for number in range(1, len(rows) + 1)])
    robot = load_robot(keys)
    errors = rng.normal(size=robot.geometry.shape) * [6e-4, 0.3, 0.3, 6e-4, 0]
    true = replace(robot, geometry=robot.geometry + errors)
    frames = forward(true, np.where(slides, readings, np.deg2rad(readings)).T)
    points = frames.point(np.array([35.0, -50.0, 140.0])).T + [1200, -300, 500]
    points += rng.normal(0, NOISE_MM, points.shape)
    columns = {"sample": np.arange(1.0, n + 1)}
    units = np.where(slides, "mm", "deg")
    columns |= {f"q{k + 1}_{unit}": readings[:, k] for k, unit in enumerate(units)}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    return Recording("external-point", columns, keys, sigma_mm=NOISE_MM, name=name)


@pytest.fixture(scope="module")
def seven():
    return recording("seven", SEVEN)


@pytest.fixture(scope="module")
def scara():
    return recording("scara", SCARA)


def suspicions(made):
    return check_plausibility(load_robot(made.robot), made)


def test_sound_recordings_raise_no_suspicion(seven, scara):
    assert suspicions(seven) == suspicions(scara) == ()


def test_three_joints_in_gon_are_named(seven):
    (found,) = suspicions(changes.scaled(1 / 0.9, 0, 1, 2)(seven))
    assert found.certain and found.cause == "joint-unit"


def test_a_twist_of_the_opposite_sign_is_named(seven):
    """Six axes with an offset wrist often fit with joints of the opposite sign instead; seven do not."""
    (found,) = suspicions(robot_twist(seven))
    assert found.certain and found.cause == "geometry"
    assert "alpha_deg of joint 2 has the opposite sign" in found.sentence


@pytest.mark.parametrize("step", [0, 1, 2])
def test_a_slide_among_columns_in_another_order_is_named(scara, step):
    (found,) = suspicions(changes.reordered(step)(scara))
    assert found.certain and found.cause == "joint-order"


def test_a_slide_and_a_joint_that_are_swapped_are_named(scara):
    columns = scara.columns
    made = changes.changed(scara, q2_deg=columns["q3_mm"], q3_mm=columns["q2_deg"])
    (found,) = suspicions(made)
    assert found.certain and "columns q2_deg and q3_mm are swapped" in found.sentence


def test_deflections_do_not_explain_a_recording_that_fits_under_no_direction_of_gravity(
    seven, monkeypatch
):
    """Such a direction was named next to a residual of 200 mm."""
    from workbench.fitting.plausibility import check

    found = GravityDirection(np.array([-1.0, 0.0, 0.0]), 200.0, 250.0)
    monkeypatch.setattr(check, "find_gravity", lambda *_: found)
    causes = [one.cause for one in suspicions(changes.shuffled(seven))]
    assert causes and "gravity" not in causes


def test_a_unit_of_all_columns_and_a_mirrored_frame_are_named(seven):
    """Neither correction alone lowers the misfit."""
    (found,) = suspicions(changes.two(changes.points(0.001), changes.one_axis)(seven))
    assert found.certain and found.cause == "length-unit and left-handed"


def test_a_unit_of_all_columns_and_one_of_a_joint_are_named(scara):
    (found,) = suspicions(changes.two(changes.scaled(60, 1), changes.points(0.001))(scara))
    assert found.certain and found.cause == "length-unit and joint-unit"
