"""Noise of the instrument from replicates, and the lack of fit of a model against them."""

import numpy as np

from workbench.core.distributions import fisher
from workbench.fitting.verdicts.verdict import AS_STATED

LEAST_REPEATS = 10
FROM_REPLICATES = "from replicates"
UNKNOWN = "not stated: at most what remains"


def replicates(pose: np.ndarray, index: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, int]:
    """(n,) group of each sample, those of one pose and one target together, and the degrees of freedom within."""
    _, group = np.unique(np.stack([pose, index]), axis=1, return_inverse=True)
    group = group.ravel()
    return group, len(residual) * (len(group) - (group.max() + 1))


def noise(
    pose, index, residual: np.ndarray, sigma: float | None, degrees: float
) -> tuple[float, str]:
    """RMS distance (mm, px) that the instrument leaves, and how it is known.

    residual (m, n) of the final model with `degrees` of freedom left. From replicates where there are enough; else
    from the sigma of one coordinate that the recording states; else what is left in the end, an upper limit.
    """
    group, free = replicates(pose, index, residual)
    if free >= LEAST_REPEATS * len(residual):
        within_groups = sum(float(((row - _means(row, group)) ** 2).sum()) for row in residual)
        return float(np.sqrt(len(residual) * within_groups / free)), FROM_REPLICATES
    if sigma is not None:
        return float(np.sqrt(len(residual)) * sigma), AS_STATED
    return float(np.sqrt(len(residual) * (residual**2).sum() / max(degrees, 1.0))), UNKNOWN


def _means(row, group):
    return (np.bincount(group, row) / np.bincount(group))[group]


def lack_of_fit(pose, index, residual: np.ndarray, rank: int) -> dict | None:
    """Lack of fit against pure error where there are replicates: F of means over repeats; None without repeats.

    Draper & Smith, Applied Regression Analysis, 3rd ed. (1998), sec. 2.1. rank: of the model's parameters.
    """
    group, free = replicates(pose, index, residual)
    if free < LEAST_REPEATS * len(residual):
        return None
    means = np.stack([_means(row, group) for row in residual])
    degrees_between = len(residual) * (group.max() + 1) - rank
    if degrees_between < 1:
        return None
    pure = float(((residual - means) ** 2).sum()) / free
    lack = float((means**2).sum()) / degrees_between
    ratio = lack / max(pure, 1e-300)
    return {
        "f": ratio,
        "p_value": float(fisher.sf(ratio, degrees_between, free)),
        "degrees": [int(degrees_between), int(free)],
        "means_rms": float(np.sqrt((means**2).sum(0).mean())),
        "pure_error_rms": float(np.sqrt(len(residual) * pure)),
    }


__all__ = ["FROM_REPLICATES", "LEAST_REPEATS", "UNKNOWN", "lack_of_fit", "noise", "replicates"]
