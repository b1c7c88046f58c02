"""How far functions of joint angles and of time may be off at targets beyond the range that they were fitted on."""

import numpy as np

from robot_model.effects.extrapolation import CLOCK
from robot_model.state import sliding
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.files.solution_file import CalibratedArm

_ROUNDING = 1e-12  # of ratios of readings


def extrapolation_mm(model: Model, parameters: Parameters, arm: CalibratedArm) -> np.ndarray:
    """(n,) mm: 1 sigma of the 3-D place of the measured point from what empirical functions leave open there.

    An error curve of a joint or a smooth function is known where samples support it. Beyond the last recorded sample
    it may differ by as much as it changes over such a distance within the range (`Effect.extrapolation`), and a drift
    may go on after the recording. Functions of different places, and the components of one, are independent.
    """
    evaluation = model.evaluate(parameters)
    recorded = recorded_variables(arm)
    if CLOCK in (arm.fitted_range or {}):
        recorded["time"] = arm.fitted_range[CLOCK]
    squares = np.zeros(model.chain.n)
    for effect, span in zip(model.effects, model.spans):
        sigma = effect.extrapolation(parameters.values[span], model.chain.state, recorded)
        if sigma is None or not sigma.any():
            continue
        port_indices = np.asarray(effect.port_indices(model.chain))
        moved = evaluation.rows(effect.port, port_indices)[:, :3] * sigma[:, None]
        squares += (moved**2).sum((0, 1))
    return np.sqrt(squares)


def recorded_variables(arm: CalibratedArm) -> dict[str, tuple[float, float]]:
    """Joint variable (`q2`, rad or mm) -> lowest and highest recorded value.

    That of the joint's own drive, without drives that combine several readings. Empty where
    the solution states no ranges.
    """
    recorded = arm.fitted_range or {}
    slides = sliding(arm.robot)
    found = {}
    for k, row in enumerate(arm.robot.drive_motion(arm.robot.mixing)):
        readings = np.flatnonzero(np.abs(row) > _ROUNDING)
        if len(readings) != 1:
            continue
        reading = int(readings[0])
        name = f"q{reading + 1}_{'mm' if slides[reading] else 'deg'}"
        if name in recorded:
            ends = np.array(recorded[name]) * row[reading]
            ends = ends if slides[reading] else np.deg2rad(ends)
            found[f"q{k + 1}"] = (float(ends.min()), float(ends.max()))
    return found


__all__ = ["extrapolation_mm", "recorded_variables"]
