"""The arm that a robot.toml describes."""

from collections.abc import Mapping

import numpy as np

from robot_model.robot import PARALLEL, Robot, coupling_of, wrong
from workbench.core.robot_files.robot_file import Joint, Payload, RobotFile, checked_robot_file
from workbench.core.text.sections import Placement
from workbench.core.text.structured_text import ContentError, read_toml


def read_robot_keys(path) -> dict:
    """The keys of a TOML file; InputError where it is not there or is not TOML."""
    try:
        return read_toml(path)
    except OSError as problem:
        raise wrong(path, "a readable file", problem.strerror, "check the path") from None
    except ContentError as problem:
        raise wrong(path, "TOML", f"a mistake ({problem})", "correct it there") from None


def robot_from_keys(keys: Mapping, where: str) -> Robot:
    """The arm of robot.toml's keys; InputError with one sentence where they cannot be right."""
    return _robot(checked_robot_file(keys, where))


def _robot(file: RobotFile) -> Robot:
    joints = file.joint
    angles = np.deg2rad([[j.theta_deg, j.alpha_deg, j.beta_deg] for j in joints])
    geometry = np.column_stack(
        [angles[:, 0], [j.d_mm for j in joints], [j.a_mm for j in joints], angles[:, 1:]]
    )
    payload = file.payload or Payload(mass_kg=0.0, com_mm=[0.0, 0.0, 0.0])
    gravity = np.array(file.gravity) / np.linalg.norm(file.gravity)
    com = np.array([j.com_mm or [0.0, 0.0, 0.0] for j in joints])
    return Robot(
        name=file.name,
        source=file.source,
        convention=file.convention,
        geometry=geometry,
        hayati=_hayati(file, geometry[:, 3]),
        prismatic=np.array([j.kind == "prismatic" for j in joints]),
        mixing=_mixing(joints),
        coupling=_coupling(joints),
        limits=np.array([j.limits for j in joints]),
        gear_ratio=np.array([j.revolutions for j in joints], float),
        gravity=gravity,
        mass=np.array([j.mass_kg or 0.0 for j in joints]),
        com=com,
        payload_mass=payload.mass_kg,
        payload_com=np.array(payload.com_mm),
        base=_pose(file.base),
        flange=_pose(file.flange),
    )


def _pose(section: Placement | None) -> np.ndarray:
    """(4, 4) of a section [base] or [flange], mm; the identity without one."""
    return np.eye(4) if section is None else section.matrix


def _hayati(file: RobotFile, alpha: np.ndarray) -> np.ndarray:
    """As the file says; where it does not say, from the twist to the next axis."""
    parallel = np.abs(np.sin(alpha)) < PARALLEL
    # the last joint (Craig: the first) has no neighbour on that side
    parallel[-1 if file.convention == "distal" else 0] = False
    hayati_values = [j.hayati for j in file.joint]
    return np.array(
        [bool(guess if word is None else word) for word, guess in zip(hayati_values, parallel)]
    )


def _coupling(joints: list[Joint]) -> np.ndarray | None:
    """`Robot.coupling` of the couplings that are stated to be mechanical."""
    mechanical = _mixing(joints, lambda coupled: coupled.mechanical)
    return coupling_of(mechanical, np.arange(len(joints)))


def _mixing(joints: list[Joint], counts=lambda coupled: True) -> np.ndarray:
    """(J, J) model variables from readings, with the couplings that count; a ratio is in the units of the files."""
    mixing = np.diag([float(j.sign) for j in joints])
    for k, joint in enumerate(joints):
        if joint.coupled is not None and counts(joint.coupled):
            other = joint.coupled.joint - 1
            mixing[k, other] += joint.coupled.ratio * joint.unit / joints[other].unit
    return mixing
