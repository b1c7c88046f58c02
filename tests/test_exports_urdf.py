"""A URDF with calibrated numbers: read back, it is the calibrated arm, and nothing else in it changes."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from export_scenes import GEOMETRY, arm_with, flanges, readings_of, write_urdf
from robot_model import load_robot
from workbench.commands.robot.export_arm import ArmOptions, _urdf
from workbench.core.errors import InputError
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.urdf_patch import patched_urdf


def test_a_patched_urdf_differs_in_numbers_alone_and_is_the_calibrated_arm(tmp_path):
    import re

    spec = write_urdf(tmp_path)
    arm = arm_with(spec, [("joint-compliance", "joint-2", {})])
    made = patched_urdf(arm, spec)
    before = (tmp_path / "cell.urdf").read_bytes()
    (tmp_path / "new.urdf").write_bytes(made.content)
    again = load_robot({"urdf": str(tmp_path / "new.urdf"), "tip": "tool0"})
    readings = readings_of(arm.robot)
    wanted = flanges(arm.robot, readings, calibrated_geometry(arm))
    np.testing.assert_allclose(flanges(again, readings), wanted, atol=1e-6)
    # what is not a number, or the joint's missing origin that had to be written, is the same byte for byte
    number = rb"-?\d+\.?\d*(e-?\d+)?"
    stripped = [
        re.sub(rb"(xyz|rpy)=(\"[^\"]*\"|'[^']*')", b"#", text) for text in (before, made.content)
    ]
    added = [line for line in stripped[1].split(b"\r\n") if line not in stripped[0].split(b"\r\n")]
    assert all(re.sub(rb"<origin( #)*/>|( #)+", b"", line) for line in added)
    skeleton = [re.sub(rb"<origin[^>]*>", b"", text) for text in stripped]
    assert skeleton[0] == skeleton[1] and re.search(number, made.content)
    assert b"our cell, do not edit by hand" in made.content and b"9 9 9" in made.content
    assert b'<origin xyz="0.1 0.2 0.3" rpy="0 0 0.5"/>' in made.content  # the mount is as it was
    assert "mount" not in made.changed and "tool_fixed" in made.changed
    assert made.left_out == ("joint-compliance at joint-2",) and made.is_whole


_ORIGIN = (
    '<origin my:xyz="1 2 3" note="a > b, xyz=9" rpy = {q}{rpy}{q}\n   xyz = {q}{xyz}{q} ></origin>'
)
_WRITTEN = {
    "xacro": lambda text: text.replace(
        "<robot ", '<robot xmlns:xacro="http://w" xmlns:my="http://x" '
    ),
    "drake": lambda text: text.replace("<robot ", '<robot xmlns="http://d" xmlns:my="http://x" '),
}


@pytest.mark.parametrize("quote", ['"', "'"])
@pytest.mark.parametrize("style", _WRITTEN)
def test_only_numbers_between_quotes_change_whatever_the_style_of_the_file(tmp_path, style, quote):
    """Attributes in another order, with other quotes and spaces, of other namespaces, and names in their values."""
    import re

    plain = write_urdf(tmp_path)
    text = (tmp_path / "cell.urdf").read_text(encoding="utf-8")
    turned = re.compile(r'<origin xyz="([^"]*)" rpy="([^"]*)"\s*/>')
    text = turned.sub(lambda m: _ORIGIN.format(q=quote, xyz=m[1], rpy=m[2]), text)
    text = _WRITTEN[style](text).replace("do not edit by hand", "nicht ändern")
    spec = plain | {"urdf": str(tmp_path / "styled.urdf")}
    (tmp_path / "styled.urdf").write_text(text, encoding="utf-8")
    arm = arm_with(spec, ())
    made = patched_urdf(arm, spec).content
    (tmp_path / "new.urdf").write_bytes(made)
    again = load_robot({"urdf": str(tmp_path / "new.urdf"), "tip": "tool0"})
    readings = readings_of(arm.robot)
    wanted = flanges(arm.robot, readings, calibrated_geometry(arm))
    np.testing.assert_allclose(flanges(again, readings), wanted, atol=1e-6)
    number = re.compile(rb"(?<=\s)((?:xyz|rpy) = )(\"[^\"]*\"|'[^']*')")
    before = (tmp_path / "styled.urdf").read_bytes()
    assert number.search(before) and before != made
    left = [re.sub(rb"<origin[^m]*?/>\s*", b"", number.sub(rb"\1", one)) for one in (before, made)]
    assert left[0] == left[1]


def test_a_urdf_in_utf_16_is_refused_with_the_remedy(tmp_path):
    spec = write_urdf(tmp_path)
    arm = arm_with(spec, ())
    file = tmp_path / "cell.urdf"
    text = file.read_text(encoding="utf-8").replace("utf-8", "utf-16")
    file.write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError, match="expected a text in UTF-8, found UTF-16"):
        patched_urdf(arm, spec)


def test_a_nominal_arm_leaves_its_urdf_as_it_is(tmp_path):
    spec = write_urdf(tmp_path)
    arm = arm_with(spec, ())
    nominal = {
        f"joint-{k + 1}.{n}{k + 1}": arm.robot.geometry[k, c]
        for k in range(6)
        for c, n in enumerate(GEOMETRY)
    }
    made = patched_urdf(replace(arm, values=nominal), spec)
    assert made.content == (tmp_path / "cell.urdf").read_bytes() and not made.changed


def test_an_arm_of_another_description_patches_the_urdf_of_the_same_kinematics(tmp_path):
    """An arm calibrated from a table of lengths and angles, and a URDF on a mount and with its own tool frame."""
    spec = write_urdf(tmp_path)
    own = load_robot(spec)
    table = replace(own, base=np.eye(4), flange=np.eye(4), name="table")
    arm = arm_with(table, ())
    made = patched_urdf(arm, spec)
    (tmp_path / "new.urdf").write_bytes(made.content)
    again = load_robot({"urdf": str(tmp_path / "new.urdf"), "tip": "tool0"})
    readings = readings_of(own)
    wanted = own.base @ flanges(table, readings, calibrated_geometry(arm)) @ own.flange
    np.testing.assert_allclose(flanges(again, readings), wanted, atol=1e-5)
    with pytest.raises(InputError, match="nominal kinematics of FANUC"):
        patched_urdf(arm_with({"builtin": "fanuc_lr_mate_200id"}, ()), spec)


def test_a_urdf_on_another_mount_than_that_of_the_calibration_is_exported(tmp_path):
    """The check compares the flange itself only with the very file of the calibration."""
    spec = write_urdf(tmp_path)
    other = tmp_path / "other.urdf"
    other.write_bytes((tmp_path / "cell.urdf").read_bytes().replace(b"0.1 0.2 0.3", b"0.4 0.2 0.1"))
    arm = arm_with({"urdf": str(other), "tip": "tool0"}, ())
    assert not np.allclose(arm.robot.base, load_robot(spec).base)
    options = ArmOptions(urdf=tmp_path / "cell.urdf", tip="tool0")
    made = _urdf(arm, tmp_path / "new.urdf", options, "urdf", lambda: None)
    (tmp_path / "new.urdf").write_bytes(made.texts[tmp_path / "new.urdf"])
    again = load_robot({"urdf": str(tmp_path / "new.urdf"), "tip": "tool0"})
    readings = readings_of(arm.robot)
    found = flanges(again, readings)
    wanted = flanges(arm.robot, readings, calibrated_geometry(arm))
    apart = found @ np.linalg.inv(wanted)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-5)


def test_a_flange_on_the_last_axis_is_said_to_miss_what_no_joint_can_hold(tmp_path):
    spec = write_urdf(tmp_path) | {"tip": "end"}
    made = patched_urdf(arm_with(spec, ()), spec)
    assert not made.is_whole and "no fixed joint follows" in made.left_out[0]


@pytest.mark.skipif(sys.platform == "win32", reason="Pinocchio has no wheels for Windows")
def test_pinocchio_reads_the_patched_urdf(tmp_path):
    import pinocchio

    spec = write_urdf(tmp_path)
    arm = arm_with(spec, ())
    text = patched_urdf(arm, spec).content.decode()
    model = pinocchio.buildModelFromXML(text)
    data = model.createData()
    readings = readings_of(arm.robot, 5)
    wanted = flanges(arm.robot, readings, calibrated_geometry(arm))
    for reading, pose in zip(readings, wanted):
        pinocchio.framesForwardKinematics(model, data, reading)
        found = data.oMf[model.getFrameId("tool0")]
        np.testing.assert_allclose(1e3 * found.translation, pose[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found.rotation, pose[:3, :3], atol=1e-9)
