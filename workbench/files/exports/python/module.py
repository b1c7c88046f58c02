"""The text of an exported module: the arm's data, the code that uses it, and four functions."""

import json
from dataclasses import fields

import numpy as np

from workbench.files.exports.mjcf import control_terms
from workbench.files.exports.python import runtime
from workbench.files.exports.python.bundle import Symbol, bundle
from workbench.files.solution_file import CalibratedArm

_METHODS = (
    "nominal_poses",
    "flange_poses",
    "corrected_readings",
    "measured_points",
    "servo_targets",
)
_HEAD = '''"""{name}: forward and inverse correction of the calibrated arm. Needs Python 3.11 and numpy alone.

Held-out RMS position error of the calibration: {held_out:.4g} mm.
Terms: {terms}.
{left_out}
Readings are in degrees (mm for a joint that slides), a row a configuration. Poses are 4 x 4 transforms in mm from the
flange to the robot's root frame. Covariates are columns by name: {covariates}.

    nominal_poses(readings)                           where the controller believes the flange to be
    flange_poses(readings, covariates)                where it really is
    corrected_readings(readings, poses, covariates)   readings that bring it to the target, and the error left (mm)
    measured_points(readings, tool_point, covariates) a tool point in the frame of the external instrument
    servo_targets(readings, covariates)               targets of the servos of the exported MJCF model
"""
'''
_TAIL = """
ARM = CorrectedArm(DATA, {effects}, {observed}, {control})
nominal_poses = ARM.nominal_poses
flange_poses = ARM.flange_poses
corrected_readings = ARM.corrected_readings
measured_points = ARM.measured_points
servo_targets = ARM.servo_targets
"""


def python_module(arm: CalibratedArm) -> str:
    """Python source that gives the same flange poses and corrected readings as the calibrated arm.

    It holds every term that moves the flange, and needs numpy alone. The classes of the terms are those of the
    workbench, so that a term has one definition.
    """
    observed = observed_effects(arm)
    kinds = list(dict.fromkeys(type(effect) for effect in (*arm.acting_effects, *observed)))
    roots = [Symbol(runtime.__name__, "CorrectedArm")]
    roots += [Symbol(kind.__module__, kind.__name__) for kind in kinds]
    data = json.dumps(arm_data(arm), indent=1)
    head = _HEAD.format(
        name=arm.robot.name,
        held_out=arm.held_out_mm,
        terms=", ".join(e.title for e in arm.acting_effects) or "geometry",
        left_out=_left_out(arm),
        covariates=", ".join(_needs(arm)) or "none is needed",
    )
    tail = _TAIL.format(
        effects=_constructors(arm.acting_effects),
        observed=_constructors(observed),
        control=_constructors(control_terms(arm)),
    )
    constants = f"null, true, false = float('nan'), True, False\nDATA = {data}\n"
    return f"{head}\n{bundle(roots, _METHODS)}\n\n{constants}\n{tail}"


def arm_data(arm: CalibratedArm) -> dict:
    """Robot, parameter values and place of the load, as JSON; nan is null."""
    robot = {f.name: _plain(getattr(arm.robot, f.name)) for f in fields(arm.robot)}
    return {
        "robot": robot,
        "values": dict(arm.values),
        "load_centre": _plain(arm.load_centre),
    }


def observed_effects(arm: CalibratedArm) -> tuple:
    """Effects on joints, geometry, frames and loads, with those of the instrument's drift and of time."""
    acting = set(map(id, arm.acting_effects))
    ports = ("joint", "geometry", "frame", "gravity", "mass")
    return tuple(
        e for e in arm.effects if id(e) in acting or (e.port in ports and e.effect != "noise")
    )


def _left_out(arm: CalibratedArm) -> str:
    held = set(map(id, observed_effects(arm)))
    rest = [effect.title for effect in arm.effects if id(effect) not in held]
    return f"Not in here, since they move no part of the arm: {', '.join(rest)}.\n" if rest else ""


def _needs(arm: CalibratedArm) -> list[str]:
    ranges = arm.fitted_range or {}
    covariates = [name for name in ranges if not name.startswith("q") or name.startswith("qdot")]
    return sorted({*covariates, *(n for e in arm.effects for n in e.needs)})


def _constructors(effects) -> str:
    calls = [f"{type(e).__name__}({e.where!r}, **{e.options!r})" for e in effects]
    return "[" + ", ".join(calls) + "]"


def _plain(value):
    if isinstance(value, np.ndarray):
        return [_plain(part) for part in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and np.isnan(value) else value
