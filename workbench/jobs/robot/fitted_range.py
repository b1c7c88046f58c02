"""Where a recording leaves the range of readings and covariates that a calibration was fitted to."""

from datasets.recording import Recording
from workbench.files.solution_file import CalibratedArm

_LOAD = "payload_kg"


def columns_outside(arm: CalibratedArm, samples: Recording) -> tuple[str, ...]:
    """Columns that leave the range of the calibration, with both ranges; a load that it did not have."""
    fitted = dict(arm.fitted_range or {})
    fitted.setdefault(_LOAD, (0.0, 0.0))
    found = []
    for name, (low, high) in fitted.items():
        values = samples.columns.get(name)
        if values is None or name in ("row", "time_s"):
            continue
        lowest, highest = values.min(), values.max()
        if _is_outside(lowest, highest, low, high):
            found.append(
                f"{name} ({lowest:.4g} to {highest:.4g}, calibrated {low:.4g} to {high:.4g})"
            )
    return tuple(found)


def _is_outside(lowest: float, highest: float, low: float, high: float) -> bool:
    """Whether values leave the calibrated range from low to high by more than a twentieth of it."""
    slack = 0.05 * (high - low)
    return lowest < low - slack or highest > high + slack
