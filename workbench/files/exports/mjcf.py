"""The calibrated arm as MJCF: corrected geometry, masses, and springs where the model deflects under load.

Every joint has a position servo whose stiffness is that of the calibrated joint, so that the arm rests where gravity
and servo balance. Bearings, links and the pedestal that deflect are pairs of hinges with a torsion spring. Lengths are
metres and angles radians, as everywhere in MuJoCo.
"""

import json
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model.effects import elastic, transmission
from robot_model.files.mjcf import TERMS
from robot_model.robot import Robot
from robot_model.statics import STANDARD_GRAVITY
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.files.exports.urdf import (
    around_joints,
    coupled_sums,
    is_coupled,
    joint_signs,
)
from workbench.files.solution_file import CalibratedArm, name_of

RIGID_NM_RAD = 1e9
"""Stiffness of a joint that does not deflect: 0.1 um at 1 m under 100 N m."""
_RATE = 100.0  # rad/s, natural frequency of every servo and spring, critically damped
_NO_MASS_KG = 1e-9  # MuJoCo refuses moving bodies without mass
_RADIUS_M = 0.05  # radius of gyration of every body, which no calibration at rest tells
# The laws themselves; their variants with further parameters, which are classes of their own, are not held.
_CARRIED = (
    elastic.JointCompliance,
    elastic.BearingCompliance,
    elastic.LinkCompliance,
    elastic.PedestalCompliance,
    elastic.FirstMoment,
    elastic.MountTilt,
    transmission.ConstantTerm,
)


@dataclass
class Compliances:
    """rad/(N m): by joint number of joints, bearings and links; of the pedestal about x and y."""

    joint: dict[int, float] = field(default_factory=dict)
    bearing: dict[int, float] = field(default_factory=dict)
    link: dict[int, float] = field(default_factory=dict)
    pedestal: tuple[float, float] = (0.0, 0.0)


def mjcf(arm: CalibratedArm) -> str:
    """MJCF text: bodies link_1 ..., flange and load; a site `flange`. Joints and servos keep the names
    of the arm's own URDF or MJCF file; else they are joint_1 ....

    The load of a target is the mass of the body `load`. Inertias are placeholders, since a calibration at rest does
    not tell them: the model is for static poses.
    """
    root = ET.Element("mujoco", model=arm.robot.name)
    root.append(ET.Comment(_note(arm)))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(
        root, "option", gravity=_text(gravity_of(arm)), timestep="0.001", integrator="implicitfast"
    )
    custom = ET.SubElement(root, "custom")
    ET.SubElement(custom, "text", name=TERMS, data=json.dumps(terms(arm)))
    world = ET.SubElement(root, "worldbody")
    found = compliances_of(arm)
    base = arm.robot.base
    parent = _pedestal(world, found.pedestal, base)
    servos = ET.Element("actuator")
    before, after = around_joints(arm)
    frame = np.eye(4) if any(found.pedestal) else base
    flange = arm.robot.flange
    onward = [*before[1:], flange]
    for k in range(arm.robot.joints):
        tip = (after[k] @ onward[k])[:3, 3]
        parent, frame = _link(parent, frame @ before[k], (k, tip), arm, found, after[k])
        _servo(servos, arm.robot, k, _stiffness(arm.robot, k, found))
    _flange(parent, frame @ flange, arm)
    root.append(servos)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def terms(arm: CalibratedArm) -> dict:
    """The terms of the model and their values, which `robot_model.files.mjcf.terms_of` reads back.

    Offsets, first moments and tilts of the mount are in the lengths, centres of mass and gravity of the file: a value
    of theirs would count twice where the file is read. Without it they start at zero.
    """
    rows = [{"effect": name_of(e), "where": e.where, **e.options} for e in arm.effects]
    values = {key: value for key, value in arm.values.items() if key.count(".") > 1}
    for effect in arm.effects:
        if _is_in_bodies(effect, arm):
            prefix = f"{effect.where}.{effect.effect}."
            values = {key: value for key, value in values.items() if not key.startswith(prefix)}
    return {"effects": rows, "values": values}


def _is_in_bodies(effect: Effect, arm: CalibratedArm) -> bool:
    """Whether the bodies and the gravity of the file hold what a term makes."""
    if type(effect) is elastic.FirstMoment:
        return _masses(arm)[0][_moment_body(effect, arm)] > 0
    is_in_lengths = type(effect) in (elastic.MountTilt, transmission.ConstantTerm)
    return is_in_lengths and _is_carried(effect, arm)


def left_out(arm: CalibratedArm) -> list[str]:
    """Terms that the MJCF file does not hold; those of `control_terms` act on the servo targets instead."""
    missing = []
    for effect in arm.effects:
        is_moment = type(effect) is elastic.FirstMoment
        massless = is_moment and not _is_in_bodies(effect, arm)
        if not _is_carried(effect, arm) or massless:
            missing.append(effect.title)
    return missing


def control_terms(arm: CalibratedArm) -> list[Effect]:
    """Terms on joints that are no springs (transmission errors, backlash, curves): they change the servo targets."""
    return [e for e in arm.acting_effects if e.port == "joint" and not _is_carried(e, arm)]


def _is_carried(effect, arm: CalibratedArm) -> bool:
    """Whether the file holds a term: the law itself, and not one of its variants with further parameters.

    A spring between two bodies is that of one joint: a drive that moves several is not held.
    """
    if type(effect) not in _CARRIED:
        return False
    return effect.port != "joint" or not _moves_several(arm.robot, effect.number - 1)


def _moves_several(robot: Robot, joint: int) -> bool:
    """Whether the drive of a joint (from 0) moves further joints."""
    return robot.coupling is not None and np.count_nonzero(robot.coupling[:, joint]) > 1


def _values(arm: CalibratedArm, effect: Effect, *names: str) -> list[float]:
    """Values of an effect's parameters by the last part of their keys."""
    return [arm.values[f"{effect.where}.{effect.effect}.{name}"] for name in names]


def _of_kind(arm: CalibratedArm, kind: type[Effect]) -> list:
    return [effect for effect in arm.effects if type(effect) is kind]


def gravity_of(arm: CalibratedArm) -> np.ndarray:
    """(3,) m/s^2 in the root frame, with the calibrated tilt of the mount."""
    gravity = arm.robot.gravity
    direction = gravity.copy()
    transverse = np.linalg.svd(gravity[None])[2][1:]
    for effect in _of_kind(arm, elastic.MountTilt):
        direction += _values(arm, effect, "tilt_1", "tilt_2") @ transverse
    return STANDARD_GRAVITY * direction


def compliances_of(arm: CalibratedArm) -> Compliances:
    """The calibrated compliance of every joint, bearing and link, and of the pedestal."""
    compliances = Compliances()
    _refuse_negative(arm)
    for effect in _of_kind(arm, elastic.JointCompliance):
        (compliances.joint[effect.number],) = _values(arm, effect, "compliance")
    for effect in _of_kind(arm, elastic.BearingCompliance):
        (compliances.bearing[effect.number],) = _values(arm, effect, "tilt")
    for effect in _of_kind(arm, elastic.LinkCompliance):
        (compliances.link[effect.number],) = _values(arm, effect, "bending")
    for effect in _of_kind(arm, elastic.PedestalCompliance):
        compliances.pedestal = tuple(_values(arm, effect, "about_x", "about_y"))
    return compliances


def _refuse_negative(arm: CalibratedArm) -> None:
    """InputError for a negative compliance: its spring would push away from the place of rest."""
    springs = {
        elastic.JointCompliance: ("compliance",),
        elastic.BearingCompliance: ("tilt",),
        elastic.LinkCompliance: ("bending",),
        elastic.PedestalCompliance: ("about_x", "about_y"),
    }
    for kind, names in springs.items():
        for effect in _of_kind(arm, kind):
            lowest = min(_values(arm, effect, *names))
            if lowest < 0:
                raise _negative_compliance(effect, lowest)


def _negative_compliance(effect, compliance: float) -> InputError:
    return InputError(
        f"--to mjcf: expected compliances of 0 or more, found {compliance:.3g} for {effect.title}: a "
        "spring with a negative stiffness makes the simulation unstable; calibrate again, or leave the "
        f"term out with --without {effect.where}.{effect.effect}"
    )


def _masses(arm: CalibratedArm) -> tuple[np.ndarray, np.ndarray]:
    """(J + 1,) kg and (J + 1, 3) mm centres of links and tool, with calibrated first moments; frames k and flange."""
    mass = np.append(arm.robot.mass, arm.robot.payload_mass)
    centre = np.vstack([arm.robot.com, arm.load_centre])
    for effect in _of_kind(arm, elastic.FirstMoment):
        k = _moment_body(effect, arm)
        moment = np.array(_values(arm, effect, "mx", "my", "mz"))
        if effect.where == "tool" and k < arm.robot.joints:
            moment = arm.robot.flange[:3, :3] @ moment
        if mass[k] > 0:
            centre[k] += moment / mass[k]
    return mass, centre


def _moment_body(effect, arm: CalibratedArm) -> int:
    """Index of the body whose centre takes a first moment: its own, or the last link for that of a lighter tool.

    The tool is fixed to the last link, so that the moment is the same there, and divided by a larger mass it moves the
    centre less far. A last link that bends is not fixed to the tool.
    """
    joints = arm.robot.joints
    if effect.where != "tool":
        return effect.number - 1
    bends = any(bending.number == joints for bending in _of_kind(arm, elastic.LinkCompliance))
    heavier = arm.robot.mass[-1] > arm.robot.payload_mass
    return joints - 1 if heavier and not bends else joints


def _pedestal(world, compliance, base) -> ET.Element:
    """The body that tilts about the base's x and y, where the pedestal deflects; else the world."""
    if not any(compliance):
        return world
    body = _body(world, "pedestal", base)
    _inertial(body, 0.0, np.zeros(3))
    for axis, name, value in zip(np.eye(3), "xy", compliance):
        _spring(body, f"pedestal_{name}", axis, value)
    return body


def _link(parent, frame, link, arm, found: Compliances, after) -> tuple[ET.Element, np.ndarray]:
    """Body and joint k + 1 below `parent`; also where frame k + 1 is in the innermost body that it made.

    link: k and where the link ends (3,) mm, in the frame of the joint.
    """
    (k, tip), masses = link, _masses(arm)
    number = k + 1
    body = _body(parent, f"link_{number}", frame)
    _joint(body, arm.robot, k, _stiffness(arm.robot, k, found))
    terms = _of_kind(arm, transmission.ConstantTerm)
    constants = [e for e in terms if e.number == number and _is_carried(e, arm)]
    offset = sum(_values(arm, effect, "k0")[0] for effect in constants)
    after = _screw(offset, arm.robot.prismatic[k]) @ after
    if found.bearing.get(number):
        for axis, name in zip(np.eye(3), "uv"):
            _spring(body, f"bearing_{number}_{name}", axis, found.bearing[number])
    if found.link.get(number):
        # the law has the moment of the bodies beyond the link: its own mass stays on the near half
        _inertial(body, masses[0][k], (after @ np.append(masses[1][k], 1))[:3])
        pivot = tip / 2
        bend = _translation(pivot)
        body = _body(body, f"link_{number}_bent", bend)
        for axis, name in zip(_transverse_axes(pivot), "uv"):
            _spring(body, f"link_{number}_{name}", axis, found.link[number])
        _inertial(body, 0.0, np.zeros(3))
        return body, np.linalg.inv(bend) @ after
    _inertial(body, masses[0][k], (after @ np.append(masses[1][k], 1))[:3])
    return body, after


def _flange(parent, frame, arm: CalibratedArm) -> None:
    mass, centre = (part[-1] for part in _masses(arm))
    flange = _body(parent, "flange", frame)
    _inertial(flange, mass, centre)
    ET.SubElement(flange, "site", name="flange")
    # where loads were recorded: fitted first moments are those of the arm and its tool and move no load
    load = _body(flange, "load", _translation(arm.load_centre))
    _inertial(load, 0.0, np.zeros(3))


def _joint(body, robot, k, stiffness: float) -> None:
    slides = robot.prismatic[k]
    sign = joint_signs(robot)[k]
    unit = 1e-3 if slides else 1.0
    keys = {"name": robot.joint_name(k), "type": "slide" if slides else "hinge"}
    if k < len(robot.limits) and not is_coupled(robot):
        bounds = robot.limits[k] * unit
    else:
        bounds = [np.nan]
    if np.isfinite(bounds).all():
        keys["range"] = _text(bounds)
    inertia = _text([abs(stiffness) / _RATE**2])
    ET.SubElement(body, "joint", axis=_text([0, 0, sign]), armature=inertia, **keys)


def _stiffness(robot, k, found: Compliances) -> float:
    """N m/rad of joint k + 1, N/m of a slide, whose compliance is in mm/N."""
    if _moves_several(robot, k):
        compliance = 0.0
    else:
        compliance = found.joint.get(k + 1, 0.0)
    unit = 1e-3 if robot.prismatic[k] else 1.0
    return 1 / (compliance * unit) if compliance else RIGID_NM_RAD


def _servo(servos, robot, k, stiffness: float) -> None:
    name = robot.joint_name(k)
    keys = {"kp": _text([stiffness]), "kv": _text([2 * abs(stiffness) / _RATE])}
    ET.SubElement(servos, "position", name=name, joint=name, **keys)


def _spring(body, name: str, axis, compliance: float) -> None:
    if not compliance:
        return
    stiffness = 1 / compliance
    keys = {
        "name": name,
        "type": "hinge",
        "axis": _text(axis),
        "stiffness": _text([stiffness]),
        "armature": _text([abs(stiffness) / _RATE**2]),
        "damping": _text([2 * abs(stiffness) / _RATE]),
    }
    ET.SubElement(body, "joint", **keys)


def _transverse_axes(line) -> tuple[np.ndarray, np.ndarray]:
    """Two unit axes across a line (3,); across the joint's axis, z, where the line has no length."""
    length = np.linalg.norm(line)
    if length > 1e-6:
        unit = line / length
    else:
        unit = np.array([0.0, 0.0, 1.0])
    first = np.linalg.svd(unit[None])[2][1]
    return first, np.cross(unit, first)


def _screw(offset: float, slides) -> np.ndarray:
    """(4, 4) a constant offset of a joint: a rotation about its axis (rad), or a shift along it (mm)."""
    matrix = np.eye(4)
    if slides:
        matrix[2, 3] = offset
    else:
        matrix[:3, :3] = Rotation.from_rotvec([0, 0, offset]).as_matrix()
    return matrix


def _body(parent, name: str, pose) -> ET.Element:
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    place = {"pos": _text(pose[:3, 3] / 1e3), "quat": _text(quaternion)}
    return ET.SubElement(parent, "body", name=name, **place)


def _inertial(body, kg: float, centre_mm) -> None:
    kg = max(float(kg), _NO_MASS_KG)
    inertia = _text([kg * _RADIUS_M**2] * 3)
    ET.SubElement(
        body,
        "inertial",
        pos=_text(np.asarray(centre_mm) / 1e3),
        mass=_text([kg]),
        diaginertia=inertia,
    )


def _translation(shift) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = shift
    return matrix


def _text(numbers) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def _note(arm: CalibratedArm) -> str:
    """Comment at the head of the file."""
    words = [
        f"Geometry as calibrated, held-out RMS {arm.held_out_mm:.4g} mm.",
        "For static poses: inertias are placeholders.",
    ]
    if is_coupled(arm.robot):
        words.append(f"Joint angles from the controller's readings: {coupled_sums(arm.robot)}.")
    if missing := left_out(arm):
        words.append(f"Not in this file: {', '.join(missing)}.")
    return f" {' '.join(words)} ".replace("--", "-")
