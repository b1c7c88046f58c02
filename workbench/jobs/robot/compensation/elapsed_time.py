"""How far a drifting arm may have moved between the end of the recording and the moment of the targets."""

import numpy as np

from robot_model.effects.extrapolation import CLOCK
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import model_at, nominal_poses
from workbench.jobs.robot.compensation.extrapolation import extrapolation_mm
from workbench.jobs.robot.compensation.point_uncertainty import position_derivative

_SHARE = 0.1  # of the length of the recording, after which the change is stated
_LEAST_MM = 1e-6  # below it nothing drifts


def elapsed_time_words(arm: CalibratedArm, found, covariates) -> list[str]:
    """A sentence on what functions of time may change after the recording, none where nothing drifts.

    found: `Compensated`; covariates: of its targets, on the clock of the recording.
    """
    rows = found.reached
    times = covariates.get(CLOCK)
    if times is None or arm.fitted_range is None or CLOCK not in arm.fitted_range or not rows.any():
        return []
    start, end = arm.fitted_range[CLOCK]
    columns = {name: np.broadcast_to(v, rows.shape)[rows] for name, v in covariates.items()}
    is_late = columns[CLOCK].max() > end
    wait = _SHARE * (end - start)
    if is_late:
        times = columns[CLOCK]
    else:
        times = np.full(rows.sum(), end + wait)
    at_end, later = (
        _extrapolation(arm, found.readings[rows], columns | {CLOCK: known})
        for known in (np.minimum(times, end), times)
    )
    change = np.sqrt(np.maximum(later**2 - at_end**2, 0.0)).max()
    if change < _LEAST_MM:
        return []
    if is_late:
        return [
            f"Since the end of the recording, drift may have moved these targets by up to {change:.2g} mm (1 sigma, "
            "from its changes in the recording); sigma_mm contains this. A new recording makes it smaller."
        ]
    return [
        f"Within {wait:.3g} s after the end of the recording, drift may move these targets by up to {change:.2g} mm "
        "(1 sigma, from its changes in the recording); sigma_mm contains this only for targets with times."
    ]


def _extrapolation(arm: CalibratedArm, readings, covariates) -> np.ndarray:
    """(n,) mm: what functions leave open at readings (n, R) beyond the range that they were fitted on."""
    model = model_at(arm, readings, nominal_poses(arm.robot, readings), covariates)
    parameters = position_derivative(model, arm)[2]
    return extrapolation_mm(model, parameters, arm)


__all__ = ["elapsed_time_words"]
