"""An elastic arm in static equilibrium, solved by MuJoCo.

The engine that makes recordings whose hidden physics the workbench has to
find. It shares nothing with `robot_model` on purpose: a model that is tested on
its own simulator only proves that it agrees with itself. The Denavit-Hartenberg
rows become an MJCF tree; every joint, the bending of every link at mid-link
and the pedestal are hinges with a torsion spring; gravity loads the tree, and
MuJoCo's own kinematics, gravity forces and springs decide where it rests.

Lengths are mm, angles rad, masses kg, compliances rad/(N m); MuJoCo itself
works in metres. Frames: `base` is the robot's base at rest (the world of the
MuJoCo model), frame k is the frame after joint k's full transform
Rz(q+theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), and the last of them is the flange.

Needs the package `mujoco` (extra `proof`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

STANDARD_GRAVITY = 9.80665  # m/s^2
# MuJoCo refuses moving bodies without mass; this much changes no torque.
_NO_MASS = 1e-12  # kg
_ITERATIONS = 60
_BALANCE = 1e-9


class StaticsError(RuntimeError):
    """The arm has no equilibrium close to its unloaded configuration."""


@dataclass(frozen=True)
class Arm:
    """A serial arm of hinges with elastic joints, links and pedestal.

    geometry: (J, 5) theta, d, a, alpha, beta of each distal row, rad and mm.
    mass: (J,) kg of the body that moves with joint k; com: (J, 3) mm, its
    centre of mass in frame k.
    tool_mass, tool_com: kg and (3,) mm in the flange frame; a payload hangs at
    the same point.
    joint_compliance: (J,) rad/(N m) about each joint's axis. 0 is rigid; a
    negative value is a spring that pushes, as some identified tables print.
    link_compliance: (J,) rad/(N m) of link k, about both axes across the line
    from joint k to joint k+1, at its middle. Links of no length stay rigid.
    pedestal_compliance: (2,) rad/(N m) about the base's x and y.
    gravity: (3,) direction in the base frame.
    mixing: (J, J): joint angles = mixing @ readings.
    """

    geometry: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    mixing: np.ndarray
    tool_mass: float = 0.0
    tool_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_compliance: np.ndarray | float = 0.0
    link_compliance: np.ndarray | float = 0.0
    pedestal_compliance: tuple[float, float] = (0.0, 0.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)

    @property
    def joints(self) -> int:
        return len(self.geometry)


@dataclass(frozen=True)
class StaticEquilibria:
    """Static equilibria of the arm, one row for each configuration.

    flange: (n, 4, 4) pose of the flange in the base frame, mm.
    hinges: names of the E hinges in tree order: pedestal-x, joint-1, link-1-u ...
    deflection: (n, E) rad, spring angle of each hinge (0 at rigid ones).
    torque: (n, E) N m that gravity puts on each hinge.
    imbalance: (n,) greatest |spring + gravity torque| at an elastic hinge, as a
    fraction of the greatest gravity torque.
    """

    flange: np.ndarray
    hinges: tuple[str, ...]
    deflection: np.ndarray
    torque: np.ndarray
    imbalance: np.ndarray


def arm_from_robot(robot: Mapping | str | Path, **elastic) -> Arm:
    """The arm of a robot.toml (path, or its parsed mapping, file keys in deg and mm).

    `elastic` goes to `Arm`: compliances, or other fields to override. Raises
    ValueError for conventions other than "distal" and for prismatic joints.
    """
    if not isinstance(robot, Mapping):
        robot = tomllib.loads(Path(robot).read_text(encoding="utf-8"))
    rows = robot["joint"]
    if robot.get("convention", "distal") != "distal" or any(
        "prismatic" == r.get("kind") for r in rows
    ):
        raise ValueError("the MuJoCo arm takes revolute joints in the distal convention")
    if "base" in robot or "flange" in robot:
        raise ValueError("the MuJoCo arm takes no sections [base] and [flange]")
    tool = robot.get("payload", {})
    fields = {
        "geometry": np.array([_row(r) for r in rows]),
        "mass": np.array([r.get("mass_kg", 0.0) for r in rows], float),
        "com": np.array([r.get("com_mm", (0, 0, 0)) for r in rows], float),
        "mixing": _mixing(rows),
        "gravity": tuple(robot.get("gravity", (0.0, 0.0, -1.0))),
        "tool_mass": float(tool.get("mass_kg", 0.0)),
        "tool_com": tuple(tool.get("com_mm", (0.0, 0.0, 0.0))),
    }
    return Arm(**(fields | elastic))


def _row(row: Mapping) -> list[float]:
    theta, alpha, beta = np.deg2rad(
        [row.get(k, 0.0) for k in ("theta_deg", "alpha_deg", "beta_deg")]
    )
    return [theta, row["d_mm"], row["a_mm"], alpha, beta]


def _mixing(rows: Sequence[Mapping]) -> np.ndarray:
    mixing = np.diag([float(r.get("sign", 1)) for r in rows])
    for k, row in enumerate(rows):
        if "coupled" in row:
            mixing[k, row["coupled"]["joint"] - 1] += row["coupled"]["ratio"]
    return mixing


# ---------------------------------------------------------------- the drives


@dataclass(frozen=True)
class Harmonic:
    """dq = cosine cos(order q) + sine sin(order q) of joint `joint` (from 1), rad.

    q is the joint's reading (Ye 2024, eq. 16); order 0 is a constant.
    """

    joint: int
    order: int
    cosine: float = 0.0
    sine: float = 0.0


@dataclass(frozen=True)
class Slip:
    """Joint `joint` stands `angle` rad further from row `first` (from 0) on."""

    joint: int
    first: int
    angle: float


@dataclass(frozen=True)
class Gap:
    """Joint `joint` stops `half` rad off its reading on the side it last moved to."""

    joint: int
    half: float


def drive_errors(
    readings: np.ndarray,
    harmonics: Sequence[Harmonic] = (),
    slips: Sequence[Slip] = (),
    gaps: Sequence[Gap] = (),
    approach: np.ndarray | None = None,
) -> np.ndarray:
    """(n, J) rad to add to the joint angles, before the springs.

    readings: (n, J) rad; approach: (n, J) in -1, 0, 1, needed for gaps.
    """
    error = np.zeros_like(readings)
    for h in harmonics:
        q = h.order * readings[:, h.joint - 1]
        error[:, h.joint - 1] += h.cosine * np.cos(q) + h.sine * np.sin(q)
    for slip in slips:
        error[slip.first :, slip.joint - 1] += slip.angle
    for gap in gaps:
        if approach is None:
            raise ValueError("a gap needs the sign of each joint's last motion")
        error[:, gap.joint - 1] += gap.half * approach[:, gap.joint - 1]
    return error


# ----------------------------------------------------------------- the model


def mjcf(arm: Arm) -> str:
    """The arm as MJCF text, in metres and radians, without springs.

    Springs are set on the compiled model, because their rest angle follows the
    commanded configuration.
    """
    root = ET.Element("mujoco", model="elastic-arm")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    ET.SubElement(root, "option", gravity=_text(STANDARD_GRAVITY * _unit(arm.gravity)))
    body = _body(ET.SubElement(root, "worldbody"), "pedestal", np.eye(4))
    _mass(body, 0.0, np.zeros(3))
    for name, axis in (("pedestal-x", (1, 0, 0)), ("pedestal-y", (0, 1, 0))):
        _hinge(body, name, axis)
    frame = np.eye(4)
    for k in range(arm.joints):
        body, frame = _link(body, frame, k + 1, arm)
    flange = _body(body, "flange", frame)
    _mass(flange, arm.tool_mass, np.asarray(arm.tool_com))
    load = _body(flange, "payload", _translation(arm.tool_com))
    _mass(load, 0.0, np.zeros(3))
    return ET.tostring(root, encoding="unicode")


def _link(parent: ET.Element, frame: np.ndarray, k: int, arm: Arm) -> tuple[ET.Element, np.ndarray]:
    """Joint k and link k below `parent`; also where frame k is in the new body."""
    _, d, a, alpha, beta = arm.geometry[k - 1]
    joint = _body(parent, f"joint-{k}", frame)
    _hinge(joint, f"joint-{k}", (0, 0, 1))
    _mass(joint, 0.0, np.zeros(3))
    middle = np.array([a / 2, 0, d / 2])
    bend = _body(joint, f"link-{k}", _translation(middle))
    for name, axis in zip("uv", _perpendicular_axes(middle)):
        _hinge(bend, f"link-{k}-{name}", axis)
    end = _translation(middle)
    end[:3, :3] = Rotation.from_euler("XY", [alpha, beta]).as_matrix()
    _mass(bend, arm.mass[k - 1], end[:3, :3] @ arm.com[k - 1] + middle)
    return bend, end


def _perpendicular_axes(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit axes across a line that lies in the x-z plane."""
    y = np.array([0.0, 1.0, 0.0])
    length = np.linalg.norm(line)
    return (y, np.cross(line / length, y)) if length > 0 else (y, np.array([1.0, 0.0, 0.0]))


def _body(parent: ET.Element, name: str, pose: np.ndarray) -> ET.Element:
    quat = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    return ET.SubElement(parent, "body", name=name, pos=_text(pose[:3, 3] / 1e3), quat=_text(quat))


def _mass(body: ET.Element, kg: float, centre: np.ndarray) -> None:
    kg = max(float(kg), _NO_MASS)
    inertia = _text([1e-12] * 3)  # a point: rotation at rest asks for no more
    ET.SubElement(body, "inertial", pos=_text(centre / 1e3), mass=repr(kg), diaginertia=inertia)


def _hinge(body: ET.Element, name: str, axis: ArrayLike) -> None:
    ET.SubElement(body, "joint", name=name, type="hinge", axis=_text(axis))


def _translation(xyz: ArrayLike) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = xyz
    return pose


def _unit(vector: ArrayLike) -> np.ndarray:
    return np.asarray(vector, float) / np.linalg.norm(vector)


def _text(numbers: ArrayLike) -> str:
    return " ".join(repr(float(x)) for x in np.asarray(numbers).ravel())


def _compliances(arm: Arm) -> np.ndarray:
    """(E,) rad/(N m) in the tree's hinge order."""
    joint = np.broadcast_to(arm.joint_compliance, arm.joints)
    link = np.broadcast_to(arm.link_compliance, arm.joints)
    # A link of no length has no direction to bend across.
    link = np.where(np.hypot(arm.geometry[:, 1], arm.geometry[:, 2]) < 1e-6, 0.0, link)
    per_joint = np.column_stack([joint, link, link])
    return np.concatenate([arm.pedestal_compliance, per_joint.ravel()])


# ------------------------------------------------------------------ at rest


def static_equilibria(
    arm: Arm, readings: np.ndarray, errors: ArrayLike = 0.0, payload_kg: ArrayLike = 0.0
) -> StaticEquilibria:
    """Static equilibrium of every configuration, payload and drive error.

    readings: (n, J) rad; errors: (n, J) rad from `drive_errors`, added after
    `mixing`; payload_kg: (n,) or one number.

    Each hinge rests where its spring carries gravity, q = q0 + C tau(q), found
    by iterating on MuJoCo's gravity torque tau; then MuJoCo's own springs are
    set and the sum of its spring and gravity forces is checked. Raises
    StaticsError where no balance is found (an arm too soft for its weight).
    """
    import mujoco

    readings = np.atleast_2d(np.asarray(readings, float))
    angles = readings @ arm.mixing.T + arm.geometry[:, 0] + errors
    loads = np.broadcast_to(np.asarray(payload_kg, float), len(readings))
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    return _rest_all(model, arm, angles, loads)


def _rest_all(model, arm: Arm, angles: np.ndarray, loads: np.ndarray) -> StaticEquilibria:
    import mujoco

    data = mujoco.MjData(model)
    compliance = _compliances(arm)
    stiff = np.divide(1.0, compliance, out=np.zeros(len(compliance)), where=compliance != 0)
    flange, payload = model.body("flange").id, model.body("payload").id
    start = np.zeros((len(angles), model.nq))
    start[:, 2::3] = angles
    poses, bends, torques, imbalance = [], [], [], []
    for k, (q0, load) in enumerate(zip(start, loads)):
        _set_load(model, data, payload, load)
        q, imbalance_k = _settle(model, data, q0, compliance, stiff, k)
        poses.append(_pose(data, flange))
        bends.append(q - q0)
        torques.append(-data.qfrc_bias)
        imbalance.append(imbalance_k)
    names = tuple(model.joint(i).name for i in range(model.njnt))
    return StaticEquilibria(
        np.array(poses), names, np.array(bends), np.array(torques), np.array(imbalance)
    )


def _set_load(model, data, body: int, kg: float) -> None:
    import mujoco

    kg = max(float(kg), _NO_MASS)
    if model.body_mass[body] != kg:
        model.body_mass[body] = kg
        model.qpos_spring[:] = model.qpos0
        mujoco.mj_setConst(model, data)


def _settle(model, data, q0, compliance, stiff, row) -> tuple[np.ndarray, float]:
    """Angles at rest (nq,) and the imbalance that MuJoCo is left with."""
    import mujoco

    model.jnt_stiffness[:] = stiff
    model.qpos_spring[:] = q0
    data.qvel[:] = 0
    q = q0.copy()
    for _ in range(_ITERATIONS):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        step = q0 - compliance * data.qfrc_bias - q
        q = q + step
        if np.abs(step).max() < 1e-15:
            break
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return q, _imbalance(data, q, stiff, row)


def _imbalance(data, q, stiff, row) -> float:
    scale = max(np.abs(data.qfrc_bias).max(), 1e-12)
    imbalance = np.where(stiff != 0, np.abs(data.qfrc_passive - data.qfrc_bias), 0.0)
    # A spring this stiff cannot be balanced better than a double holds its angle.
    rounding = 4 * np.finfo(float).eps * np.abs(stiff) * (1 + np.abs(q))
    if not np.all(imbalance <= _BALANCE * scale + rounding):
        raise StaticsError(
            f"configuration {row}: springs and gravity do not balance; the arm is too soft"
        )
    return float(imbalance.max() / scale)


def _pose(data, body: int) -> np.ndarray:
    pose = _translation(data.xpos[body] * 1e3)
    pose[:3, :3] = data.xmat[body].reshape(3, 3)
    return pose


# ------------------------------------------------------------- measurements


def pose(xyz_mm: ArrayLike, rpw_deg: ArrayLike = (0, 0, 0)) -> np.ndarray:
    """(4, 4) Trans(x, y, z) Rz(r) Ry(w) Rx(p), angles in the order r, w, p (Ye 2024, eq. 8)."""
    out = _translation(xyz_mm)
    out[:3, :3] = Rotation.from_euler("ZYX", rpw_deg, degrees=True).as_matrix()
    return out


def reflector_points(
    flange: np.ndarray, reflector: ArrayLike, external_base: np.ndarray
) -> np.ndarray:
    """(n, 3) mm: a point of the flange frame, seen in the external frame."""
    in_base = flange[:, :3, :3] @ np.asarray(reflector, float) + flange[:, :3, 3]
    return in_base @ external_base[:3, :3].T + external_base[:3, 3]


def ball_points(
    flange: np.ndarray, balls: np.ndarray, artefact_base: np.ndarray, hand_eye: np.ndarray
) -> np.ndarray:
    """(n, 3) mm: centre of ball i (n, 3; artefact frame) in the sensor frame.

    artefact_base takes base to artefact coordinates, hand_eye sensor to flange.
    """
    to_artefact = artefact_base @ flange @ hand_eye
    offset = balls - to_artefact[:, :3, 3]
    return np.einsum("nji,nj->ni", to_artefact[:, :3, :3], offset)
