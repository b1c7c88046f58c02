"""Covariance of a hand-eye transform from errors that the corners of many images share.

The maximum-likelihood adjustment of pixels takes the errors of corners as independent; `shared_errors` says what else
displaces them and how such variances are propagated.
"""

from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.correlated_errors.shared_effects import shared_effects
from sensors.camera.correlated_errors.shared_errors import (
    CornerRows,
    SharedErrors,
    shared_errors,
    without_poses,
)
from workbench.core.least_squares.linear_algebra import pseudo_inverse
from workbench.core.rigid import rotation_matrix

_LEAST_PX = 1e-3
"""RMS displacement of corners by a shared error, below which it is rounding, px."""
_RELEVANT = 0.5
"""Share of the independent errors in the predicted corners, above which shared errors limit the result."""


@dataclass(frozen=True)
class Misfit:
    """`errors` of the corners that images share, and the `covariance` (F, F) of the free parameters that they make.

    `share`: RMS error of the corners that the calibration predicts by shared errors, over that by independent ones.
    """

    errors: SharedErrors
    covariance: np.ndarray
    share: float

    @property
    def significant(self) -> bool:
        return self.errors.significant and self.errors.largest > _LEAST_PX

    @property
    def is_relevant(self) -> bool:
        """Whether shared errors are significant and not small compared with the independent ones in the result.

        Corners have hundredths of a pixel of noise, so that errors of any real board or lens are significant; compared
        with the errors of the flange poses they hardly change what the calibration predicts.
        """
        return self.significant and self.share > _RELEVANT

    @property
    def note(self) -> str:
        """Of shared errors that are significant and hardly change the result."""
        return (
            f"corners are displaced by the same in many images (1 sigma: {self.errors.names}); this makes "
            f"{self.share:.2g} of the error of predicted corners that independent errors make, and the stated "
            "uncertainty includes it"
        )

    @property
    def sentence(self) -> str:
        """State what is wrong, what it does to the result, and what to do."""
        return (
            "board or camera model do not fit the images: corners are displaced by the same in many images (1 sigma: "
            f"{self.errors.names}; independent noise {self.errors.noise:.2g} px), which more images do not average "
            "out; the stated uncertainty of the transform includes it. Use a flat board of certified accuracy, and "
            "check the camera model and file"
        )


def image_misfit(adjusted, size: tuple[int, int], from_same_images: bool) -> Misfit:
    """Of an `Adjusted` board chain with images of `size` px.

    from_same_images: the prior of the camera was estimated from these images, so that shared errors displace its mean.
    """
    parameters = adjusted.parameters
    rows = _rows(adjusted, size)
    free = [key for key, is_free in zip(parameters.keys, parameters.mask) if is_free]
    camera = np.array([key.startswith("camera.") for key in free])
    precision = parameters.precision[parameters.mask]
    alone = replace(rows, shared=rows.shared[camera])
    known = np.zeros(camera.sum()) if from_same_images else precision[camera]
    errors = shared_errors(alone, known)
    noise = adjusted.variances.noise
    pose_precision = (noise / np.repeat(adjusted.variances.spread, 3)) ** 2
    pull = rows.pull(without_poses(rows, pose_precision)) / noise**2
    if from_same_images and camera.any():
        pull[camera] += precision[camera, None] * _calibrated(alone)
    influence = adjusted.linear.covariance @ pull
    covariance = errors.covariance(influence)
    predicted = _predicted(rows, adjusted.linear.covariance)
    shared = _predicted(rows, covariance)
    return Misfit(errors, covariance, shared / max(predicted, 1e-300))


def _predicted(rows: CornerRows, covariance: np.ndarray) -> float:
    """px: RMS error of predicted corners by parameters of this covariance (F, F); free of gauge directions."""
    by_parameter = rows.shared.reshape(len(rows.shared), -1)
    variance = np.einsum("fn,fg,gn->n", by_parameter, covariance, by_parameter, optimize=True)
    return float(np.sqrt(max(variance.mean(), 0.0)))


def with_misfit(adjusted, misfit: Misfit):
    """The same adjustment with the shared errors in the covariance of its shared parameters."""
    linear = adjusted.linear
    covariance = linear.covariance + misfit.covariance
    return replace(adjusted, linear=replace(linear, covariance=covariance))


def _rows(adjusted, size) -> CornerRows:
    """Linearised at the adjustment, errors of the poses included."""
    chain = adjusted.chain
    values = adjusted.parameters.values
    evaluation = chain.with_families({"pose": adjusted.errors}).evaluate(values)
    rotation = rotation_matrix(values[9:12]) * (1 + values[12])
    by_board = np.einsum("kcn,kj->jcn", evaluation.shared[6:9], rotation)
    board = chain.board if chain.printed is None else chain.printed
    # where the corners are expected: a field over the measured pixels would hold their noise, and explain it
    effects = shared_effects(board, by_board, chain.pixels + evaluation.residual, size)
    point = np.unique(np.round(board[:2], 6), axis=1, return_inverse=True)[1].ravel()
    free = adjusted.parameters.mask
    return CornerRows(
        evaluation.shared[free], evaluation.pose, evaluation.residual, chain.pose, point, effects
    )


def _calibrated(alone: CornerRows) -> np.ndarray:
    """(C, q) change of a camera that is calibrated from the same corners, with all board poses free, by each effect."""
    reduced = without_poses(alone, np.zeros(6))
    flat = reduced.reshape(len(reduced), -1)
    return pseudo_inverse(flat @ flat.T) @ alone.pull(reduced)
