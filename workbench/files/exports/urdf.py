"""The calibrated geometry as a URDF with corrected origins: kinematics only, a link a joint, no meshes."""

from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model.chain import ALPHA, BETA, THETA, A, D
from workbench.files.exports.mdh import calibrated_geometry, left_out
from workbench.files.solution_file import CalibratedArm

_COUPLED_LIMITS = (
    " interval of this joint over the limits of all readings that it depends on; "
    "not every combination of joint angles within such limits is allowed "
)


def urdf(arm: CalibratedArm) -> str:
    """URDF text: lengths in m, angles in rad; links base_link, link_1 ..., flange.

    Joints keep the names of the arm's own URDF or MJCF file; else they are joint_1 ....
    A URDF's joint turns about its own axis after a fixed origin: what stands between two joint
    axes becomes the origin of the second. Where the controller couples joints, which a URDF cannot
    say, its joints are the angles between the links, and a comment gives them from the readings. The limits of such a
    joint are the interval that its angle takes over the limits of all readings; it is wider than the reachable set.
    """
    signs = joint_signs(arm.robot)
    origins = joint_origins(arm)
    root = ET.Element("robot", name=arm.robot.name)
    root.append(ET.Comment(_note(arm)))
    links = ["base_link", *(f"link_{k + 1}" for k in range(arm.robot.joints)), "flange"]
    for link in links:
        ET.SubElement(root, "link", name=link)
    for k, (origin, sign) in enumerate(zip(origins, signs)):
        _joint(root, arm.robot, k, (links[k], links[k + 1]), origin, sign)
    fixed = ET.SubElement(root, "joint", name="flange_joint", type="fixed")
    _joint_element(fixed, links[-2], links[-1], origins[-1])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _note(arm):
    out = left_out(arm)
    source = "fitted to the complete model, whose" if out else "as calibrated; its"
    sentences = [f"Geometry {source} held-out RMS is {arm.held_out_mm:.4g} mm."]
    if out:
        sentences.append(f"Not in here, since a URDF cannot say it: {', '.join(out)}.")
    if is_coupled(arm.robot):
        sentences.append(f"In the controller's readings: {coupled_sums(arm.robot)}.")
    return _comment(sentences)


def _comment(sentences: list[str]) -> str:
    """Text of an XML comment, in which two hyphens cannot stand."""
    return f" {' '.join(sentences)} ".replace("--", "-")


def joint_signs(robot) -> np.ndarray:
    """(J,) 1 or -1 by which a reading turns its joint; 1 where joints are coupled."""
    signs = np.diag(robot.mixing)
    if is_coupled(robot):
        return np.ones(robot.joints)
    return signs


def is_coupled(robot) -> bool:
    """Whether a joint variable depends on more than its own reading, or not by plus or minus one."""
    mixing = np.abs(robot.mixing)
    return not np.array_equal(mixing, np.eye(robot.mixing.shape[0]))


def joint_limits(robot) -> np.ndarray:
    """(J, 2) rad, mm: lowest and highest value of each joint of the URDF over the limits of the readings.

    A joint is its own reading, or minus it, or a linear form of several readings: the interval of the form over the box
    of their limits. nan where a limit of one of them is unknown.
    """
    factors = robot.mixing * joint_signs(robot)[:, None]
    found = []
    for row in factors:
        coupled_joints = np.flatnonzero(row)
        ends = row[coupled_joints, None] * robot.limits[coupled_joints]
        found.append([ends.min(1).sum(), ends.max(1).sum()])
    return np.array(found)


def coupled_sums(robot) -> str:
    """Joint variables from readings: joint_3 = q3 + q2 of each joint that is not its own reading."""
    return "; ".join(
        f"{robot.joint_name(k)} = "
        + " + ".join(f"{row[c]:g} q{c + 1}" for c in np.flatnonzero(row))
        for k, row in enumerate(robot.mixing)
    )


def joint_origins(arm) -> list[np.ndarray]:
    """J + 1 fixed transforms (4, 4) mm: before each joint, and from the last to the flange."""
    before, after = around_joints(arm)
    starts = [arm.robot.base, *after]
    ends = [*before, arm.robot.flange]
    return [start @ end for start, end in zip(starts, ends)]


def around_joints(arm) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """J transforms (4, 4) mm each: from frame k-1 to the joint's axis, and from there to frame k."""
    before, after = [], []
    for theta, d, a, alpha, beta in calibrated_geometry(arm)[:, [THETA, D, A, ALPHA, BETA]]:
        screw = placed("z", theta, (0, 0, d))
        twist = placed("xy", [alpha, beta])
        link = placed("x", 0.0, (a, 0, 0))
        if arm.robot.convention == "distal":
            before.append(np.eye(4))
            after.append(screw @ link @ twist)
        else:  # Craig: Ry(beta) Rx(alpha) Tx(a) stand before the joint
            before.append(placed("YX", [beta, alpha]) @ link)
            after.append(screw)
    return before, after


def placed(axes, angles, shift=(0, 0, 0)) -> np.ndarray:
    """(4, 4) of a shift (mm) and rotations (rad) about moving axes, given by their letters."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axes.upper(), angles).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def _joint(root, robot, k, links, origin, sign):
    slides = robot.prismatic[k]
    low, high = joint_limits(robot)[k]
    bounded = np.isfinite([low, high]).all()
    kind = "prismatic" if slides else "revolute" if bounded else "continuous"
    joint = ET.SubElement(root, "joint", name=robot.joint_name(k), type=kind)
    _joint_element(joint, *links, origin)
    ET.SubElement(joint, "axis", xyz=f"0 0 {int(sign)}")
    if np.count_nonzero(robot.mixing[k]) > 1:
        joint.append(ET.Comment(_COUPLED_LIMITS))
    unit = 1e-3 if slides else 1.0
    low, high = (low, high) if bounded else (-1e6, 1e6)
    if kind != "continuous":
        limits = {"lower": repr(float(low * unit)), "upper": repr(float(high * unit))}
        ET.SubElement(joint, "limit", **limits, effort="0", velocity="0")


def _joint_element(joint, parent, child, origin):
    angles = Rotation.from_matrix(origin[:3, :3]).as_euler("xyz")
    ET.SubElement(joint, "origin", xyz=_numbers(origin[:3, 3] * 1e-3), rpy=_numbers(angles))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)


def _numbers(values: np.ndarray) -> str:
    """With all their digits."""
    return " ".join(map(repr, values.tolist()))
