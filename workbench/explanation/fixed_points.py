"""Reflectors that do not move with the arm: the drift that they measure and the drift found without them.

They enter no fit of a diagnosis. Where the base drifts, they drift with it, so that they say independently whether
the law that was found is right, and by how much it may be wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robot_model.effects import CATALOGUE
from workbench.core.covariates import clock
from workbench.core.least_squares.linear_algebra import inverse_positive
from workbench.core.least_squares.solver import pose_scores
from workbench.core.rigid import rotation_matrix
from workbench.diagnosis.robot.library import variants
from workbench.explanation.result import Term
from workbench.explanation.sentences.words import length, listed

_PART, _MIN_SAMPLES = (
    0.2,
    10,
)  # first and last part of the recording that are compared, and rows that each must have
_SIGMAS = 3.0


@dataclass(frozen=True)
class FixedPoints:
    """Motion of fixed reflectors from the first to the last fifth of a recording, mm, in the instrument's frame.

    `measured` (3,) and its `std` (3,) from the scatter; `found`, `found_std` (3,) what the base's drift in the model
    makes of the same points, None where no drift was found. `reflectors`: their numbers.
    """

    reflectors: tuple[int, ...]
    measured: np.ndarray
    std: np.ndarray
    found: np.ndarray | None
    found_std: np.ndarray | None

    @property
    def agrees(self) -> bool | None:
        """Whether what was found is within three standard errors of what was measured."""
        if self.found is None:
            return None
        return bool(self._agrees_by_axis().all())

    @property
    def sentence(self) -> str:
        """Sentence on the drift that the fixed reflectors show."""
        movement = _um(self.measured, self.std)
        sentence = (
            f"{len(self.reflectors)} fixed reflectors, which no fit has used, moved by {movement} µm from the first to "
            "the last fifth of the recording"
        )
        if self.found is None:
            return f"{sentence} ({length(float(np.linalg.norm(self.measured)))}); no drift of the base was claimed."
        found = _um(self.found, self.found_std)
        free = "found without them, with links and joints free to warm as well,"
        return f"{sentence}; the drift that was {free} says {found} µm: {self._verdict()}."

    def _verdict(self) -> str:
        deviating = [
            name for name, is_within in zip("xyz", self._agrees_by_axis()) if not is_within
        ]
        if not deviating:
            return "they agree"
        return (
            f"they disagree in {listed(deviating)}, where a part of what is called the base's drift is the arm's own, "
            "or the fixed reflectors' own"
        )

    def _agrees_by_axis(self) -> np.ndarray:
        return np.abs(self.found - self.measured) < _SIGMAS * np.hypot(self.std, self.found_std)

    def as_json(self) -> dict:
        """Keys with their unit."""
        values = {
            "reflectors": list(self.reflectors),
            "measured_mm": self.measured,
            "measured_std_mm": self.std,
            "found_mm": self.found,
            "found_std_mm": self.found_std,
        }
        return values | {"agrees": self.agrees, "statement": self.sentence}


def _um(values, stds) -> str:
    """Three values in micrometres with their sigmas."""
    rows = zip("xyz", 1e3 * np.asarray(values), 1e3 * np.asarray(stds))
    return ", ".join(f"{name} {v:+.0f} ± {s:.{int(s < 1)}f}" for name, v, s in rows)


def fixed_points(recording, bench, terms: Sequence[Term]) -> FixedPoints | None:
    """Estimate the drift of the base from the rows of a recording that do not move; None where there are too few."""
    fixed = recording.select(~recording.moving)
    if recording.measures != "external-point" or fixed.n < 2 * _MIN_SAMPLES or bench.chain is None:
        return None
    labels = recording.poses  # of the whole recording: a selection numbers its own
    time, known = _clock_of(labels[~recording.moving], labels[recording.moving], bench)
    if known.sum() < 2 * _MIN_SAMPLES:
        return None
    low, high = np.quantile(time[known], [_PART, 1 - _PART])
    ends = [known & (time <= low), known & (time >= high)]
    if min(end.sum() for end in ends) < _MIN_SAMPLES:
        return None
    points = np.stack([fixed.columns[f"{axis}_mm"] for axis in "xyz"]).astype(float)
    ids = np.asarray(fixed.reflector)
    moved = points.copy()
    for k in np.unique(ids):
        moved[:, ids == k] -= points[:, ids == k].mean(1, keepdims=True)
    first, last = (moved[:, end] for end in ends)
    std = np.sqrt(first.var(1, ddof=1) / first.shape[1] + last.var(1, ddof=1) / last.shape[1])
    found, error = _predicted(bench, terms, points, time, ends)
    measured = last.mean(1) - first.mean(1)
    return FixedPoints(tuple(int(k) for k in np.unique(ids)), measured, std, found, error)


def _clock_of(poses, moving, bench) -> tuple[np.ndarray, np.ndarray]:
    """(k,) clock of fixed rows of `poses`, that of the `moving` rows of the same pose; (k,) whether there are any."""
    clock_values, index = np.unique(moving, return_inverse=True)
    mean = np.bincount(index, clock(bench.chain.state)) / np.bincount(index)
    place = np.clip(np.searchsorted(clock_values, poses), 0, len(clock_values) - 1)
    return mean[place], clock_values[place] == poses


def _predicted(bench, terms, points, time, ends):
    """(3,) mm by which a drift of the base in the model moves the points from one end to the other, and its std.

    The arm's links and joints are free to warm in that time, too: otherwise the base is given what they do.
    """
    effects = [e for term in terms for e in term.finding.effects]
    drift = next((e for e in effects if _is_drift(e)), None)
    if drift is None:
        return None, None
    modelled = {(e.effect, e.where) for e in effects}
    known = (variant.effect for variant in variants(CATALOGUE, bench.chain))
    warm = [e for e in known if "temperature" in e.reads]
    effects += [e for e in warm if (e.effect, e.where) not in modelled]
    model, fit, _ = bench.solve(effects)
    span = model.spans[len(bench.baseline) + effects.index(drift)]
    pose = fit.parameters.values[:6]
    rotation = rotation_matrix(pose[3:])
    place = rotation.T @ (points - pose[:3, None])
    displacement = sum(
        sign * _displaced(drift, rotation, place[:, end], time[end]).mean(2)
        for sign, end in zip((-1, 1), ends)
    )
    full_covariance = _covariance(bench, model, fit)
    free = np.flatnonzero(fit.parameters.mask)
    columns = np.searchsorted(free, np.arange(span.start, span.stop))
    covariance = displacement.T @ full_covariance[np.ix_(columns, columns)] @ displacement
    error = np.sqrt(np.maximum(np.diag(covariance), 0))
    return fit.parameters.values[span] @ displacement, error


def _is_drift(effect) -> bool:
    """Whether an effect moves the base in the course of time."""
    return effect.where == "base" and effect.port == "frame" and "time" in effect.reads


def _covariance(bench, model, fit) -> np.ndarray:
    """(F, F) of the free parameters, where the rows of one pose err together: Liang & Zeger, Biometrika 73 (1986)."""
    known = np.diag(fit.parameters.precision[fit.parameters.mask])
    matrix = fit.normal / fit.sigma_scale**2 + known
    inverse = inverse_positive(matrix)
    scores = pose_scores(model, fit, bench.pose)
    if scores is None:
        return inverse
    return inverse @ scores @ inverse


def _displaced(drift, rotation, place, time) -> np.ndarray:
    """(P, 3, k) mm in the instrument's frame that each of the drift's parameters moves points (3, k) of the base by."""
    state = type("Clock", (), {"covariates": {"time_s": time}, "n": len(time)})()
    twist = drift.basis(state)
    by_rotation = np.cross(twist[:, 3:], place[None], axis=1)
    return np.einsum("ij,pjk->pik", rotation, twist[:, :3] + by_rotation)


__all__ = ["FixedPoints", "fixed_points"]
