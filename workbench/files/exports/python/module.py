"""The text of an exported module: the arm's data, the code that uses it, and its functions."""

import json
import re
from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from robot_model.state import approaches_read, reading_names
from robot_model.tool_points import calibrated_points
from workbench.files.exports.mjcf import control_terms
from workbench.files.exports.python import runtime
from workbench.files.exports.python.bundle import Symbol, bundle
from workbench.files.solution_file import LARGEST_DEG, LARGEST_MM, CalibratedArm

_LOAD, _JOINT = "payload_kg", re.compile(r"q\d+_(deg|mm)")
_DRAWS = 16
_METHODS = (
    "nominal_poses",
    "flange_poses",
    "corrected_readings",
    "measured_points",
    "servo_targets",
    "errors_left",
)
_HEAD = '''"""{name}: forward and inverse correction of the calibrated arm. Needs Python 3.11 and numpy alone.

Held-out RMS position error of the calibration: {held_out:.4g} mm.
Terms: {terms}.
{left_out}
Readings are in degrees (mm for a joint that slides), a row a configuration. Poses are 4 x 4 transforms in mm from the
flange to the robot's root frame.{covariates}

    nominal_poses(readings)                   where the controller believes the flange to be
    flange_poses(readings, covariates)        where it really is
    corrected_readings(readings, poses, covariates, force)
                                              readings that bring it to the target, and the error left (mm); nan where
                                              it is not reached, beyond limits or (unless force) implausible
    errors_left(corrected, readings, poses, covariates)
                                              what corrected readings leave of it: position (mm), orientation (deg)
    measured_points(readings, tool_point, covariates, reflector)
                                              a point of the tool in the frame of the external instrument (mm);
                                              tool_point: mm in the flange frame, by default {point}
    servo_targets(readings, covariates)       targets of the servos of the exported MJCF model

Example:

    import {module}
{given}    readings, left_mm = {module}.corrected_readings([{zeros}]{passed})
    points = {module}.measured_points(readings{point_passed}{passed})
"""
'''
_TAIL = """
ARM = CorrectedArm(DATA, {effects}, {observed}, {control})
nominal_poses = ARM.nominal_poses
flange_poses = ARM.flange_poses
corrected_readings = ARM.corrected_readings
measured_points = ARM.measured_points
servo_targets = ARM.servo_targets
errors_left = ARM.errors_left
"""


def python_module(
    arm: CalibratedArm, largest: tuple[float, float] = (LARGEST_MM, LARGEST_DEG)
) -> str:
    """Python source that gives the same flange poses and corrected readings as the calibrated arm.

    It holds every term that moves the flange, and needs numpy alone. The classes of the terms are those of the
    workbench, so that a term has one definition. largest: corrections (mm, deg) above which it gives no readings.
    """
    observed = observed_effects(arm)
    kinds = list(dict.fromkeys(type(effect) for effect in (*arm.acting_effects, *observed)))
    roots = [Symbol(runtime.__name__, "CorrectedArm")]
    roots += [Symbol(kind.__module__, kind.__name__) for kind in kinds]
    data = json.dumps(arm_data(arm, _used_ranges(arm), largest), indent=1)
    head = _HEAD.format(
        **_usage(arm),
        name=arm.robot.name,
        held_out=arm.held_out_mm,
        terms=", ".join(e.title for e in arm.acting_effects) or "geometry",
        left_out=_left_out(arm),
    )
    tail = _TAIL.format(
        effects=_constructors(arm.acting_effects),
        observed=_constructors(observed),
        control=_constructors(control_terms(arm)),
    )
    constants = f"null, true, false = float('nan'), True, False\nDATA = {data}\n"
    return f"{head}\n{bundle(roots, _METHODS)}\n\n{constants}\n{tail}"


def arm_data(
    arm: CalibratedArm,
    ranges: Mapping | None = None,
    largest: tuple[float, float] = (LARGEST_MM, LARGEST_DEG),
) -> dict:
    """Robot, parameter values, place of the load, and what a correction is compared with, as JSON; nan is null."""
    names = [f.name for f in fields(arm.robot) if f.name != "joint_names"]
    robot = {name: _plain(getattr(arm.robot, name)) for name in names}
    return {
        "robot": robot,
        "values": dict(arm.values),
        "load_centre": _plain(arm.load_centre),
        "ranges": {} if ranges is None else ranges,
        "largest_correction": list(largest),
        "rows": arm.rows,
    }


def observed_effects(arm: CalibratedArm) -> tuple:
    """Effects on joints, geometry, frames and loads, with those of the instrument's drift and of time."""
    acting = set(map(id, arm.acting_effects))
    ports = ("joint", "geometry", "frame", "gravity", "mass")
    return tuple(
        e for e in arm.effects if id(e) in acting or (e.port in ports and e.effect != "noise")
    )


def _left_out(arm: CalibratedArm) -> str:
    observed = set(map(id, observed_effects(arm)))
    titles = [effect.title for effect in arm.effects if id(effect) not in observed]
    return (
        f"Not in here, since they move no part of the arm: {', '.join(titles)}.\n" if titles else ""
    )


def _usage(arm: CalibratedArm) -> dict[str, str]:
    """Parts of the module's docstring that depend on the columns and the points of this calibration."""
    needs = covariates_used(arm)
    points = list(calibrated_points(arm.values))
    names = ", ".join(needs)
    sentence = f" Covariates are columns by name, in file units: {names}." if needs else ""
    if sides := approaches_read(observed_effects(arm)):
        sentence += (
            f"\nHysteresis and backlash count with the centre of the loop, unless covariates hold {', '.join(sides)} "
            "(-1 or 1:\nthe sign of the last long move)."
        )
    values = ", ".join(f'"{name}": {_typical(arm, name):.4g}' for name in needs)
    chosen = f"that of {points[0]}" if points else "none, since none was calibrated"
    if len(points) > 1:
        chosen += f" (reflector selects another of {', '.join(points)})"
    return {
        "covariates": sentence,
        "point": chosen,
        "module": "exported_arm",
        "given": f"    covariates = {{{values}}}\n" if needs else "",
        "passed": ", covariates=covariates" if needs else "",
        "point_passed": "" if points else ", tool_point=[0.0, 0.0, 100.0]",
        "zeros": str(_middle(arm)),
    }


def _used_ranges(arm: CalibratedArm) -> dict[str, list[float]]:
    """Recorded ranges of joint readings and of the covariates that a term uses, in file units."""
    used = covariates_used(arm)
    recorded = dict(arm.fitted_range or {})
    if recorded and any(effect.elastic for effect in arm.acting_effects):
        used = [*used, _LOAD]
        recorded.setdefault(_LOAD, (0.0, 0.0))
    used_names = [name for name in recorded if name in used or _JOINT.fullmatch(name)]
    return {name: list(recorded[name]) for name in used_names}


def _typical(arm: CalibratedArm, name: str) -> float:
    """The middle of the recorded range of a covariate, 0 where it is unknown."""
    return sum((arm.fitted_range or {}).get(name, (0.0, 0.0))) / 2


def _middle(arm: CalibratedArm) -> list[float]:
    """(R,) deg, mm: the middle of the recorded joint readings, for an example; 0 where they are unknown."""
    names = reading_names(arm.robot)
    return [round(_typical(arm, name), 1) for name in names]


def covariates_used(arm: CalibratedArm) -> list[str]:
    """Columns apart from joint readings on which a term of the module depends, in order of the alphabet.

    They are what the terms state as needed, and every recorded column that changes the pose of the flange or a
    measured point when it goes from its lowest to its highest recorded value.
    """
    effects = observed_effects(arm)
    needed = {name for effect in effects for name in effect.needs}
    if arm.fitted_range is None:
        return sorted(needed | ({_LOAD} if any(e.elastic for e in effects) else set()))
    candidates = [name for name in arm.fitted_range if not _JOINT.fullmatch(name)]
    reference_arm = runtime.CorrectedArm(arm_data(arm), arm.acting_effects, effects)
    return sorted(needed | {name for name in candidates if _changes(arm, reference_arm, name)})


def _changes(arm: CalibratedArm, reference_arm, name: str) -> bool:
    """Whether a column changes a point on the tool between the ends of its recorded range."""
    rng = np.random.default_rng(0)
    drawn = {key: rng.uniform(*ends, _DRAWS) for key, ends in arm.fitted_range.items()}
    readings = np.stack([drawn[key] for key in drawn if _JOINT.fullmatch(key)], 1)
    low, high = (
        reference_arm.measured_points(
            readings, [0.0, 0.0, 100.0], drawn | {name: np.full(_DRAWS, end)}
        )
        for end in arm.fitted_range[name]
    )
    return bool(np.abs(high - low).max() > 0)


def _constructors(effects) -> str:
    calls = [f"{type(e).__name__}({e.where!r}, **{e.options!r})" for e in effects]
    return "[" + ", ".join(calls) + "]"


def _plain(value):
    if isinstance(value, np.ndarray):
        return [_plain(part) for part in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and np.isnan(value):
        return None
    return value
