"""Covariance of a camera from errors that the corners of many images share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.corners import Corners
from sensors.camera.correlated_errors.displaced_lines import DisplacedLine
from sensors.camera.correlated_errors.shared_effects import shared_effects
from sensors.camera.correlated_errors.shared_errors import (
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

_FEWEST_IMAGES = 3  # in most of which a point has to be far off, to be wrong itself


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
    free = fit.parameters.mask
    rows = replace(_corner_rows(chain, fit, effects), residual=fit.residual[0])
    rows = scaled(rows, np.sqrt(fit.weights[0]) / chain.sigma)
    sigma = float(np.median(chain.sigma))
    errors = shared_errors(rows, fit.parameters.precision[free], sigma)
    unit = fit.covariance / fit.sigma_scale**2
    influence = unit @ rows.pull(without_poses(rows, np.zeros(6)))
    noise = min(errors.noise / fit.sigma_scale, 1.0)
    added = errors.covariance(influence) + noise**2 * fit.covariance
    return Misfit(errors, _at_least(added, fit.covariance))


def lines_left_out(
    all_corners: Corners, chain: Corners, fit: BundleFit, effects: Sequence[Effect]
) -> tuple[DisplacedLine, ...]:
    """Displaced lines of the board whose corners contradict all others, so that the fit was made without them.

    all_corners: all corners of the images, at the solution; chain: those that were fitted. A blunder is one of a single
    image. A point that is left out in most of the images that show it is printed at another place.
    """
    count = int(all_corners.labels["corner"].max()) + 1
    of_whole, of_chain = (
        corners.labels["view"] * count + corners.labels["corner"]
        for corners in (all_corners, chain)
    )
    out = ~np.isin(of_whole, of_chain)
    point = all_corners.labels["corner"]
    seen = np.bincount(point)
    lost = np.bincount(point, out)
    of_board = ((seen >= _FEWEST_IMAGES) & (lost > seen / 2))[point]
    if not of_board.any():
        return ()
    usable = all_corners.at(~out | of_board)
    rows = scaled(_corner_rows(usable, fit, effects), 1 / usable.sigma)
    sigma = float(np.median(usable.sigma))
    errors = shared_errors(rows, fit.parameters.precision[fit.parameters.mask], sigma)
    return errors.lines if errors.significant else ()


def _corner_rows(chain: Corners, fit: BundleFit, effects: Sequence[Effect]) -> CornerRows:
    """Of corners (px) at the parameters of a fit, which these corners need not have been in."""
    model = Model(chain, tuple(effects))
    evaluation = model.evaluate(fit.parameters)
    table = np.empty((int(fit.parameters.mask.sum()), *evaluation.residual.shape))
    shared = model.fill_rows(evaluation, fit.parameters, table)
    has_bow = any(isinstance(effect, BoardBow) for effect in effects)
    by_board = evaluation.rows("target", np.arange(3))
    # a field over the measured pixels would hold their noise, and explain it
    expected = chain.pixels + evaluation.residual
    return CornerRows(
        shared,
        evaluation.family_rows("placement"),
        evaluation.residual,
        chain.labels["placement"],
        chain.labels["corner"],
        shared_effects(chain.points, by_board, expected, chain.camera.size, has_bow),
    )


def _at_least(covariance, minimum):
    """With standard deviations that are nowhere below those of another covariance; correlations stay."""
    wider = np.sqrt(np.maximum(np.diag(minimum) / np.maximum(np.diag(covariance), 1e-300), 1))
    return covariance * np.outer(wider, wider)
