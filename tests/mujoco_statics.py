"""Static poses of an exported MJCF model, by MuJoCo alone."""

import mujoco
import numpy as np

_STEPS = 60


def flange_at_rest(text, targets, load_kg=None):
    """(n, 4, 4) mm of the site `flange` where servos, springs and gravity balance.

    targets (n, A): of the servos, rad and m. load_kg (n,): mass of the body `load`.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    body = model.body("load").id
    poses = []
    for row, ctrl in enumerate(targets):
        if load_kg is not None:
            model.body_mass[body] = max(load_kg[row], 1e-9)
            mujoco.mj_setConst(model, data)
        settle(model, data, ctrl)
        poses.append(pose_of(data, model.site("flange").id))
    return np.array(poses)


def settle(model, data, ctrl):
    """Newton's method on the balance of generalised forces; every joint has a spring or a servo."""
    mujoco.mj_resetData(model, data)
    data.ctrl[:] = ctrl
    stiffness = (
        model.jnt_stiffness[:, 0].copy()
        if model.jnt_stiffness.ndim > 1
        else model.jnt_stiffness.copy()
    )
    for actuator in range(model.nu):
        joint = model.actuator_trnid[actuator, 0]
        stiffness[joint] += model.actuator_gainprm[actuator, 0]
        data.qpos[joint] = ctrl[actuator]
    for _ in range(_STEPS):
        mujoco.mj_forward(model, data)
        force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        step = force / stiffness
        data.qpos[:] += step
        if np.abs(step).max() < 1e-13:
            break
    mujoco.mj_forward(model, data)


def pose_of(data, site):
    pose = np.eye(4)
    pose[:3, :3] = data.site_xmat[site].reshape(3, 3)
    pose[:3, 3] = 1e3 * data.site_xpos[site]
    return pose
