"""robot.toml: every slip of the hand gets one sentence, and what is right becomes the arm."""

import tomllib

import numpy as np
import pytest

from robot_model import load_robot
from workbench.core.errors import InputError

GOOD = """
name = "two links"
convention = "distal"
gravity = [0.0, 0.0, -2.0]
source = "made up"
[[joint]]
theta_deg = 10.0
d_mm = 300
a_mm = 0.0
alpha_deg = 90.0
limits_deg = [-170, 170]
[[joint]]
theta_deg = 0.0
d_mm = 0.0
a_mm = 250.0
alpha_deg = 0.0
sign = -1
coupled = { joint = 1, ratio = 0.5 }
gear_ratio = 80
mass_kg = 2.0
com_mm = [1.0, 2.0, 3.0]
[[joint]]
kind = "prismatic"
theta_deg = 0.0
d_mm = 20.0
a_mm = 0.0
alpha_deg = 0.0
beta_deg = 2.0
limits_mm = [0, 400]
coupled = { joint = 1, ratio = 0.1 }
[payload]
mass_kg = 1.5
com_mm = [0.0, 0.0, 40.0]
"""

# what is changed in GOOD, and what the sentence must name
BROKEN = {
    "no name": ('name = "two links"', "", ["key name", "missing"]),
    "empty name": ('"two links"', '""', ["key name"]),
    "no convention": ('convention = "distal"', "", ["key convention", "missing"]),
    "odd convention": (
        '"distal"',
        '"proximal"',
        ["key convention", "'standard', 'modified'", "'proximal'"],
    ),
    "unknown key": ("[payload]", "[paylood]", ["key paylood", "payload"]),
    "unknown joint key": ("sign = -1", "sing = -1", ["joint 2", "key sing", "did you mean sign?"]),
    "synonym of com_mm": (
        "com_mm = [1.0",
        "centre_mm = [1.0",
        ["joint 2", "key centre_mm", "did you mean com_mm?"],
    ),
    "synonym of kind": (
        'kind = "prismatic"',
        'type = "prismatic"',
        ["joint 3", "key type", "did you mean kind?"],
    ),
    "nothing near": (
        "sign = -1",
        "colour = 1",
        ["joint 2", "key colour is not known: expected one of"],
    ),
    "unknown payload key": (
        "mass_kg = 1.5",
        "mass = 1.5",
        ["key payload.mass", "did you mean mass_kg?"],
    ),
    "no length": ("a_mm = 250.0", "", ["joint 2", "key a_mm", "missing"]),
    "text": ("a_mm = 250.0", 'a_mm = "250"', ["joint 2", "key a_mm", "'250'"]),
    "yes for a number": ("a_mm = 250.0", "a_mm = true", ["joint 2", "key a_mm", "True"]),
    "number for yes": ("sign = -1", "hayati = 1", ["joint 2", "key hayati"]),
    "nan": ("d_mm = 300", "d_mm = nan", ["joint 1", "key d_mm", "finite"]),
    "inf": ("gravity = [0.0, 0.0, -2.0]", "gravity = [0.0, 0.0, -inf]", ["key gravity", "finite"]),
    "no gravity": ("[0.0, 0.0, -2.0]", "[0.0, 0.0, 0.0]", ["key gravity", "[0.0, 0.0, 0.0]"]),
    "flat gravity": ("[0.0, 0.0, -2.0]", "[0.0, -2.0]", ["key gravity", "3"]),
    "alpha in radians": (
        "alpha_deg = 90.0",
        "alpha_deg = 1.5708",
        ["joint 1", "alpha_deg", "radians", "90"],
    ),
    "theta in radians": (
        "theta_deg = 10.0",
        "theta_deg = -3.14159",
        ["joint 1", "theta_deg", "radians", "-180"],
    ),
    "limits in radians": ("[-170, 170]", "[-2.9, 2.9]", ["limits_deg", "radians"]),
    "limits turned": ("[-170, 170]", "[170, -170]", ["joint 1", "limits_deg", "swap"]),
    "one limit": ("[-170, 170]", "[170]", ["joint 1", "limits_deg"]),
    "limits of the other kind": (
        "limits_mm = [0, 400]",
        "limits_deg = [0, 400]",
        ["joint 3", "limits_mm"],
    ),
    "sign of two": ("sign = -1", "sign = 2", ["joint 2", "key sign", "-1 or 1"]),
    "coupled too far": (
        "{ joint = 1, ratio = 0.5 }",
        "{ joint = 4, ratio = 0.5 }",
        ["joint 2", "coupled", "1 to 3", "4"],
    ),
    "coupled to itself": (
        "{ joint = 1, ratio = 0.5 }",
        "{ joint = 2, ratio = 0.5 }",
        ["joint 2", "another", "2"],
    ),
    "coupled to half": (
        "{ joint = 1, ratio = 0.5 }",
        "{ joint = 1.5, ratio = 0.5 }",
        ["joint 2", "coupled.joint"],
    ),
    "coupled without ratio": (
        "{ joint = 1, ratio = 0.5 }",
        "{ joint = 1 }",
        ["joint 2", "coupled.ratio", "missing"],
    ),
    "no gear": ("gear_ratio = 80", "gear_ratio = 0", ["joint 2", "gear_ratio"]),
    "negative mass": ("mass_kg = 2.0", "mass_kg = -2.0", ["joint 2", "mass_kg", "-2"]),
    "mass without centre": ("com_mm = [1.0, 2.0, 3.0]", "", ["joint 2", "com_mm"]),
    "odd kind": ('"prismatic"', '"linear"', ["joint 3", "key kind", "'linear'"]),
    "not TOML": ("[[joint]]", "[[joint]", ["TOML"]),
    "two urdf keys": ('name = "two links"', 'name = "x"\nurdf = "y.urdf"', ["key convention"]),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_robot_file_gets_one_sentence(case, tmp_path):
    old, new, words = BROKEN[case]
    assert old in GOOD
    file = tmp_path / "robot.toml"
    file.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_robot(file)
    sentence = str(caught.value)
    assert "\n" not in sentence and sentence.endswith(".")
    for word in ["robot.toml", *words]:
        assert word in sentence


def test_metres_are_recognised():
    keys = tomllib.loads(GOOD)
    for joint in keys["joint"]:
        joint.update(a_mm=joint["a_mm"] / 1000, d_mm=joint["d_mm"] / 1000)
    with pytest.raises(
        InputError,
        match="robot: keys a_mm and d_mm: expected millimetres, found .* 0.57, .*metres; multiply",
    ):
        load_robot(keys)


def test_single_brackets_are_recognised(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text('name = "a"\nconvention = "distal"\n[joint]\ntheta_deg = 0\n')
    with pytest.raises(InputError, match=r"robot\.toml: key joint: expected one \[\[joint\]\]"):
        load_robot(file)


@pytest.mark.parametrize(
    "spec, words",
    [
        ({"builtin": "puma"}, "abb_irb120.*'puma'"),
        ("puma", "'puma'"),
        ({"builtin": ["ur10"]}, "ur10"),
        ({"builtin": "ur10", "sign": 1}, "sign"),
        ("nowhere/robot.toml", "nowhere.*No such file"),
        ({}, "key name is missing"),
        ({"name": "a", "convention": "distal", "joint": []}, "key joint"),
        ({"name": "a", "convention": "distal", "joint": [3]}, "joint 1"),
    ],
)
def test_an_unknown_arm_gets_one_sentence(spec, words):
    with pytest.raises(InputError, match=words):
        load_robot(spec)


def test_robot_toml_becomes_the_arm():
    robot = load_robot(tomllib.loads(GOOD))
    np.testing.assert_allclose(robot.geometry[0], [np.deg2rad(10), 300, 0, np.pi / 2, 0])
    np.testing.assert_allclose(robot.gravity, [0, 0, -1])
    # joint 3 slides 0.1 mm a degree of joint 1
    np.testing.assert_allclose(robot.mixing, [[1, 0, 0], [0.5, -1, 0], [np.rad2deg(0.1), 0, 1]])
    np.testing.assert_allclose(robot.limits, [np.deg2rad([-170, 170]), [np.nan, np.nan], [0, 400]])
    assert list(robot.hayati) == [False, True, False] and list(robot.prismatic) == [
        False,
        False,
        True,
    ]
    assert robot.payload_mass == 1.5 and list(robot.payload_com) == [0, 0, 40]
    np.testing.assert_allclose(robot.gear_ratio, [np.nan, 80, np.nan])
    assert list(robot.mass) == [0, 2, 0] and list(robot.com[1]) == [1, 2, 3]
