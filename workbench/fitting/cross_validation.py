"""Held-out errors: blocks of consecutive poses; all measurements of one static pose share a block."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from workbench.core.distributions import signed_rank_sf
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.priors.shrinkage import settled

# Below a nanometre and a nanoradian a change of the error is rounding, whatever the recording states.
_ROUNDING = (1e-6, 1e-9)
_MATERIAL = 0.1  # of a mean square: 5 % of the RMS, more than a simpler model is worth
_STEPS = 50  # of a solve, at most
_CARRIED, _MAX_SHARE = (
    0.5,
    0.1,
)  # share of the mean square that few samples carry, and share of all that they are at most


@dataclass(frozen=True)
class HeldOut:
    """Residuals of held-out samples: predicted minus measured, nan where a sample was never held out.

    `residual` (m, n): the first three rows are the position in mm. Where poses are measured, further
    rows are components of the rotation vector from measured to predicted orientation, in rad (three
    for a full orientation, two for one axis). `fold` (n,): -1 where never held out. `sigma` (m, n):
    the stated 1 sigma of each component, None where the recording states none.

    `located`: key -> value (mm) of what no fitted sample shows, such as a reflector that is only in
    the held-out samples. It can only come from those; their error is that much too small, as
    each value takes one of their 3 n degrees of freedom.
    """

    residual: np.ndarray
    fold: np.ndarray
    located: Mapping[str, float] = field(default_factory=dict)
    sigma: np.ndarray | None = None

    @property
    def position(self) -> np.ndarray:
        """(3, n) residual of the position, mm."""
        return self.residual[:3]

    @property
    def rotation(self) -> np.ndarray:
        """(k, n) residual of the orientation, rad; k = 0 where only positions are measured."""
        return self.residual[3:]

    @property
    def squares(self) -> np.ndarray:
        """(n,) squared 3-D distances, mm^2."""
        return (self.position**2).sum(0)

    @property
    def rms(self) -> float:
        """RMS of the 3-D distances, mm."""
        return float(np.sqrt(np.nanmean(self.squares)))

    @property
    def rotation_rms(self) -> float | None:
        """RMS of the rotation angles, rad; None where only positions are measured."""
        if not len(self.rotation):
            return None
        return float(np.sqrt(np.nanmean((self.rotation**2).sum(0))))

    def change_from(self, other: "HeldOut") -> str:
        """'0.0600 -> 0.0210 mm' and, where orientation is measured, ', 0.0100 -> 0.0031 deg' (RMS)."""
        words = f"{other.rms:.4f} -> {self.rms:.4f} mm"
        if self.rotation_rms is None or other.rotation_rms is None:
            return words
        before, after = np.rad2deg([other.rotation_rms, self.rotation_rms])
        return f"{words}, {before:.4f} -> {after:.4f} deg"

    def falls_from(self, other: "HeldOut") -> np.ndarray:
        """(folds,) fall of the mean square error in each fold, from `other` before to this after.

        Squares of position and orientation are each divided by the noise level of their kind in
        `other` (`_noise_squares`) and added, so that the result is dimensionless. A gain in one kind
        is at most 1; an orientation whose RMS grows by more than sqrt(2) outweighs any gain in position.
        """
        levels = other._noise_squares()
        before, after = other._squares_by_kind(), self._squares_by_kind()
        falls = sum((b - a) / level for b, a, level in zip(before, after, levels))
        folds = np.unique(self.fold[self.fold >= 0])
        return np.array([falls[self.fold == k].mean() for k in folds])

    def beats(self, other: "HeldOut") -> bool:
        """Whether the error fell on the whole and, where there are folds enough, in more than luck.

        Position and orientation are judged together, as of `falls_from`. Luck is judged over the
        folds, one-sided: the mean gain against its scatter (t > 2), or Wilcoxon's signed ranks
        (5 %), which a single fold with a large gain does not blind.
        """
        falls = self.falls_from(other)
        is_lower = self._mean_fall_from(other) > 0
        if not is_lower or len(falls) < 5:
            return is_lower
        t = falls.mean() / max(falls.std(ddof=1) / np.sqrt(len(falls)), 1e-300)
        if t > 2:
            return True
        return signed_rank_sf(falls) < 0.05

    def is_materially_worse_than(self, other: "HeldOut") -> bool:
        """Whether the mean square is larger by more than `_MATERIAL` of it, whichever folds that comes from.

        A model that fails in a single fold is no better than luck by the test of `beats`, and still not one to use.
        """
        return self._mean_fall_from(other) < -_MATERIAL

    def _mean_fall_from(self, other: "HeldOut") -> float:
        """Fall of the mean square over all held-out samples; units as of `falls_from`."""
        levels = other._noise_squares()
        before, after = other._squares_by_kind(), self._squares_by_kind()
        means = [np.nanmean(b) - np.nanmean(a) for b, a in zip(before, after)]
        return float(sum(mean / level for mean, level in zip(means, levels)))

    def _squares_by_kind(self) -> list[np.ndarray]:
        """(n,) squared distances, mm^2, and (n,) squared angles, rad^2, where orientation is measured."""
        errors = [self.position, self.rotation]
        return [(part**2).sum(0) for part in errors if len(part)]

    def _noise_squares(self) -> list[float]:
        """Noise level of each kind, mm^2 and rad^2: the mean square error or, if larger, the stated one.

        Changes far below the stated noise are no evidence for or against a model.
        """
        levels = []
        for rows, squares, rounding in zip(
            (slice(0, 3), slice(3, None)), self._squares_by_kind(), _ROUNDING
        ):
            if self.sigma is None:
                stated = 0.0
            else:
                stated = float((self.sigma[rows] ** 2).sum(0).mean())
            levels.append(max(float(np.nanmean(squares)), stated, rounding**2))
        return levels


@dataclass(frozen=True)
class Split:
    """Which samples may be fitted (n,) bool, the folds among them, and the samples only tested."""

    fit: np.ndarray
    fold: np.ndarray
    test: np.ndarray

    def only(self, samples: np.ndarray) -> "Split":
        """The same split with only some samples, (n,) bool, in the fit and in the folds."""
        return Split(self.fit & samples, np.where(samples, self.fold, -1), self.test)


def samples_of_some_poses(poses: np.ndarray, samples: np.ndarray, max_count: int) -> np.ndarray:
    """(n,) True for about `max_count` of some samples, (n,) bool: those of one of every k consecutive poses.

    Which of the k is random, always the same for one recording: poses that alternate, such as approaches from either
    side, are all represented. The measurements of one pose stay together.
    """
    step = -(-int(samples.sum()) // max_count)
    if step <= 1:
        return samples.copy()
    order = np.array(list(dict.fromkeys(poses[samples].tolist())))
    first = np.arange(0, len(order), step)
    chosen = first + np.random.default_rng(0).integers(0, step, len(first))
    return samples & np.isin(poses, order[np.minimum(chosen, len(order) - 1)])


def blocks(poses: np.ndarray, folds: int) -> np.ndarray:
    """(n,) fold of each sample: consecutive poses in one block, blocks of nearly equal size.

    poses (n,): rows with one value are never parted. Fewer poses than folds: a fold a pose.
    """
    order = {pose: i for i, pose in enumerate(dict.fromkeys(poses.tolist()))}
    place = np.array([order[pose] for pose in poses.tolist()])
    return place * min(folds, len(order)) // len(order)


def cross_validate(
    model: Model,
    start: Parameters,
    fold: np.ndarray,
    loss: str,
    steps: int = 50,
    settle: bool = False,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> HeldOut:
    """Fit on all folds but one and predict that one, for every fold; start from `start`.

    settle: every fit finds by itself how large effects of one kind are (`priors.shrinkage`). tick: called
    with the numbers of finished and of all folds after every fold.
    """
    residual, located = no_residual(model), {}
    numbers = np.unique(fold[fold >= 0])
    for done, k in enumerate(numbers, 1):
        test = fold == k
        fit_on = (fold >= 0) & (fold != k)
        residual[:, test], found = _predict(model, start, test, fit_on, loss, steps, settle)
        located |= found
        tick(done, len(numbers))
    return HeldOut(residual, fold, located, stated_sigma(model))


def hold_out(
    model: Model,
    start: Parameters,
    test: np.ndarray,
    fit_on: np.ndarray,
    loss: str,
    steps: int = _STEPS,
    settle: bool = False,
) -> HeldOut:
    """Fit on the samples `fit_on` (n,) bool and predict those of `test` (n,) bool; settle as above."""
    residual = no_residual(model)
    residual[:, test], located = _predict(model, start, test, fit_on, loss, steps, settle)
    return HeldOut(residual, np.where(test, 0, -1), located, stated_sigma(model))


def predict_test(
    model: Model, fitted: Parameters, test: np.ndarray, fit_on: np.ndarray, loss: str
) -> HeldOut:
    """Predict the samples of `test` (n,) bool with parameters that were fitted on those of `fit_on` (n,) bool.

    Only places on tool or artefact that the fitted samples do not touch are located.
    """
    residual = no_residual(model)
    residual[:, test], located = _placed(model.part(fit_on), model.part(test), fitted, loss, _STEPS)
    return HeldOut(residual, np.where(test, 0, -1), located, stated_sigma(model))


def no_residual(model: Model) -> np.ndarray:
    """(m, n) nan, with at least the three rows of a position."""
    components, samples = model.chain.sigma.shape
    return np.full((max(components, 3), samples), np.nan)


def stated_sigma(model: Model) -> np.ndarray | None:
    """(m, n) 1 sigma as the recording states it; None where it states none."""
    chain = model.chain
    return None if chain.sigma_unknown else chain.stated_sigma


def _predict(model, start, test, fit_on, loss, steps, settle):
    """Residual (3, tested) of a fit on other samples, and what had to be located on the tested ones."""
    known = model.part(fit_on)
    fit = solve(known, start, loss, steps, with_shares=False)
    if settle:
        fit = settled(known, fit, loss, steps, with_shares=False)
    fitted = fit.parameters
    return _placed(known, model.part(test), fitted, loss, steps)


def _placed(known, seen, fitted, loss, steps):
    """Residual and located places, as of `_predict`, of a model that was fitted on the samples of `known`."""
    unseen = _unseen(known, seen, fitted)
    if unseen.any():
        placed = solve(seen, fitted.only(unseen), loss, steps).parameters
        fitted = replace(fitted, values=placed.values)
    located = {key: fitted[key] for key, is_unseen in zip(fitted.keys, unseen) if is_unseen}
    return pad_to_position(seen.residual(fitted)), located


def _unseen(fitted_on: Model, seen: Model, parameters: Parameters) -> np.ndarray:
    """(P,) True for places on tool or artefact that the fitted samples do not touch and the tested ones do."""
    places = parameters.only(places_of_target(fitted_on, parameters))
    if not places.mask.any():
        return places.mask
    silent = ~fitted_on.linearise(places)[1].any(axis=(1, 2))
    silent &= seen.linearise(places)[1].any(axis=(1, 2))
    unseen = places.mask.copy()
    unseen[places.mask] = silent
    return unseen


def places_of_target(model: Model, parameters: Parameters) -> np.ndarray:
    """(P,) True for the chain's parameters that place what is measured on the tool or the artefact."""
    is_of_chain = np.arange(len(parameters)) < len(model.chain.parameters)
    placed = [np.char.startswith(parameters.keys, where) for where in ("tool.", "artefact.")]
    return is_of_chain & (placed[0] | placed[1])


def pad_to_position(residual: np.ndarray) -> np.ndarray:
    """A residual (m, n) with rows of zeros up to three where a kind measures fewer lengths (mm) than three."""
    missing = max(3 - len(residual), 0)
    return np.concatenate([residual, np.zeros((missing, residual.shape[1]))])


def in_space(residual: np.ndarray) -> np.ndarray:
    """(3, n) mm: the lengths among a residual's components (m, n), with zeros where a kind has fewer than three."""
    return pad_to_position(residual)[:3]


def in_rotation(residual: np.ndarray) -> np.ndarray:
    """(k, n) rad: the components of the rotation among a residual's (m, n); k = 0 where none is measured."""
    return residual[3:]


def error_summary(residual: np.ndarray) -> dict[str, float]:
    """RMS, mean, 95 % and max of the errors of a residual (m, n), ignoring nan.

    Of 3-D distances in mm (`rms_mm`, `mean_mm`, `p95_mm`, `max_mm`) and, where the residual has rows
    of a rotation vector (rad) after the first three, of rotation angles (`rotation_rms_deg`,
    `rotation_mean_deg`, `rotation_p95_deg`, `rotation_max_deg`).
    """
    distance = np.sqrt((residual[:3] ** 2).sum(0))
    summary = {f"{name}_mm": value for name, value in _statistics(distance).items()}
    rotation = in_rotation(residual)
    if len(rotation):
        angle = np.rad2deg(np.sqrt((rotation**2).sum(0)))
        summary |= {f"rotation_{name}_deg": value for name, value in _statistics(angle).items()}
    return summary


def _statistics(size: np.ndarray) -> dict[str, float]:
    """RMS, mean, 95th percentile and maximum of sizes (n,), ignoring nan."""
    size = size[np.isfinite(size)]
    if not size.size:
        return dict.fromkeys(("rms", "mean", "p95", "max"), float("nan"))
    return {
        "rms": float(np.sqrt((size**2).mean())),
        "mean": float(size.mean()),
        "p95": float(np.percentile(size, 95)),
        "max": float(size.max()),
    }


def carrying_samples(residual: np.ndarray) -> np.ndarray:
    """Rows of the samples that make half of the mean square of distances (m, n) where these are at most a tenth."""
    squares = np.nan_to_num((residual[:3] ** 2).sum(0))
    order = np.argsort(-squares)
    shares = np.cumsum(squares[order]) / max(squares.sum(), 1e-300)
    count = int(np.searchsorted(shares, _CARRIED)) + 1
    return order[:count] if count <= _MAX_SHARE * np.isfinite(residual[0]).sum() else order[:0]


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
