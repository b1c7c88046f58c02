"""Readings that were rounded before they were written: a lattice that the numbers themselves show."""

import numpy as np

from datasets.columns import joint_columns, joint_number
from workbench.plausibility.fitting import POSITION

_STEPS = (10.0, 5.0, 1.0, 0.5, 0.25, 0.2, 0.1, 0.05)
_LEAST_VALUES = 8
_WINDOW = (0.35, 3.0)


def lattice_step(values: np.ndarray) -> float:
    """The largest usual step of which all values are multiples, 0 where there is none or too few values differ."""
    if len(np.unique(values)) < _LEAST_VALUES:
        return 0.0
    for step in _STEPS:
        if np.abs(values / step - np.round(values / step)).max() < 1e-6:
            return step
    return 0.0


def joint_rounding(robot, recording, fit) -> tuple[list[str], float, float]:
    """Rounded joint columns, their coarsest step, and the RMS position error in mm that rounding explains.

    A reading that is uniform within a step h has the standard deviation h / sqrt(12).
    """
    names = joint_columns(recording.columns)
    steps = {name: lattice_step(recording.columns[name]) for name in names}
    rounded = [name for name in names if steps[name] > 0]
    if not rounded or not np.array_equal(robot.mixing, np.diag(np.diag(robot.mixing))):
        return [], 0.0, 0.0
    parameters = fit.parameters
    keys = {
        name: f"joint-{joint_number(name)}.{'d' if name.endswith('_mm') else 'theta'}{joint_number(name)}"
        for name in rounded
    }
    squares = 0.0
    for name, key in keys.items():
        _, rows = fit.model.linearise(parameters.only(parameters.matching(key)))
        unit = 1.0 if name.endswith("_mm") else np.pi / 180
        squares += (rows[0, :POSITION] ** 2).sum(0).mean() * (steps[name] * unit) ** 2 / 12
    return rounded, max(steps.values()), float(np.sqrt(squares))


def explains(predicted_mm: float, found_mm: float) -> bool:
    """Whether an error of the predicted size accounts for the error found."""
    low, high = _WINDOW
    return low * predicted_mm < found_mm < high * predicted_mm
