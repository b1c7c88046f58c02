"""Unmodelled effects of a sensor with its own calibration, from profiles or clouds of a ball at flange poses.

Baseline: hand-eye transform and centre of the ball, with a random error of every flange pose and of every point
(`surface_problem`). Candidates displace the points in the sensor frame (`surface_candidates`); a stepwise selection
tests them, and predictions of held-out poses confirm them (`surface_search`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from datasets.recording import Recording
from workbench.core.distributions import norm
from workbench.core.errors import InputError
from workbench.core.text.uncertain import with_std
from workbench.diagnosis.levels import (
    CONFIDENCE,
    DATA_FAULT_LEVEL,
    LEAST_NUMBER,
    NOTABLE_SHARE,
    ROUNDING,
)
from workbench.diagnosis.scanner.surface_candidates import Candidate, candidates
from workbench.diagnosis.scanner.surface_problem import (
    LEAST_NOISE,
    SurfaceData,
    linearised,
    linearised_centres,
    pairs_at,
    pose_error,
    robust_spread,
    shift_basis,
    without_pose_shifts,
)
from workbench.diagnosis.scanner.surface_search import Found, Search
from workbench.diagnosis.validation.folds import LEAST_FOLDS
from workbench.diagnosis.validation.held_out import rms
from workbench.fitting.verdicts.verdict import AS_STATED
from workbench.jobs.sensor import hand_eye

FEWEST = 8
"""Poses without which a fit of hand-eye transform and centre leaves too little to test an effect on."""


_DISTANCES = (0.1, 0.25)
"""Of two points, as a share of the extent of a cloud or profile on the ball."""


@dataclass(frozen=True)
class SurfaceDiagnosis:
    """Findings of a recording.

    `retained` and `refused` terms; signed held-out errors `before` and `after` (n,) mm; errors that are `shared` by
    points of a pose; `noise` (mm) of points and flange poses next to all terms; `covariates` (n,) by name; the
    `detectable` size (mm) of every candidate.
    """

    recording: Recording
    data: SurfaceData
    retained: tuple[Found, ...]
    refused: tuple[Found, ...]
    before: np.ndarray
    after: np.ndarray
    shared: "SharedErrors | None"
    noise: float
    covariates: Mapping[str, np.ndarray]
    detectable: tuple[tuple[Candidate, float], ...]

    @property
    def verdict(self) -> str:
        """One of the four words of the contract."""
        if any(not found.candidate.is_named for found in self.retained) or self.shared:
            return "unexplained"
        if not self.retained:
            return "consistent"
        is_certain = all(found.probability >= CONFIDENCE for found in self.retained)
        return "explained" if is_certain else "ambiguous"

    @property
    def error_name(self) -> str:
        """Of the held-out error."""
        if self.recording.measures == "ball-surface":
            return "held-out RMS distance of the points from the ball"
        return "held-out RMS error of a coordinate of the ball centres"

    @property
    def _noise_from(self) -> str:
        if self.recording.measures == "ball-surface":
            return "from points of one pose and from the flange poses"
        return AS_STATED if np.isfinite(self.noise) else "unknown"

    def as_json(self) -> dict:
        """The answer of `diagnose --json`."""
        everything = np.ones(len(self.before), bool)
        return {
            "command": "diagnose",
            "recording": self.recording.name,
            "unit": "mm",
            "verdict": self.verdict,
            "warnings": list(self.recording.warnings),
            "effects": [effect_json(found) for found in self.retained],
            "refused": [effect_json(found) for found in self.refused],
            "located": self._located(),
            "held_out": {
                "before_mm": rms(self.before, everything),
                "after_mm": rms(self.after, everything),
                "noise_mm": self.noise if np.isfinite(self.noise) else None,
                "noise_from": self._noise_from,
                "folds": LEAST_FOLDS,
                "scheme": "whole poses",
            },
            "smallest_visible": [
                {
                    "effect": candidate.effect,
                    "where": candidate.where,
                    "variant": candidate.label,
                    "size_mm": size,
                }
                for candidate, size in self.detectable
            ],
            "against": None,
            "differences": None,
            "next_experiment": self._next(),
        }

    def _located(self) -> list[dict]:
        """Places of the mismatch, with the share of the mean square of the held-out errors that falls there."""
        before = float((self.before**2).mean())
        places = []
        for found in self.retained:
            places.append(
                {
                    "where": found.candidate.where,
                    "depends_on": list(found.candidate.depends_on),
                    "share_of_mismatch": min(1.0, found.size_mm**2 / before),
                    "size_mm": found.size_mm,
                }
            )
        if self.shared is not None:
            places.append(self.shared.as_json(before))
        return places

    def _next(self) -> str:
        if self.shared is not None:
            return (
                "record the ball twice at the same flange poses: errors that are repeated come from the sensor, others "
                "are noise that neighbouring points share"
            )
        if self.retained:
            return "correct the sensor's calibration by what was found, then record the ball again"
        return "none; measure the ball at other distances and places of the field to see smaller effects"


@dataclass(frozen=True)
class SharedErrors:
    """Errors of `size_mm` (RMS) that points of a pose share at a `distance_mm` from each other, and the correlation."""

    size_mm: float
    correlation: float
    distance_mm: float

    @property
    def statement(self) -> str:
        """In a sentence."""
        return (
            f"points of one pose share errors of {self.size_mm:.3g} mm RMS (correlation {self.correlation:.2f} "
            f"at a distance of {self.distance_mm:.2g} mm), and no tested effect explains them"
        )

    def as_json(self, before: float) -> dict:
        """The entry under `located`; before: mean square of the held-out errors, mm^2."""
        return {
            "where": "sensor",
            "depends_on": ["place within a pose"],
            "share_of_mismatch": min(1.0, self.size_mm**2 / before),
            "size_mm": self.size_mm,
            "statement": self.statement,
        }


def is_surface(recording: Recording) -> bool:
    """Whether a recording holds points on a ball, or ball centres, at flange poses, without an arm to diagnose."""
    measured = recording.measures in ("ball-surface", "ball-centre")
    return measured and not recording.joints.shape[1]


def diagnose_surface(recording: Recording, progress: Callable[[str], None]) -> SurfaceDiagnosis:
    """Unmodelled effects of a sensor that measures a ball. Raises InputError for too few poses."""
    run = hand_eye.calibrate(recording, None, None, progress)
    if len(run.flange) < FEWEST:
        raise InputError(
            f"{recording.name}: expected {FEWEST} poses or more to test effects of the sensor, found "
            f"{len(run.flange)}; record more poses"
        )
    is_centres = recording.measures == "ball-centre"
    data = (linearised_centres if is_centres else linearised)(recording, run.made)
    progress("testing effects of the sensor")
    tested = candidates(recording, data, run.made.kind == "profiles")
    search = Search(data, tested)
    retained, refused = search.run()
    terms = [found.candidate for found in retained]
    columns = np.concatenate([data.baseline, *(term.columns for term in terms)], axis=1)
    if is_centres:
        shared, noise = None, _stated_noise(recording)
    else:
        shared, noise = _remaining_errors(data, columns)
    return SurfaceDiagnosis(
        recording,
        data,
        tuple(retained),
        tuple(refused),
        before=data.held_out(data.baseline),
        after=data.held_out(columns),
        shared=shared,
        noise=noise,
        covariates=_covariates(tested, terms),
        detectable=tuple(search.detectable_sizes(terms)),
    )


def _stated_noise(recording: Recording) -> float:
    """mm, of a coordinate of a centre; NaN where it is not stated."""
    if recording.sigma is None:
        return float("nan")
    return float(np.sqrt(np.mean(recording.sigma**2)))


def _covariates(tested: list[Candidate], terms: list[Candidate]) -> dict[str, np.ndarray]:
    """(n,) values by name, those that the terms depend on first."""
    return {
        term.depends_on[0]: term.covariate
        for term in [*terms, *tested]
        if term.covariate is not None
    }


def _remaining_errors(data: SurfaceData, columns: np.ndarray) -> tuple[SharedErrors | None, float]:
    """Errors that points of a pose share next to a fit of columns (n, k), and the noise (mm) of points and poses."""
    white = data.whitened(columns)
    target = data.whitened_residual()
    solution = np.linalg.lstsq(white, target, rcond=ROUNDING)[0]
    remaining = data.residual - columns @ solution
    without_shifts = without_pose_shifts(remaining, data.normal, data.pose)
    noise = max(robust_spread(without_shifts), LEAST_NOISE)
    noise_of_poses = pose_error(data, remaining, noise)
    return _shared_errors(data, without_shifts), float(np.hypot(noise, noise_of_poses))


def _shared_errors(data: SurfaceData, remaining: np.ndarray) -> SharedErrors | None:
    """Errors `remaining` (n,) mm that points of a pose share; None without any of note.

    The distances are beyond those over which a sensor smooths its points. The correlation is one of normal scores: a
    few points far off do not decide. The fit of a shift to every pose makes -basis_i . basis_j of it.
    """
    basis = shift_basis(data.normal, data.pose)
    rank = np.argsort(np.argsort(remaining))
    scores = ndtri((rank + 0.5) / len(remaining))
    found = None
    for share in _DISTANCES:
        first, second = pairs_at(data, share).T
        if len(first) < LEAST_NUMBER:
            continue
        shared_shift = (basis[first] * basis[second]).sum(1)
        products = scores[first] * scores[second] + shared_shift
        correlation = float(products.mean())
        statistic = abs(correlation) * np.sqrt(len(first))
        p_value = 2 * len(_DISTANCES) * float(norm.sf(statistic))
        is_notable = p_value < DATA_FAULT_LEVEL and correlation**2 > NOTABLE_SHARE**2
        if is_notable and (found is None or abs(correlation) > abs(found.correlation)):
            size = float(np.sqrt(abs(correlation) * np.mean(remaining**2)))
            differences = data.local[:, first] - data.local[:, second]
            distances = np.linalg.norm(differences, axis=0)
            found = SharedErrors(size, correlation, float(np.median(distances)))
    return found


def effect_json(found: Found) -> dict:
    """The entry of a term under `effects` or `refused` of the answer."""
    candidate = found.candidate
    parameters = [
        {
            "name": name,
            "value": float(value),
            "std": float(std) if np.isfinite(std) else None,
            "unit": unit,
            "identifiable": bool(np.isfinite(std)),
        }
        for name, value, std, unit in zip(
            candidate.names, found.values, found.std, candidate.units, strict=True
        )
    ]
    return {
        "effect": candidate.effect,
        "where": candidate.where,
        "label": candidate.label,
        "parameters": parameters,
        "p_value": found.p_value,
        "probability": found.probability,
        "alternatives": [
            _alternative_json(other, probability) for other, probability in found.alternatives
        ],
        "size_mm": found.size_mm,
        "held_out_before_mm": found.before,
        "held_out_after_mm": found.after,
        "statement": statement(found),
    }


def _alternative_json(candidate: Candidate, probability: float) -> dict:
    return {
        "effect": candidate.effect,
        "where": candidate.where,
        "probability": probability,
        "why": f"{candidate.label}: similar distances in these poses",
    }


def statement(found: Found) -> str:
    """The finding in a sentence."""
    candidate = found.candidate
    numbers = [
        f"{with_std(value, std)} {unit}".strip()
        for value, std, unit in zip(found.values, found.std, candidate.units)
        if np.isfinite(std)
    ]
    undetermined = [name for name, std in zip(candidate.names, found.std) if not np.isfinite(std)]
    if undetermined:
        numbers.append(f"{', '.join(undetermined)} identifiable only in combination")
    values = f" ({', '.join(numbers)})" if candidate.is_named else ""
    return (
        f"{candidate.effect} at {candidate.where}: {candidate.label}{values}; {found.size_mm:.3g} mm RMS, "
        f"p = {found.p_value:.2g}, probability {found.probability:.2f}; held-out error {found.before:.4g} -> "
        f"{found.after:.4g} mm"
    )
