"""Joint readings in a wrong scale: counts per degree or a gear constant wrong by a fraction of a percent or more."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import pose_scene, simulated
from robot_model import load_robot
from robot_model.measurements import samples_of
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.joint_columns.reading_scales import scaled_readings

CAUSE = "reading-scale"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scene = pose_scene("staubli_tx60", 60, 11, "share_of_limits = 0.6")
    made = simulated(tmp_path_factory.mktemp("scales"), scene)
    return samples_of(replace(made, measures="external-point"))


def with_readings(recording, name, change):
    """The recording with another column of readings: change of an angle in rad."""
    angles = np.deg2rad(recording.columns[name])
    columns = {**recording.columns, name: np.rad2deg(change(angles))}
    return replace(recording, columns=columns)


def checked(recording):
    return check_plausibility(load_robot(recording.robot), recording)


@pytest.mark.parametrize(
    ("joint", "factor"), [(1, 1.002), (3, 0.9965), (5, 1.013), (6, 0.99), (2, 1.06)]
)
def test_the_scale_of_a_reading_is_named_with_its_standard_deviation(joint, factor, recording):
    name = f"q{joint}_deg"
    scaled = with_readings(recording, name, lambda q: factor * q)
    found = scaled_readings(load_robot(recording.robot), scaled)[0]
    assert found.column == name
    assert abs(found.factor - factor) < 4 * found.std
    first = checked(scaled)[0]
    assert first.cause == CAUSE and f"column {name} is in a wrong scale" in first.sentence
    assert f"multiply that of joint {joint} by {factor:.3f}"[:-1] in first.sentence


def test_no_scale_is_named_where_the_readings_are_right(recording):
    assert not scaled_readings(load_robot(recording.robot), recording)
    unknown = replace(recording, sigma_mm=None)
    assert all(found.cause != CAUSE for found in checked(unknown))


@pytest.mark.parametrize("phase", [0.0, 0.8, 1.6])
def test_the_deflection_of_a_joint_under_gravity_is_no_scale(phase, recording):
    """Its sinusoid has a slope of up to 2 mrad/rad, which a straight line explains for the most part."""
    deflected = with_readings(recording, "q2_deg", lambda q: q + 2e-3 * np.sin(q + phase))
    assert all(found.cause != CAUSE for found in checked(deflected))


def test_the_error_of_two_joints_is_no_scale_of_one(recording):
    """Of two wrong scales none alone explains the misfit."""
    scaled = with_readings(recording, "q2_deg", lambda q: 1.02 * q)
    scaled = with_readings(scaled, "q4_deg", lambda q: 0.97 * q)
    assert all(found.cause != CAUSE for found in checked(scaled))


def test_a_slide_in_a_wrong_scale_is_named(tmp_path):
    """A linear axis whose readings are 0.3 % too large, as of a wrong pitch of its screw."""
    keys = {
        "name": "gantry arm",
        "convention": "distal",
        "joint": [
            {"kind": "prismatic", "theta_deg": 0, "d_mm": 0, "a_mm": 0, "alpha_deg": 90},
            {"theta_deg": 0, "d_mm": 400, "a_mm": 30, "alpha_deg": -90},
            {"theta_deg": 0, "d_mm": 0, "a_mm": 450, "alpha_deg": 5},
            {"theta_deg": 0, "d_mm": 60, "a_mm": 300, "alpha_deg": 90},
        ],
    }
    robot = load_robot(keys)
    rng = np.random.default_rng(8)
    from robot_model.chain import forward

    readings = np.column_stack([rng.uniform(0, 2500, 60), rng.uniform(-2, 2, (60, 3))])
    frames = forward(robot, robot.mixing @ readings.T)
    tool = sum(length * axis for length, axis in zip((40.0, 90.0, 150.0), frames.end))
    points = (frames.end_origin + tool).T + rng.normal(0, 0.03, (60, 3))
    columns = {"sample": np.arange(1.0, 61.0), "q1_mm": 1.003 * readings[:, 0]}
    columns |= {f"q{k}_deg": np.rad2deg(readings[:, k - 1]) for k in (2, 3, 4)}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    from datasets.recording import Recording

    made = samples_of(Recording("external-point", columns, keys, sigma_mm=0.03))
    found = scaled_readings(robot, made)
    assert [one.column for one in found][:1] == ["q1_mm"]
    assert abs(found[0].factor - 1.003) < 4 * found[0].std
