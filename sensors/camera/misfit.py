"""What errors shared by the corners of many images add to the covariance of a camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.camera.corners import Corners
from sensors.camera.shared_effects import shared_effects
from sensors.camera.shared_errors import (
    CornerRows,
    SharedErrors,
    scaled,
    shared_errors,
    without_poses,
)
from sensors.effects.artefact import BoardBow
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.model import Model


@dataclass(frozen=True)
class Misfit:
    """`errors` of the corners that images share; `covariance` (D, D) of the bundle's dense unknowns with them."""

    errors: SharedErrors
    covariance: np.ndarray

    @property
    def significant(self) -> bool:
        return self.errors.significant

    @property
    def sentence(self) -> str:
        return (
            f"corners are displaced by the same in many images (1 sigma: {self.errors.names}), which neither board nor "
            "camera model describe; more images do not average it out, and the stated uncertainties include it"
        )


def bundle_misfit(chain: Corners, fit: BundleFit, effects: Sequence[Effect]) -> Misfit:
    """Of the corners at the solution of a bundle."""
    model = Model(chain, tuple(effects))
    evaluation = model.evaluate(fit.parameters)
    free = fit.parameters.mask
    table = np.empty((int(free.sum()), *evaluation.residual.shape))
    shared = model.fill_rows(evaluation, fit.parameters, table)
    has_bow = any(isinstance(effect, BoardBow) for effect in effects)
    by_board = evaluation.rows("target", np.arange(3))
    # a field over the measured pixels would hold their noise, and explain it
    expected = chain.pixels + evaluation.residual
    rows = CornerRows(
        shared,
        evaluation.family_rows("placement"),
        fit.residual[0],
        chain.labels["placement"],
        chain.labels["corner"],
        shared_effects(chain.points, by_board, expected, chain.camera.size, has_bow),
    )
    rows = scaled(rows, np.sqrt(fit.weights[0]) / chain.sigma)
    sigma = float(np.median(chain.sigma))
    errors = shared_errors(rows, fit.parameters.precision[free], sigma)
    unit = fit.covariance / fit.sigma_scale**2
    influence = unit @ rows.pull(without_poses(rows, np.zeros(6)))
    noise = min(errors.noise / fit.sigma_scale, 1.0)
    added = errors.covariance(influence) + noise**2 * fit.covariance
    return Misfit(errors, _at_least(added, fit.covariance))


def _at_least(covariance, least):
    """With standard deviations that are nowhere below those of another covariance; correlations stay."""
    wider = np.sqrt(np.maximum(np.diag(least) / np.maximum(np.diag(covariance), 1e-300), 1))
    return covariance * np.outer(wider, wider)
