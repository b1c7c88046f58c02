"""Whether the focal length differs from board pose to board pose: a lens that is focused again, or a loose one.

One focal length is fitted to all board poses. Each board pose alone determines a change of it by the perspective of
its tilted board, once the six numbers of the pose are estimated too. These changes scatter by more than their own
standard uncertainty where the focal length is not constant: a random effect of the board pose.
"""

from dataclasses import dataclass

import numpy as np

from sensors.camera.corners import Corners
from workbench.core.distributions import fisher
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.model import Model

_LEVEL = 1e-6  # corners of one image share small errors, which make the test too sharp
_RELEVANT = 1.0  # of the noise of a corner's coordinate, RMS displacement of corners by the scatter
_POSE = 6
_FEWEST_POSES = 4


@dataclass(frozen=True)
class FocalScatter:
    """Random effect of the board pose on the focal length.

    `share` 1 sigma, relative; `shift_px` RMS displacement of corners by it; `noise_px` 1 sigma of a coordinate;
    `p_value` of an F test that all board poses have one focal length; `changes` (G,) relative change in each board
    pose with `std` (G,).
    """

    share: float
    shift_px: float
    noise_px: float
    p_value: float
    changes: np.ndarray
    std: np.ndarray

    @property
    def significant(self) -> bool:
        """Whether the scatter is significant and displaces corners by more than their noise."""
        return self.p_value < _LEVEL and self.shift_px > _RELEVANT * self.noise_px

    @property
    def sentence(self) -> str:
        """Size, meaning and what to do."""
        return (
            f"the focal length differs from board pose to board pose by {100 * self.share:.2g} % (1 sigma, "
            f"{self.shift_px:.2g} px at the corners; chance does so with probability {self.p_value:.1g}): the lens "
            "breathes while it focuses, is loose, or looks through a tilted window. No stated uncertainty holds this "
            "error: lock focus and zoom, remove the window, and take the images again"
        )


def focal_scatter(
    chain: Corners, fit: BundleFit, effects: tuple[Effect, ...]
) -> FocalScatter | None:
    """Of corners at the solution of a bundle; None where there are too few board poses."""
    if len(chain.poses) < _FEWEST_POSES:
        return None
    by_focal, by_pose, residual = _whitened(chain, fit, effects)
    parts = [
        _change(by_focal[:, mine], by_pose[:, :, mine], residual[:, mine])
        for mine in (chain.labels["placement"] == g for g in range(len(chain.poses)))
    ]
    change, information, squares, spare = np.array(parts).T
    degrees = float(np.maximum(spare, 0).sum())
    is_usable = information > 1e-9 * information.max(initial=0.0)
    if is_usable.sum() < _FEWEST_POSES or degrees < 1:
        return None
    variance = squares.sum() / degrees
    return _tested(chain, fit, (change, information, is_usable), variance, degrees)


def _whitened(chain: Corners, fit: BundleFit, effects):
    """Derivatives (2, n) by the relative focal length and (6, 2, n) by the pose, and residuals (2, n), over sigma."""
    model = Model(chain, tuple(effects))
    here = model.evaluate(model.parameters.take_over(fit.parameters))
    camera = chain.camera
    by_fx, by_fy = here.own_rows(np.array([0, 1]))
    by_focal = camera.fx * by_fx + camera.fy * by_fy
    sigma = np.broadcast_to(chain.sigma, by_focal.shape)
    return by_focal / sigma, here.family_rows("placement") / sigma, here.residual / sigma


def _change(by_focal, by_pose, residual) -> tuple[float, float, float, int]:
    """Change of one board pose, its information, sum of squares that is remainder, and its degrees of freedom."""
    pose = by_pose.reshape(_POSE, -1).T
    basis = np.linalg.qr(pose / np.linalg.norm(pose, axis=0))[0]
    column, target = by_focal.ravel(), residual.ravel()
    column = column - basis @ (basis.T @ column)
    target = target - basis @ (basis.T @ target)
    information = float(column @ column)
    change = -float(column @ target) / max(information, 1e-300)
    remainder = target + change * column
    return change, information, float(remainder @ remainder), target.size - _POSE - 1


def _tested(chain, fit, estimates, variance, degrees) -> FocalScatter:
    """Method of moments: DerSimonian and Laird, Controlled Clinical Trials 7 (1986); F test of equal changes."""
    change, information, is_usable = estimates
    weight = np.where(is_usable, information, 0.0) / variance
    deviation = change - np.average(change, weights=weight)
    statistic = float(weight @ deviation**2)
    groups = int(is_usable.sum()) - 1
    p_value = float(fisher.sf(statistic / groups, groups, degrees))
    unit = weight.sum() - (weight**2).sum() / weight.sum()
    share = float(np.sqrt(max(statistic - groups, 0.0) / unit))
    camera = chain.camera
    middle = np.array([[camera.cx], [camera.cy]])
    reach = float(np.sqrt(((chain.pixels - middle) ** 2).mean()))
    noise = float(np.sqrt((np.asarray(chain.sigma) ** 2).mean() * variance))
    std = np.where(is_usable, np.sqrt(1 / np.maximum(weight, 1e-300)), np.inf)
    return FocalScatter(share, share * reach, noise, p_value, change, std)
