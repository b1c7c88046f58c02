"""Held-out errors: blocks of consecutive poses, never parting what was measured at one standstill."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import wilcoxon

from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solve import solve
from workbench.shrinkage import settled


@dataclass(frozen=True)
class HeldOut:
    """`residual` (3, n) mm, nan where a sample was never held out; `fold` (n,), -1 there.

    `located`: key -> value (mm) of what no fitted sample shows, such as a reflector that is only in
    the held-out samples. It can only come from those; their error is that much too small, as
    each value takes one of their 3 n degrees of freedom.
    """

    residual: np.ndarray
    fold: np.ndarray
    located: Mapping[str, float] = field(default_factory=dict)

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


def cross_validate(
    model: Model, start: Parameters, fold: np.ndarray, loss: str, steps: int = 50, settle: bool = False
) -> HeldOut:
    """Fit on all folds but one and predict that one, for every fold; start from `start`.

    settle: every fit finds by itself how large effects of one kind are (`workbench.shrinkage`).
    """
    residual, located = np.full((3, len(fold)), np.nan), {}
    for k in np.unique(fold[fold >= 0]):
        residual[:, fold == k], found = _predict(model, start, fold == k, (fold >= 0) & (fold != k), loss, steps,
                                                settle)  # fmt: skip
        located |= found
    return HeldOut(residual, fold, located)


def hold_out(
    model: Model, start: Parameters, test: np.ndarray, fit_on: np.ndarray, loss: str, steps: int = 50,
    settle: bool = False,
) -> HeldOut:  # fmt: skip
    """Fit on the samples `fit_on` (n,) bool and predict those of `test` (n,) bool; settle as above."""
    residual = np.full((3, len(test)), np.nan)
    residual[:, test], located = _predict(model, start, test, fit_on, loss, steps, settle)
    return HeldOut(residual, np.where(test, 0, -1), located)


def _predict(model, start, test, fit_on, loss, steps, settle):
    """Residual (3, tested) of a fit on other samples, and what had to be located on the tested ones."""
    known, seen = model.at(fit_on), model.at(test)
    fit = solve(known, start, loss, steps)
    fitted = (settled(known, fit, loss, steps) if settle else fit).parameters
    unseen = _unseen(known, seen, fitted)
    if unseen.any():
        placed = solve(seen, fitted.only(unseen), loss, steps).parameters
        fitted = replace(fitted, values=placed.values)
    located = {key: fitted[key] for key, mine in zip(fitted.keys, unseen) if mine}
    return in_space(seen.residual(fitted)), located


def _unseen(fitted_on: Model, seen: Model, parameters: Parameters) -> np.ndarray:
    """(P,) True for places on tool or artefact that the fitted samples do not touch and the tested ones do."""
    own = np.arange(len(parameters)) < len(fitted_on.chain.parameters)
    placed = [np.char.startswith(parameters.keys, where) for where in ("tool.", "artefact.")]
    places = parameters.only(own & (placed[0] | placed[1]))
    if not places.mask.any():
        return places.mask
    silent = ~fitted_on.linearise(places)[1].any(axis=(1, 2))
    silent &= seen.linearise(places)[1].any(axis=(1, 2))
    unseen = places.mask.copy()
    unseen[places.mask] = silent
    return unseen


def in_space(residual: np.ndarray) -> np.ndarray:
    """(3, n) mm: the lengths among a residual's components (m, n), with zeros where a kind has fewer than three."""
    return np.concatenate([residual[:3], np.zeros((max(3 - len(residual), 0), residual.shape[1]))])


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


def repeat_summary(recording, residual: np.ndarray) -> dict[str, float]:
    """Lack of fit against pure error where one pose was measured again: {} without a column `repeat`.

    `repeat_means_rms_mm`: RMS distance of the means over repeats, what the model misses;
    `pure_error_rms_mm`: RMS distance of single rows from their mean, what no model can explain.
    """
    if "repeat" not in recording.columns:
        return {}
    pairs = np.stack([recording.columns["repeat"], recording.reflector], 1)
    _, group = np.unique(pairs, axis=0, return_inverse=True)
    counts = np.bincount(group.ravel())
    means = np.stack([np.bincount(group.ravel(), row) for row in residual]) / counts
    scatter = ((residual - means[:, group.ravel()]) ** 2).sum() / max(len(group) - len(counts), 1)
    return {
        "repeat_means_rms_mm": float(np.sqrt((means**2).sum(0).mean())),
        "pure_error_rms_mm": float(np.sqrt(scatter)),
    }
