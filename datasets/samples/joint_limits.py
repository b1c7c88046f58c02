"""Joint readings beyond the limits of the robot file: a warning, because such limits are often only nominal.

A measured reading is evidence that the arm was there. Limits are copied from data sheets, and controllers allow an
overshoot or count several revolutions. Whether a sign or a unit is wrong is decided by the fit, not by the limits;
the warning only says where the opposite sign or radians would bring the column within them.
"""

from collections.abc import Iterator

import numpy as np

from datasets.formats.table import Table
from datasets.samples.checks import Context
from datasets.samples.columns import joint_columns

LIMIT_SLACK = 1.0
"""deg or mm by which a reading may pass a nominal limit: overshoot, and limits rounded in a data sheet."""


def limit_warnings(table: Table, context: Context) -> Iterator[str]:
    """One sentence a joint column with readings beyond the limits of the robot file."""
    rows = context.robot.get("joint", ())
    for name, joint in zip(joint_columns(table.columns), rows):
        unit = "mm" if name.endswith("_mm") else "deg"
        if f"limits_{unit}" in joint:
            limits = tuple(joint[f"limits_{unit}"])
            values = table.columns[name]
            violations = np.flatnonzero(~is_within(values, limits))
            if violations.size:
                yield _sentence(table, name, unit, limits, violations)


def is_within(values: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """(n,) True where a reading respects its limits, both in deg or mm."""
    low, high = limits
    return (values >= low - LIMIT_SLACK) & (values <= high + LIMIT_SLACK)


def _sentence(table: Table, name: str, unit: str, limits, violations: np.ndarray) -> str:
    values = table.columns[name]
    low, high = limits
    excess = np.maximum(low - values, values - high)
    worst = int(excess.argmax())
    rows = "1 reading is" if violations.size == 1 else f"{violations.size} readings are"
    return (
        f"{table.where(worst, name)}: {rows} beyond the limits of {low:g} to {high:g} {unit} in the robot file, here "
        f"{values[worst]:g} {unit}; the readings are used as they are; {_advice(values, unit, limits)}."
    )


def _advice(values: np.ndarray, unit: str, limits) -> str:
    """Recommended check: another sign or unit, if it would bring every reading within the limits."""
    if is_within(-values, limits).all():
        return "with the opposite sign all readings would be within them: check the sign of this column and the limits"
    if unit == "deg" and np.ptp(values) > 0 and is_within(np.rad2deg(1) * values, limits).all():
        return "as radians all readings would be within them: check the unit of this column and the limits"
    return "correct the limits if they are only nominal, or these readings"
