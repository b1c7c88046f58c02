"""Held-out errors: blocks of consecutive poses, never parting what was measured at one standstill."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import wilcoxon

from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solve import solve


@dataclass(frozen=True)
class HeldOut:
    """`residual` (3, n) mm, nan where a sample was never held out; `fold` (n,), -1 there."""

    residual: np.ndarray
    fold: np.ndarray

    @property
    def squares(self) -> np.ndarray:
        """(n,) squared 3-D distances, mm^2."""
        return (self.residual**2).sum(0)

    @property
    def rms(self) -> float:
        """RMS of the 3-D distances, mm."""
        return float(np.sqrt(np.nanmean(self.squares)))

    def falls_from(self, other: "HeldOut") -> np.ndarray:
        """(folds,) fall of the mean square in each fold, mm^2, from `other` before to this after."""
        folds = np.unique(self.fold[self.fold >= 0])
        return np.array([(other.squares - self.squares)[self.fold == k].mean() for k in folds])

    def beats(self, other: "HeldOut") -> bool:
        """Whether the error fell on the whole and, where there are folds enough, in more than luck.

        Luck is judged over the folds, one-sided: the mean gain against its scatter (t > 2), or
        Wilcoxon's signed ranks (5 %), which a single fold with a large gain does not blind.
        """
        falls = self.falls_from(other)
        if not self.rms < other.rms or len(falls) < 5:
            return self.rms < other.rms
        t = falls.mean() / max(falls.std(ddof=1) / np.sqrt(len(falls)), 1e-300)
        return bool(t > 2 or wilcoxon(falls, alternative="greater").pvalue < 0.05)


def blocks(poses: np.ndarray, folds: int) -> np.ndarray:
    """(n,) fold of each sample: consecutive poses in one block, blocks of nearly equal size.

    poses (n,): rows with one value are never parted. Fewer poses than folds: a fold a pose.
    """
    order = {pose: i for i, pose in enumerate(dict.fromkeys(poses.tolist()))}
    place = np.array([order[pose] for pose in poses.tolist()])
    return place * min(folds, len(order)) // len(order)


def cross_validate(model: Model, start: Parameters, fold: np.ndarray, loss: str, steps: int = 50) -> HeldOut:
    """Fit on all folds but one and predict that one, for every fold; start from `start`."""
    residual = np.full((3, len(fold)), np.nan)
    for k in np.unique(fold[fold >= 0]):
        fit = solve(model.at(fold != k), start, loss, steps)
        residual[:, fold == k] = model.at(fold == k).residual(fit.parameters)[:3]
    return HeldOut(residual, fold)


def hold_out(model: Model, start: Parameters, test: np.ndarray, fit_on: np.ndarray, loss: str, steps: int = 50) -> HeldOut:
    """Fit on the samples `fit_on` (n,) bool and predict those of `test` (n,) bool."""
    fit = solve(model.at(fit_on), start, loss, steps)
    residual = np.full((3, len(test)), np.nan)
    residual[:, test] = model.at(test).residual(fit.parameters)[:3]
    return HeldOut(residual, np.where(test, 0, -1))


def error_summary(residual: np.ndarray) -> dict[str, float]:
    """RMS, mean, 95 % and max of 3-D distances (3, n) mm, ignoring nan."""
    distance = np.sqrt((residual**2).sum(0))
    distance = distance[np.isfinite(distance)]
    if not distance.size:
        return dict.fromkeys(("rms_mm", "mean_mm", "p95_mm", "max_mm"), float("nan"))
    return {
        "rms_mm": float(np.sqrt((distance**2).mean())),
        "mean_mm": float(distance.mean()),
        "p95_mm": float(np.percentile(distance, 95)),
        "max_mm": float(distance.max()),
    }
