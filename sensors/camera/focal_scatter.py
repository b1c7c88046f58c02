"""Whether the focal length differs from board pose to board pose: a lens that is focused again, or a loose one.

One focal length is fitted to all board poses. Each board pose determines a change of it by the perspective of its
tilted board, once the six numbers of the pose and the camera are estimated too. These changes scatter by more than
their own standard uncertainty where the focal length is not constant: a random effect of the board pose.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from workbench.core.distributions import fisher
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.model import Model

_LEVEL = 1e-6  # corners of one image share small errors, which make the test too sharp
_RELEVANT = 1.0  # of the noise of a corner's coordinate, RMS displacement of corners by the scatter
_POSE = 6
_FEWEST_POSES = 4
_DETERMINED = (
    1e-9  # of the best determined board pose, below which a pose determines no focal length
)
_NONE = 1e-9  # relative focal length that is none
_RIDGE = 1e-12


@dataclass(frozen=True)
class FocalScatter:
    """Random effect of the board pose on the focal length.

    `share` 1 sigma, relative, with its standard error `share_std`; `shift_px` RMS displacement of corners by it, and
    `visible_px` its part that no change of the board poses makes; `noise_px` 1 sigma of a coordinate, from what the
    changes leave; `p_value` of an F test that all board poses have one focal length; `changes` (G,) relative change in
    each board pose that determines one, with `std` (G,) conditional on the camera.
    """

    share: float
    share_std: float
    shift_px: float
    visible_px: float
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
    reduced = ReducedCorners.of(chain, fit, effects)
    groups = len(reduced.focal) - 1
    degrees = reduced.degrees
    if groups < _FEWEST_POSES - 1 or degrees < 1:
        return None
    squares_common = reduced.squares()
    squares_individual = reduced.squares(np.inf)
    variance = squares_individual / degrees
    p_value = float(
        fisher.sf((squares_common - squares_individual) / groups / variance, groups, degrees)
    )
    share, share_std = reduced.most_probable_scatter(variance)
    changes, std = reduced.changes(variance)
    middle = np.array([[chain.camera.cx], [chain.camera.cy]])
    reach = float(np.sqrt(((chain.pixels - middle) ** 2).mean()))
    noise = float(np.sqrt((np.asarray(chain.sigma) ** 2).mean()))
    shift_px = share * noise * float(np.sqrt(reduced.focal.sum() / chain.pixels.size))
    summary = (share, share_std, share * reach, shift_px, noise * float(np.sqrt(variance)), p_value)
    return FocalScatter(*summary, changes, std)


@dataclass(frozen=True)
class ReducedCorners:
    """Sums of squares and products of corners in units of their noise, once the pose of each board is estimated.

    `gram` (K + 1, K + 1) of K derivatives by the camera and by effects, and of the residual; `by_focal` (G, K + 1) of
    these with the derivative by the relative focal length in each of G board poses, `focal` (G,) of the latter with
    itself; `count` coordinates less parameters of the poses.
    """

    gram: np.ndarray
    by_focal: np.ndarray
    focal: np.ndarray
    count: int

    @classmethod
    def of(cls, chain: Corners, fit: BundleFit, effects: tuple[Effect, ...]) -> "ReducedCorners":
        """At the solution of a bundle; effects that it does not hold stand at their null."""
        rows, focal, poses = _whitened(chain, fit, effects)
        gram = 0.0
        by_focal = []
        squares = []
        for g in range(len(chain.poses)):
            is_of_board_pose = chain.labels["placement"] == g
            of_pose = poses[:, :, is_of_board_pose].reshape(_POSE, -1).T
            basis = np.linalg.qr(of_pose / np.linalg.norm(of_pose, axis=0))[0]
            joined = np.concatenate(
                [rows[:, :, is_of_board_pose], focal[None, :, is_of_board_pose]]
            )
            joined = joined.reshape(len(joined), -1).T
            joined = joined - basis @ (basis.T @ joined)
            gram = gram + joined[:, :-1].T @ joined[:, :-1]
            by_focal.append(joined[:, :-1].T @ joined[:, -1])
            squares.append(float(joined[:, -1] @ joined[:, -1]))
        squares = np.array(squares)
        usable = squares > _DETERMINED * squares.max(initial=0.0)
        count = chain.pixels.size - _POSE * len(squares)
        return cls(gram, np.array(by_focal)[usable], squares[usable], count)

    @property
    def degrees(self) -> int:
        """Degrees of freedom that a focal length of each board pose leaves."""
        return self.count - (len(self.gram) - 1) - (len(self.focal) - 1)

    def with_spread(self, spread: float) -> np.ndarray:
        """The Gram matrix (K + 1, K + 1) where focal lengths have a random error of so many units; inf: free."""
        share = 1 / self.focal if np.isinf(spread) else 1 / (spread**-2.0 + self.focal)
        return self.gram - (self.by_focal.T * share) @ self.by_focal

    def squares(self, spread: float = _NONE) -> float:
        """Sum of squares that the camera and the effects leave."""
        gram = self.with_spread(spread)
        return float(gram[-1, -1] + gram[-1, :-1] @ _solved(gram))

    def changes(self, variance: float) -> tuple[np.ndarray, np.ndarray]:
        """(G,) relative change of the focal length in each board pose, and its standard uncertainty."""
        solution = np.append(_solved(self.with_spread(np.inf)), 1.0)
        return -(self.by_focal @ solution) / self.focal, np.sqrt(variance / self.focal)

    def most_probable_scatter(self, variance: float) -> tuple[float, float]:
        """1 sigma of the relative focal length by restricted maximum likelihood, and its standard error.

        Patterson & Thompson, Biometrika 58 (1971) 545.
        """
        unit = float(np.sqrt(variance))

        def deviance(log_spread):
            spread = np.exp(log_spread)
            gram = self.with_spread(spread)
            scale = np.sqrt(np.diag(self.gram)[:-1]).clip(1e-300)
            scaled = gram[:-1, :-1] / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
            of_camera = np.linalg.slogdet(scaled)[1]
            return (
                np.log1p(spread**2 * self.focal).sum() + of_camera + self.squares(spread) / variance
            )

        widest = max(float(np.abs(self.changes(variance)[0]).max()), _NONE) / unit
        bounds = np.log(_NONE), np.log(10 * widest)
        spread = float(np.exp(minimize_scalar(deviance, bounds=bounds, method="bounded").x))
        # Fisher information of the variance of a random effect with known errors
        information = 0.5 * float(((spread**2 + 1 / self.focal) ** -2).sum())
        return spread * unit, 0.5 / (spread * float(np.sqrt(information))) * unit


def _solved(gram: np.ndarray) -> np.ndarray:
    """(K,) parameters that make the residual least."""
    normal_matrix = gram[:-1, :-1]
    right_side = gram[:-1, -1]
    scale = np.sqrt(np.diag(normal_matrix).clip(1e-300))
    scaled = normal_matrix / np.outer(scale, scale)
    solution, *_ = np.linalg.lstsq(scaled, right_side / scale, rcond=_RIDGE)
    return -solution / scale


def _whitened(chain: Corners, fit: BundleFit, effects):
    """Over sigma: derivatives (K, 2, n) by camera and effects with the residual as last row, (2, n) by the relative
    focal length, and (6, 2, n) by the pose."""
    model = Model(chain, tuple(effects))
    table = model.parameters.take_over(fit.parameters)
    is_free = [key in fit.table.keys or key.count(".") > 1 for key in table.keys]
    residual, rows = model.linearise(table.only(np.array(is_free)))
    evaluation = model.evaluate(table)
    sigma = np.broadcast_to(chain.sigma, residual.shape)
    whitened_rows = np.concatenate([rows, residual[None]]) / sigma
    focal = by_focal_length(chain.camera, evaluation) / sigma
    return whitened_rows, focal, evaluation.family_rows("placement") / sigma


def by_focal_length(camera: Camera, evaluation) -> np.ndarray:
    """(m, n) px, derivative of the residuals of an evaluation by the relative focal length."""
    by_fx, by_fy = evaluation.own_rows(np.array([0, 1]))
    return camera.fx * by_fx + camera.fy * by_fy
