"""Lengths of the robot file that no manufacture explains, of recordings that fit all the same."""

from dataclasses import replace

import pytest

from coupled_arms import CoupledArm
from workbench.fitting.checked_samples import check_samples

SPRINGS = (0.0, 4e-7, 5e-7, 2e-6, 2e-6, 0.0)


def warnings(joint: int, off_mm: float, key: str = "a_mm") -> list[str]:
    """What is said of a file in which one length is off."""
    arm = CoupledArm("wrist", SPRINGS, couplings={})
    recording = arm.recording(120)
    keys = arm.keys()
    keys["joint"][joint - 1][key] += off_mm
    checked = check_samples(replace(recording, robot=keys))
    assert not checked.suspicions  # the geometry is estimated: the calibration may be used
    return [said for said in checked.warnings if "tolerances of manufacture" in said]


def test_a_wrong_length_is_named_with_its_estimate():
    said = warnings(2, 7.0)
    assert len(said) == 1 and "a2 = 869." in said[0] or "a2 = 870." in said[0]
    assert "mm instead of 877 (-" in said[0]


@pytest.mark.parametrize(("joint", "off_mm", "key"), [(2, 0.0, "a_mm"), (2, 1.5, "a_mm")])
def test_what_manufacture_explains_is_not(joint, off_mm, key):
    assert not warnings(joint, off_mm, key)
