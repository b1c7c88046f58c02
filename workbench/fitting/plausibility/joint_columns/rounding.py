"""Readings and measurements that were rounded before they were written: a lattice that the numbers themselves show."""

import numpy as np

from datasets.samples.columns import joint_columns
from workbench.fitting.plausibility.fitting import POSITION
from workbench.fitting.plausibility.hypotheses.corrections import point_columns

_STEPS = (10.0, 5.0, 1.0, 0.5, 0.25, 0.2, 0.1, 0.05)
_MM_STEPS = (*_STEPS, 0.02, 0.01)
_INCH_MM = 25.4
_INCH_STEPS = (1.0, 0.5, 0.1, 0.05, 0.01, 0.005, 0.001)
_LEAST_VALUES = 8
_WINDOW = (0.35, 3.0)


def lattice_step(values: np.ndarray) -> float:
    """The largest usual step of which all values are multiples, 0 where there is none or too few values differ."""
    if len(np.unique(values)) < _LEAST_VALUES:
        return 0.0
    return next((step for step in _STEPS if _are_multiples(values, step)), 0.0)


def _are_multiples(values: np.ndarray, step: float) -> bool:
    return bool(np.abs(values / step - np.round(values / step)).max() < 1e-6)


def point_rounding(recording) -> tuple[list[str], str, float]:
    """Columns of coordinates or lengths with one coarsest lattice, its step in words, and the RMS error in mm of it."""
    steps = {step: f"{step:g} mm" for step in _MM_STEPS}
    steps |= {_INCH_MM * step: f"{step:g} in" for step in _INCH_STEPS}
    found = {}
    for name in point_columns(recording):
        values = recording.columns[name]
        if len(np.unique(values)) >= _LEAST_VALUES:
            sizes = (step for step in sorted(steps, reverse=True) if _are_multiples(values, step))
            found[name] = next(sizes, 0.0)
    rounded = [name for name, step in found.items() if step > 0]
    if not rounded:
        return [], "", 0.0
    predicted = float(np.sqrt(sum(step**2 for step in found.values()) / 12))
    return rounded, steps[max(found.values())], predicted


def joint_rounding(robot, recording, fit) -> tuple[list[str], float, float]:
    """Rounded joint columns, their coarsest step, and the RMS position error in mm that rounding explains.

    A reading that is uniform within a step h has the standard deviation h / sqrt(12).
    """
    names = joint_columns(recording.columns)
    steps = np.array([lattice_step(recording.columns[name]) for name in names])
    rounded = [name for name, step in zip(names, steps) if step > 0]
    if not rounded:
        return [], 0.0, 0.0
    units = np.array([1.0 if name.endswith("_mm") else np.pi / 180 for name in names])
    deviation = steps * units / np.sqrt(12)
    # a reading moves every joint that the mixing couples to it
    by_reading = np.einsum("jr,jcn->rcn", robot.mixing, _joint_rows(robot, fit))
    squares = (by_reading**2).sum(1).mean(1) * deviation**2
    predicted = float(np.sqrt(squares.sum()))
    return rounded, float(steps.max()), predicted


def _joint_rows(robot, fit) -> np.ndarray:
    """(J, 3, n) derivative of the position (mm) by every joint variable (rad, mm)."""
    rows = []
    for number, slides in enumerate(robot.prismatic, 1):
        offset_row = fit.parameters.matching(f"joint-{number}.{'d' if slides else 'theta'}{number}")
        rows.append(fit.model.linearise(fit.parameters.only(offset_row))[1][0, :POSITION])
    return np.stack(rows)


def explains(predicted_mm: float, found_mm: float) -> bool:
    """Whether an error of the predicted size accounts for the error found."""
    low, high = _WINDOW
    return low * predicted_mm < found_mm < high * predicted_mm
