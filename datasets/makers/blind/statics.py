"""Static pose of an arm with errors beyond its joints: deflections, growth, run-out and a moving base.

Stands on `datasets.makers.mujoco_arm`: the same MJCF tree, MuJoCo's own kinematics, springs and gravity.
What grows with temperature is built again for every temperature. Samples first: (n, ...).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.makers import mujoco_arm, poses
from datasets.makers.mujoco_arm import Arm


def torques(arm: Arm, angles: np.ndarray, payload: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, J) N m of gravity on the joints and (n, J, 2) across the links, of the arm at rest."""
    static_torque = _settled(arm, angles, np.zeros((*angles.shape, 2)), payload).torque[:, 2:]
    by_joint = static_torque.reshape(len(angles), arm.joints, 3)
    return by_joint[..., 0], by_joint[..., 1:]


def stand(arm: Arm, angles: np.ndarray, payload: np.ndarray, push) -> np.ndarray:
    """(n, 4, 4) mm of the flange under a `world.Perturbation`; angles (n, J) rad without the theta of the rows."""
    n, joints = angles.shape
    arm = with_compliances(arm, push)
    moved = angles + np.broadcast_to(push.joint, (n, joints))
    bend = np.broadcast_to(push.bend, (n, joints, 2))
    growth = np.broadcast_to(push.growth, (n, joints))
    flange = np.empty((n, 4, 4))
    for level in np.unique(growth, axis=0):
        rows = np.all(growth == level, axis=1)
        flange[rows] = _settled(grown(arm, level), moved[rows], bend[rows], payload[rows]).flange
    flange[:, :3, 3] += _run_out(arm, moved, np.broadcast_to(push.run_out, (n, joints, 3)))
    return _carried(np.broadcast_to(push.base, (n, 6)).copy(), flange)


def with_compliances(arm: Arm, push) -> Arm:
    """The arm with the push's compliances and tilt of gravity added to its own."""
    all_joints = np.ones(arm.joints)
    return replace(
        arm,
        joint_compliance=arm.joint_compliance * all_joints + push.joint_compliance,
        link_compliance=arm.link_compliance * all_joints + push.link_compliance,
        pedestal_compliance=tuple(np.asarray(arm.pedestal_compliance) + push.pedestal),
        gravity=tuple(np.asarray(arm.gravity) + push.gravity),
    )


def grown(arm: Arm, share: np.ndarray) -> Arm:
    """The arm with the d and a of every link longer by a share (J,)."""
    geometry = arm.geometry.copy()
    geometry[:, 1:3] *= 1 + share[:, None]
    return replace(arm, geometry=geometry)


def _settled(arm: Arm, angles, bend, payload):
    """Rest of the arm, as `mujoco_arm.rest` has it; angles are those after the mixing, bend (n, J, 2) rad."""
    plain = replace(arm, mixing=np.eye(arm.joints))
    return (
        _bent(plain, angles, bend, payload)
        if bend.any()
        else mujoco_arm.static_equilibria(plain, angles, payload_kg=payload)
    )


def _bent(arm: Arm, angles, bend, payload) -> "Bent":
    """The same with links that are bent before any load; hinges in the order joint, link-u, link-v."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_arm.mjcf(arm))
    data = mujoco.MjData(model)
    compliance = mujoco_arm._compliances(arm)
    stiff = np.divide(1.0, compliance, out=np.zeros(len(compliance)), where=compliance != 0)
    hinges = np.concatenate([(angles + arm.geometry[:, 0])[..., None], bend], axis=2).reshape(
        len(angles), -1
    )
    start = np.hstack([np.zeros((len(angles), 2)), hinges])
    poses_found = []
    for row, (first, load) in enumerate(zip(start, payload)):
        mujoco_arm._set_load(model, data, model.body("payload").id, load)
        mujoco_arm._settle(model, data, first, compliance, stiff, row)
        poses_found.append(mujoco_arm._pose(data, model.body("flange").id))
    return Bent(np.array(poses_found))


class Bent(NamedTuple):
    """(n, 4, 4) of the flange of an arm whose links are bent."""

    flange: np.ndarray


def _run_out(arm: Arm, angles, displacement) -> np.ndarray:
    """(n, 3) mm in the base frame by which axes that stand aside move the flange."""
    moved = np.zeros((len(angles), 3))
    for k in np.flatnonzero(displacement.any(axis=(0, 2))):
        before = poses.forward_kinematics(arm.geometry[:k], angles[:, :k]) if k else np.eye(4)[None]
        moved += np.einsum(
            "nij,nj->ni",
            np.broadcast_to(before[:, :3, :3], (len(angles), 3, 3)),
            displacement[:, k],
        )
    return moved


def _carried(twist, flange) -> np.ndarray:
    """The flange on a base that moved by (n, 6) mm and rad."""
    if not twist.any():
        return flange
    rotation = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    moved = flange.copy()
    moved[:, :3, :3] = rotation @ flange[:, :3, :3]
    moved[:, :3, 3] = np.einsum("nij,nj->ni", rotation, flange[:, :3, 3]) + twist[:, :3]
    return moved
