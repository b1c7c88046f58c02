"""Covariates that follow from the readings: joint variables, torques, moments, gravity in the flange frame, time."""

import re

import numpy as np

from robot_model.effects.instrument import sight_covariates
from robot_model.state import State
from workbench.core.covariates import clock

_AXES = {"x": 0, "y": 1, "z": 2}
_NUMBERED = re.compile(r"(q|tau)(\d+)|moment(\d+)_([xyz])|(down|moment|seen)_([xyz])")


def covariate(state, name: str) -> np.ndarray:
    """(n,) a covariate that was recorded, or else one that is derived from the state of the nominal arm.

    Derived: `q<k>` angle of a joint's drive (rad, mm), `tau<k>` gravity torque on it (N m, N), `moment<k>_x`
    gravity moment at link k in its own frame and `moment_x` at the base (N m), `down_x` direction of gravity in the
    flange frame, `seen_x` measured point in the sensor frame (mm), `sight_azimuth` and `sight_elevation` (rad) and
    `sight_range` (m) as the instrument sees the point, `payload` (kg), `time` (s, or the number of the row). Raises
    InputError for a name that is neither.
    """
    if name in state.covariates:
        return state.covariates[name]
    found = derived(state, name) if isinstance(state, State) else None
    return state.covariate(name) if found is None else found


def derived(state, name: str) -> np.ndarray | None:
    """(n,) the derived covariate of that name; None where there is none."""
    if name == "time":
        return clock(state)
    if name == "payload":
        return state.payload
    if name.startswith("sight_"):
        return sight_covariates(state.measured).get(name)
    match = _NUMBERED.fullmatch(name)
    if match is None:
        return None
    kind, number, link, link_axis, vector, axis = match.groups()
    joints = state.robot.joints
    if kind and 1 <= int(number) <= joints:
        of_drives = state.drive_angles if kind == "q" else state.torque
        return of_drives[int(number) - 1]
    if link and 1 <= int(link) <= joints:
        return state.moment[int(link)][_AXES[link_axis]]
    if vector:
        return _component(state, vector, _AXES[axis])
    return None


def _component(state, vector: str, axis: int) -> np.ndarray:
    if vector == "down":
        return np.einsum("in,i->n", state.frames.link[-1][axis], state.gravity)
    if vector == "moment":
        return state.moment[0][axis]
    return state.measured[axis]
