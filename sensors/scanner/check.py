"""A scanner judged by board poses that its light planes were not made from."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sensors.light.board_chain import BoardStripeChain
from sensors.scanner.adjustment import Adjustment, solve_once, stripe_model
from workbench.core.distributions import MEDIAN_TO_SIGMA

_FOLDS = 20
_INLIER = 3.0  # robust sigmas
_MIN_PLACEMENTS = 2  # board poses that a free plane needs


@dataclass(frozen=True)
class LeftOut:
    """Stripes of board poses that were left out: how far they lie from the planes that the others make.

    `residual_px` (n,) along the scan line and `residual_mm` (n,) from the plane, nan where too few
    board poses were left for a plane; robust `rms` of the inliers, those within three robust sigmas,
    and their share; `placement_rms_mm` (G,) of all points of each. The pose of a left-out board pose
    comes from its corners alone.
    """

    folds: int
    residual_px: np.ndarray
    residual_mm: np.ndarray
    inlier: np.ndarray
    placement_rms_mm: np.ndarray

    @property
    def share(self) -> float:
        """Of inliers among all points that could be judged."""
        is_tested = np.isfinite(self.residual_mm)
        return float(self.inlier.sum() / max(is_tested.sum(), 1))

    @property
    def rms_mm(self) -> float:
        """Of the inliers."""
        return _rms(self.residual_mm[self.inlier])

    @property
    def rms_px(self) -> float:
        """Of the inliers."""
        return _rms(self.residual_px[self.inlier])

    @property
    def rms_all_mm(self) -> float:
        """Of every point that could be judged, wrong ones too."""
        return _rms(self.residual_mm[np.isfinite(self.residual_mm)])

    @property
    def sentence(self) -> str:
        return (
            f"held-out board poses, {self.folds} folds: RMS distance of stripe points from their light plane "
            f"{self.rms_mm:.4f} mm ({self.rms_px:.3f} px along the scan line) of the {100 * self.share:.1f} % within "
            f"three robust standard deviations, {self.rms_all_mm:.4f} mm of all points"
        )


def _rms(values):
    return float(np.sqrt((values**2).mean())) if values.size else float("nan")


def leave_out(
    adjustment: Adjustment,
    all_stripes: BoardStripeChain,
    progress: Callable[[str], None] = lambda text: None,
) -> LeftOut | None:
    """Each board pose's stripes left out of the adjustment; in folds where there are more than twenty.

    whole: all stripe points on the board, wrong ones too. None with fewer than three board poses.
    """
    present = np.unique(adjustment.board_stripes.labels["placement"])
    folds = min(_FOLDS, len(present))
    if len(present) < 3:
        return None
    pixels = np.full(all_stripes.n, np.nan)
    millimetres = np.full(all_stripes.n, np.nan)
    for fold in range(folds):
        progress(f"board poses left out, {fold + 1} of {folds}")
        out = np.isin(all_stripes.labels["placement"], present[fold::folds])
        pixels[out], millimetres[out] = _fold_residuals(
            adjustment, all_stripes, present[fold::folds], out
        )
    return _left_out_result(folds, pixels, millimetres, all_stripes)


def _left_out_result(folds, pixels, millimetres, all_stripes):
    is_tested = np.isfinite(millimetres)
    size = np.abs(np.where(is_tested, millimetres, np.inf))
    inlier = (
        size <= _INLIER * MEDIAN_TO_SIGMA * np.median(size[is_tested])
        if is_tested.any()
        else is_tested
    )
    group = all_stripes.labels["placement"][is_tested]
    count = np.bincount(group, minlength=len(all_stripes.poses))
    squares = np.bincount(group, millimetres[is_tested] ** 2, len(all_stripes.poses))
    with np.errstate(invalid="ignore", divide="ignore"):
        return LeftOut(folds, pixels, millimetres, inlier, np.sqrt(squares / count))


def _fold_residuals(adjustment, all_stripes, placements, out):
    """Residuals in px and mm of the points `out` of some board poses, against planes made without them."""
    board_stripes = adjustment.board_stripes
    keep = ~np.isin(board_stripes.labels["placement"], placements)
    training = solve_once(
        adjustment.corners,
        board_stripes.at(keep),
        adjustment.effects,
        adjustment.parameters,
        adjustment.free,
    )
    held_out = replace(all_stripes.at(out), angles=training.board_stripes.angles)
    held_out = held_out.moved(
        training.camera,
        training.board_stripes.poses,
        training.board_stripes.planes,
        training.board_stripes.mirror,
    )
    pixels, millimetres = residuals(training, held_out)
    if board_stripes.mirror is None:
        known = _placements_of(board_stripes.at(keep)) >= _MIN_PLACEMENTS
        unknown = ~known[held_out.labels["step"]]
        pixels[unknown] = millimetres[unknown] = np.nan
    return pixels, millimetres


def _placements_of(board_stripes: BoardStripeChain) -> np.ndarray:
    """(S,) how many board poses each step's plane is seen at."""
    pairs = np.unique(
        np.stack([board_stripes.labels["step"], board_stripes.labels["placement"]]), axis=1
    )
    return np.bincount(pairs[0], minlength=board_stripes.planes.shape[1])


def residuals(
    adjustment: Adjustment, board_stripes: BoardStripeChain
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) px along the scan line and (n,) mm from the plane, of stripe points at an adjustment's solution."""
    model, table = stripe_model(board_stripes, adjustment.effects, adjustment.parameters)
    pixels = model.residual(table)[0]
    return pixels, pixels * board_stripes.gain
