"""Random errors of one joint's readings or of one coordinate are named; smooth errors of the same size are not."""

from dataclasses import replace

import numpy as np
import pytest

from erring_scenes import erring
from workbench.fitting.plausibility.fitting import fit_recording
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
