"""Couplings of readings with any ratio that the robot file lacks or states wrongly."""

import re

import pytest

from coupled_arms import CoupledArm
from robot_model.files.loading import load_robot
from robot_model.measurements import samples_of
from workbench.fitting.plausibility import check_plausibility

SPRINGS = (0.0, 4e-7, 5e-7, 4e-6, 8e-6, 0.0)


def suspicions(true, stated, springs=()):
    arm = CoupledArm("wrist", springs, with_masses=False, couplings=true, stated=stated)
    recording = samples_of(arm.recording(120))
    return check_plausibility(load_robot(recording.robot), recording)


@pytest.mark.parametrize(
    ("true", "stated", "springs"),
    [
        ({6: (5, 0.75)}, {}, ()),
        ({5: (4, 0.0125)}, {}, SPRINGS),
        ({5: (4, -0.36)}, {}, SPRINGS),
        ({3: (2, -0.5)}, {}, SPRINGS),
        ({6: (5, 0.75)}, {6: (5, 0.7)}, SPRINGS),
        ({5: (4, 0.0125), 6: (5, 0.75)}, {}, ()),
        ({5: (4, 0.9877), 6: (5, -0.9877)}, {}, SPRINGS),
        ({5: (4, 0.21), 6: (4, -0.4)}, {}, SPRINGS),
    ],
)
def test_a_ratio_that_the_file_lacks_is_estimated(true, stated, springs):
    found = suspicions(true, stated, springs)
    assert found[0].cause == "coupled-joints"
    pattern = r"coupled = \{ joint = (\d), ratio = (\S+) \} under \[\[joint\]\] number (\d)"
    keys = {
        int(joint): (int(other), float(ratio))
        for other, ratio, joint in re.findall(pattern, found[0].sentence)
    }
    assert keys.keys() == true.keys()
    for joint, (other, ratio) in true.items():
        assert keys[joint][0] == other and abs(keys[joint][1] - ratio) < 5e-4


@pytest.mark.parametrize("couplings", [{}, {5: (4, -0.36)}, {5: (4, 0.0125), 6: (5, 0.75)}])
def test_a_sound_file_raises_no_doubt(couplings):
    found = suspicions(couplings, couplings, SPRINGS)
    assert not any(one.cause == "coupled-joints" for one in found)
