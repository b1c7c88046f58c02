"""No convention of measured angles fits because of a mistake in joint readings or robot file: the mistake is named."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import mostly_slow
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

NAMES = [
    *(f"J{k}" for k in range(1, 7)),
    "X [mm]",
    "Y [mm]",
    "Z [mm]",
    "A [deg]",
    "B [deg]",
    "C [deg]",
]


ON_AXIS = SCENE.replace("[10.0, 40.0, 130.0]", "[0.0, 0.0, 130.0]")
"""The measured point lies on the axis of the last joint: positions say nothing about that joint."""


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("truth"), ON_AXIS)


def reversed_last(joints):
    joints[:, 5] *= -1


def coupled(joints):
    """The drive of joint 5 moves the reading of joint 6."""
    joints[:, 5] += joints[:, 4]


CASES = {
    "coupled": (coupled, "joint 6 lacks its coupling (its angle is reading 6 - reading 5)"),
    "reversed": (reversed_last, "column 'J6' has the opposite sign"),
}


@pytest.mark.parametrize("case", mostly_slow(CASES, 0))
def test_the_mistake_is_named_with_the_convention_that_then_fits(truth, tmp_path, case):
    change, words = CASES[case]
    joints = degrees(truth)
    change(joints)
    quaternions = np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1)
    angles = Rotation.from_quat(quaternions).as_euler("XYZ", degrees=True)
    table = write_rows(tmp_path / "poses.csv", NAMES, np.c_[joints, truth.points, angles])
    with pytest.raises(InputError) as refused:
        import_recording([table], tmp_path / "made", UR10)
    assert words in str(refused.value)
    assert "intrinsic XYZ in degrees" in str(refused.value)
    assert "--trust-data" in str(refused.value)
