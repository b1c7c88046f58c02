"""Contribution to the targets of the terms that were switched off by name (`--without`)."""

import numpy as np

from workbench.core.errors import InputError
from workbench.core.terms import term_names
from workbench.files.solution_file import CalibratedArm, name_of
from workbench.jobs.robot.compensation.compensate import actual_poses, covariates_read

_ROUNDING_MM = 1e-9  # below it, two models have the same poses


def switched_off_warnings(
    complete_arm: CalibratedArm, arm: CalibratedArm, readings: np.ndarray, covariates=None
) -> list[str]:
    """A sentence on how far the missing terms move the flange at readings (n, R); none where none is missing.

    complete_arm: the calibrated arm with all terms; arm: without some of them. Rows of nan, of targets not reached,
    do not count. The held-out error and the covariance of a solution are those of all its terms.
    """
    disabled = [
        effect
        for effect in complete_arm.effects
        if all(effect is not remaining for remaining in arm.effects)
    ]
    reached = np.isfinite(readings).all(1)
    if not disabled or not reached.any():
        return []
    names = [term_names(effect.effect, effect.where, name_of(effect))[0] for effect in disabled]
    rows = readings[reached]
    columns = {name: np.asarray(v)[reached] for name, v in (covariates or {}).items()}
    missing_columns = covariates_read(complete_arm) - covariates_read(arm) - set(columns)
    try:
        poses = [actual_poses(variant, rows, columns) for variant in (complete_arm, arm)]
        distance = np.linalg.norm(poses[0][:, :3, 3] - poses[1][:, :3, 3], axis=1)
        size = f"by up to {distance.max():.3g} mm (RMS {np.sqrt((distance**2).mean()):.3g} mm)"
        # a loop of unknown direction counts with its centre, which says nothing of its width
        unknown = bool(missing_columns) and distance.max() < _ROUNDING_MM
    except InputError:  # the targets lack a column that only these terms read
        unknown = True
    if unknown:
        size = "by a distance that the columns of the targets do not determine"
    return [
        f"--without: the terms {', '.join(names)}, as they were calibrated, move the flange at these targets {size}. "
        "The held-out error, the uncertainty and the verdict are those of the complete model and do not contain this."
    ]


__all__ = ["switched_off_warnings"]
