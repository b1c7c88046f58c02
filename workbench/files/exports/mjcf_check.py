"""An exported MJCF file read back, and simulated where MuJoCo is installed."""

from importlib.util import find_spec
from xml.etree import ElementTree as ET

import numpy as np

from workbench.files.exports.check import readings_in_ranges
from workbench.files.exports.mjcf import control_terms, left_out
from workbench.files.exports.python.module import arm_data
from workbench.files.exports.python.runtime import CorrectedArm
from workbench.files.solution_file import CalibratedArm

_POSES, _STEPS = 3, 1500
_SAME_MM = 1e-6
# The model has the torques of the nominal pose, the simulation those of the deflected one: a share of the deflection.
_REST_MM, _REST_SHARE = 0.02, 0.05
_LOAD = "payload_kg"


class _Differs(RuntimeError):
    """A fault of the export, not of the user."""


def check_mjcf(arm: CalibratedArm, text: str) -> None:
    """RuntimeError where a recorded load hangs elsewhere, or a simulation comes to rest elsewhere than the model."""
    if np.abs(_load_place(text) - arm.load_centre).max() > _SAME_MM:
        raise _Differs("the load of the MJCF file hangs elsewhere than the recorded loads")
    if find_spec("mujoco") is not None:
        _check_rest(arm, text)


def _load_place(text: str) -> np.ndarray:
    """(3,) mm in the frame of the flange, of the body that carries the load."""
    bodies = ET.fromstring(text).iter("body")
    load = next(body for body in bodies if body.get("name") == "load")
    return np.array(load.get("pos").split(), float) * 1e3


def _check_rest(arm: CalibratedArm, text: str) -> None:
    """Simulates the heaviest recorded load at poses within the recorded ranges."""
    ranges = arm.fitted_range or {}
    load = float(ranges.get(_LOAD, (0.0, 0.0))[1])
    readings = _readings(arm, ranges)
    observed_effects_ids = {id(effect) for effect in control_terms(arm)}
    missing = set(left_out(arm))
    expected_effects = [
        e
        for e in arm.acting_effects
        if id(e) not in observed_effects_ids and e.title not in missing
    ]
    model = CorrectedArm(arm_data(arm), expected_effects, expected_effects)
    expected_poses = model.flange_poses(readings, {_LOAD: load})[:, :3, 3]
    corrected_arm = CorrectedArm(arm_data(arm), (), ())
    rigid = corrected_arm.flange_poses(readings)[:, :3, 3]
    targets = CorrectedArm(arm_data(arm), expected_effects, expected_effects).servo_targets(
        readings, {_LOAD: load}
    )
    found = _at_rest(text, targets, load)
    if not np.isfinite(found).all():
        raise _Differs("the MJCF file is unstable in MuJoCo")
    deviations = np.linalg.norm(found - expected_poses, axis=1)
    allowed = _REST_MM + _REST_SHARE * np.linalg.norm(expected_poses - rigid, axis=1)
    if (deviations > allowed).any():
        raise _Differs(
            f"MuJoCo at rest is {deviations.max():.3g} mm away from the model under {load:g} kg"
        )


def _readings(arm: CalibratedArm, ranges) -> np.ndarray:
    """(n, R) deg, mm within the recorded ranges."""
    return readings_in_ranges(arm, ranges, _POSES)


def _at_rest(text: str, targets: np.ndarray, load: float) -> np.ndarray:
    """(n, 3) mm of the site `flange` after a simulation from the unloaded pose; nan where it diverges."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    body = model.body("load").id
    site = model.site("flange").id
    model.body_mass[body] = max(load, model.body_mass[body])
    mujoco.mj_setConst(model, data)
    driven = model.jnt_qposadr[model.actuator_trnid[:, 0]]
    places = []
    for target in targets:
        mujoco.mj_resetData(model, data)
        data.qpos[driven] = data.ctrl[:] = target
        mujoco.mj_step(model, data, _STEPS)
        is_stable = not any(data.warning[k].number for k in range(len(data.warning)))
        places.append(1e3 * data.site_xpos[site] if is_stable else np.full(3, np.nan))
    return np.array(places)


__all__ = ["check_mjcf"]
