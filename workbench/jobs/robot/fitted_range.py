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
        slack = 0.05 * (high - low)
        if values.min() < low - slack or values.max() > high + slack:
            found.append(
                f"{name} ({values.min():.4g} to {values.max():.4g}, calibrated {low:.4g} to {high:.4g})"
            )
    return tuple(found)
