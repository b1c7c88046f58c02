"""Limits in exported URDF files: those of the joints of the file, not of the controller's readings."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from export_scenes import arm_with
from test_fewer_joints import PALLETISER, SCARA, _joint
from workbench.files.exports.check import check_urdf
from workbench.files.exports.urdf import urdf

COUPLED = {
    "name": "coupled, with a reversed joint and one without limits",
    "convention": "distal",
    "joint": [
        _joint(150, -90, d=500, limits=(-100, 170), sign=-1),
        _joint(600, limits=(-60, 75)),
        _joint(100, -90, limits=(-100, 60), coupled={"joint": 2, "ratio": -1.0}),
        _joint(0, 90, limits=(-180, 150)),
        {"theta_deg": 0.0, "d_mm": 0.0, "a_mm": 0.0, "alpha_deg": -90.0},
        _joint(d=100, limits=(-300, 200), coupled={"joint": 5, "ratio": 0.5}),
    ],
}
REVERSED = COUPLED | {"joint": [row | {"sign": -1} for row in SCARA["joint"]]}


def written_limits(text):
    """(J, 2) rad, m of the moving joints; nan where a joint is continuous."""
    joints = ElementTree.fromstring(text).findall("joint")
    limits = [j.find("limit") for j in joints if j.get("type") != "fixed"]
    ends = ("lower", "upper")
    nothing = {"lower": "nan", "upper": "nan"}
    return np.array([[float((nothing if j is None else j).get(e)) for e in ends] for j in limits])


def test_a_coupled_joint_has_the_interval_of_its_form_over_the_readings():
    text = urdf(arm_with(COUPLED, ()))
    found = np.rad2deg(written_limits(text))
    nan = np.nan
    wanted = [(-170, 100), (-60, 75), (-175, 120), (-180, 150), (nan, nan), (nan, nan)]
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert text.count("interval of this joint") == 2 and "joint_3 = -1 q2 + 1 q3" in text


def test_joints_that_are_not_coupled_keep_the_limits_of_their_readings():
    text = urdf(arm_with(REVERSED, ()))
    found = written_limits(text) * np.array([[180 / np.pi], [180 / np.pi], [1e3], [180 / np.pi]])
    np.testing.assert_allclose(found, [(-130, 130), (-145, 145), (0, 200), (-350, 350)], atol=1e-9)
    assert 'axis xyz="0 0 -1"' in text and "interval" not in text


def test_the_check_compares_the_recorded_readings_with_the_written_limits():
    arm = arm_with(PALLETISER, ())
    arm = replace(arm, fitted_range={f"q{k}_deg": (-120.0, 125.0) for k in range(1, 5)})
    text = urdf(arm)
    check_urdf(arm, text)
    own = repr(float(np.deg2rad(260)))
    narrow = text.replace(f'upper="{own}"', f'upper="{float(np.deg2rad(130))!r}"')
    assert narrow != text
    with pytest.raises(RuntimeError, match="limits of joint 3"):
        check_urdf(arm, narrow)
