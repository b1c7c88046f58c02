"""Random errors of one joint's readings or of one coordinate are named; smooth errors of the same size are not."""

from dataclasses import replace

import numpy as np
import pytest

from erring_scenes import erring
from robot_model import load_robot
from scenes import ABB
from workbench.fitting.plausibility.check import check_plausibility
from workbench.fitting.plausibility.fitting import fit_recording
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.joint_columns.random_errors import random_errors


def with_column(recording, name, change):
    return replace(recording, columns={**recording.columns, name: change})


def found_in(robot, recording):
    return random_errors(robot, recording, fit_recording(robot, recording))


@pytest.mark.parametrize("number", [1, 3])
def test_random_errors_of_one_joint_are_named(number):
    robot, recording = erring("external-point", 3)
    name = f"q{number}_deg"
    noise = np.random.default_rng(number).normal(0, 0.1, recording.n)
    found = found_in(robot, with_column(recording, name, recording.columns[name] + noise))
    assert found.cause == "reading-noise" and not found.certain
    assert f"column {name}" in found.sentence


def test_smooth_errors_of_a_joint_are_none():
    robot, recording = erring("external-point", 3)
    angle = recording.columns["q2_deg"]
    smooth = 0.15 * np.sin(np.deg2rad(angle)) + 0.08 * np.cos(np.deg2rad(2 * angle))
    assert found_in(robot, with_column(recording, "q2_deg", angle + smooth)) is None


def test_random_errors_of_one_coordinate_are_named():
    robot, recording = erring("external-point", 3)
    noise = np.random.default_rng(1).normal(0, 4.0, recording.n)
    found = found_in(robot, with_column(recording, "z_mm", recording.columns["z_mm"] + noise))
    assert found.cause == "coordinate-noise" and "column z_mm" in found.sentence


@pytest.mark.parametrize("measures", ["external-point", "external-pose"])
def test_a_sound_recording_has_none(measures):
    assert found_in(*erring(measures, 4)) is None


def rail():
    """The keys of an arm on a slide."""
    rows = [
        {"theta_deg": float(np.rad2deg(t)), "d_mm": float(d), "a_mm": float(a)}
        | {"alpha_deg": float(np.rad2deg(alpha))}
        for t, d, a, alpha, _ in load_robot(ABB).geometry
    ]
    slide = {"theta_deg": 0.0, "d_mm": 0.0, "a_mm": 0.0, "alpha_deg": -90.0, "kind": "prismatic"}
    return {"name": "arm on a rail", "convention": "distal", "joint": [slide, *rows]}


def measured_on_a_rail(error):
    """Robot and recording with readings that miss `error` (mm) of the place (mm) on the rail."""
    robot, recording = erring("external-point", 0, n=120, arm=rail())
    place = recording.columns["q1_mm"]
    return robot, with_column(recording, "q1_mm", place + error(place))


@pytest.mark.parametrize(
    "error", [lambda q: 1.5 * ((q - 100) / 90) ** 2, lambda q: 0.8 * np.sin(2 * np.pi * q / 130)]
)
def test_smooth_errors_of_a_slide_are_none(error):
    assert found_in(*measured_on_a_rail(error)) is None


def test_random_errors_of_a_slide_are_named():
    rng = np.random.default_rng(0)
    found = found_in(*measured_on_a_rail(lambda q: rng.normal(0, 0.6, len(q))))
    assert found.cause == "reading-noise" and "column q1_mm" in found.sentence
    assert "mm (standard deviation)" in found.sentence


@pytest.mark.parametrize("is_recorded", [True, False])
def test_a_gap_that_follows_the_side_of_approach_is_no_random_error(is_recorded):
    robot, recording = erring("external-point", 3, n=300, reflectors={1: (60.0, 40.0, 90.0)})
    angle = recording.columns["q2_deg"]
    side = np.sign(np.diff(angle, prepend=angle[0] - 1))
    if is_recorded:
        side = np.random.default_rng(1).choice([-1.0, 1.0], recording.n)
        recording = with_column(recording, "approach2", side)
    assert found_in(robot, with_column(recording, "q2_deg", angle + 0.06 * side)) is None
    random = np.random.default_rng(2).choice([-0.06, 0.06], recording.n)
    found = found_in(robot, with_column(recording, "q2_deg", angle + random))
    assert found.cause == "reading-noise" and "column q2_deg" in found.sentence


def test_random_errors_above_those_of_a_good_fit_are_named():
    """Twice what a sound arm leaves is too little for a misfit without a cause, and was passed over."""
    robot, recording = erring("ball-centre", 3, n=120)
    noise = np.random.default_rng(0).normal(0, 0.12, recording.n)
    recording = with_column(recording, "q2_deg", recording.columns["q2_deg"] + noise)
    assert fit_recording(robot, recording).core > 1.5 * good_scale(robot, recording)
    (found,) = check_plausibility(robot, recording)
    assert found.cause == "reading-noise" and "column q2_deg" in found.sentence
