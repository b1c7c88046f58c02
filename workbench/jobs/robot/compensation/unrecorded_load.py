"""Targets that state a load, of an arm whose recording states none: the load of the calibration is then not known."""

from dataclasses import replace

import numpy as np

from workbench.core.errors import InputError
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import Compensated, actual_poses, compensate

LOAD = "payload_kg"
_LEAST_MM = 1e-6  # below it nothing deflects


def with_load(programme, payload_kg: float | None):
    """The programme with one load (kg) for all its targets; unchanged for None.

    programme: `workbench.files.targets.Programme`. Raises InputError where the targets state loads of their own.
    """
    if payload_kg is None:
        return programme
    if LOAD in programme.covariates:
        raise InputError(
            f"{programme.table.called}, column {LOAD}: expected no such column next to --payload-kg, found one; "
            "omit the option or the column."
        )
    loads = np.full(len(programme.readings), float(payload_kg))
    return replace(programme, covariates={**programme.covariates, LOAD: loads})


def is_load_unrecorded(arm: CalibratedArm) -> bool:
    """Whether neither recording nor robot file states what was on the flange; False where ranges are not known."""
    is_stated = arm.fitted_range is None or LOAD in arm.fitted_range
    return not is_stated and not arm.robot.payload_mass


def only_stated_load(arm: CalibratedArm, programme) -> float:
    """The load (kg) that all targets of a programme state and the recording does not; 0 where there is none.

    It is taken to be the load of the recording, which the estimated parameters contain.
    """
    loads = np.unique(programme.covariates.get(LOAD, 0.0))
    if is_load_unrecorded(arm) and len(loads) == 1:
        return float(loads[0])
    return 0.0


def compensate_programme(arm: CalibratedArm, programme, covariates, progress=None) -> Compensated:
    """The corrections of a programme; a load that the recording may have been made without counts in `sigma_mm`.

    programme: `workbench.files.targets.Programme`; covariates, progress: as of `compensate`.
    """
    options = {} if progress is None else {"progress": progress}
    found = compensate(
        arm, programme.readings, programme.poses, covariates, programme.anywhere, **options
    )
    shift = deflection_mm(arm, programme, found, covariates)
    return replace(
        found,
        sigma_mm=np.hypot(found.sigma_mm, shift),
        uncertainty_mm=np.hypot(found.uncertainty_mm, shift),
    )


def deflection_mm(arm: CalibratedArm, programme, found: Compensated, covariates) -> np.ndarray:
    """(n,) mm: how far the load that only the targets state moves the flange; 0 where the model cannot tell."""
    load = only_stated_load(arm, programme)
    readings = np.nan_to_num(found.readings)
    if not load:
        return np.zeros(len(readings))
    loaded, unloaded = (_flange_places(arm, readings, covariates, mass) for mass in (load, 0.0))
    shift = np.linalg.norm(loaded - unloaded, axis=1)
    return np.where(shift > _LEAST_MM, shift, 0.0)


def _flange_places(arm: CalibratedArm, readings: np.ndarray, covariates, load: float) -> np.ndarray:
    """(n, 3) mm under one load, kg, at all readings."""
    columns = {**covariates, LOAD: np.full(len(readings), load)}
    return actual_poses(arm, readings, columns)[:, :3, 3]


def unknown_load_words(arm: CalibratedArm, programme, shift: np.ndarray) -> list[str]:
    """Sentences on a load that only the targets state; shift (n,): of `deflection_mm`."""
    if not shift.any():
        return []
    load = only_stated_load(arm, programme)
    return [
        f"The targets state a load of {load:.4g} kg, and the recording of the calibration states none: it is taken to "
        f"have been made with the same load. If it was not, the load moves the flange by up to {shift.max():.2g} mm, "
        f"which sigma_mm contains. Add the column {LOAD} to the recording and calibrate again."
    ]
