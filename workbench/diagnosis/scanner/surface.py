"""Unmodelled effects of a sensor with its own calibration, from profiles or clouds of a ball at flange poses.

Baseline: hand-eye transform and centre of the ball, with a random error of every flange pose and of every point. A
candidate displaces the points in the sensor frame; generalised least squares tests it with an F-test, and predictions
of held-out poses confirm it. Robot errors are the same for all points of a pose, so they do not pass for an effect of
the sensor.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from sensors.effects import artefact, recorded, surface
from workbench.core.distributions import fisher, norm
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix, skew
from workbench.core.text.uncertain import with_std
from workbench.diagnosis.levels import CRITICAL_T, UNMODELLED_LEVEL
from workbench.diagnosis.validation.folds import LEAST_FOLDS
from workbench.diagnosis.validation.held_out import paired_t, rms
from workbench.files.images.flange import flange_poses
from workbench.jobs.sensor import hand_eye

FEWEST = 8
"""Poses without which a fit of hand-eye transform and centre leaves too little to test an effect on."""
_STEEPEST = np.deg2rad(75.0)
"""Incidence from which on the shift along the ray, which grows with its tangent, grows no more."""
_STEPS = 5
"""Steps of Gauss and Newton from the hand-eye calibration, which differs by the weights alone."""


@dataclass(frozen=True)
class Candidate:
    """An effect by its word of the vocabulary, `label`, `unit` of its parameters, and columns (n, k): distance of each
    point from the ball for one unit of each parameter."""

    effect: str
    label: str
    units: tuple[str, ...]
    columns: np.ndarray


@dataclass(frozen=True)
class Found:
    """A tested candidate with its values and standard deviations (k,), p-value after Bonferroni's correction for all
    tests, size (mm, RMS), and held-out RMS before and after, mm."""

    candidate: Candidate
    values: np.ndarray
    std: np.ndarray
    p_value: float
    size_mm: float
    before: float
    after: float
    retained: bool

    @property
    def statement(self) -> str:
        """What was found, in a sentence."""
        numbers = ", ".join(
            f"{with_std(value, std)} {unit}".strip()
            for value, std, unit in zip(self.values, self.std, self.candidate.units)
        )
        return (
            f"{self.candidate.effect} at sensor: {self.candidate.label} ({numbers}); {self.size_mm:.3g} mm RMS, "
            f"p = {self.p_value:.2g}; held-out error {self.before:.4g} -> {self.after:.4g} mm"
        )

    def as_json(self) -> dict:
        """The entry under `effects` or `refused` of the answer."""
        return {
            "effect": self.candidate.effect,
            "where": "sensor",
            "label": self.candidate.label,
            "values": self.values.tolist(),
            "std": self.std.tolist(),
            "units": list(self.candidate.units),
            "p_value": self.p_value,
            "size_mm": self.size_mm,
            "held_out_before_mm": self.before,
            "held_out_after_mm": self.after,
            "statement": self.statement,
        }


def is_surface(recording: Recording) -> bool:
    """Whether a recording holds points on a ball at flange poses, without an arm to diagnose."""
    return recording.measures == "ball-surface" and not recording.joints.shape[1]


def diagnose_surface(recording: Recording, progress: Callable[[str], None]) -> dict:
    """The answer of `diagnose` for a sensor that measures a ball. Raises InputError for too few poses."""
    run = hand_eye.calibrate(recording, None, None, progress)
    if len(run.flange) < FEWEST:
        raise InputError(
            f"{recording.name}: expected {FEWEST} poses or more to test effects of the sensor, found "
            f"{len(run.flange)}; record more poses"
        )
    data = _linearised(recording, run)
    progress("testing effects of the sensor")
    retained, refused = _search(data, _candidates(recording, data, run))
    before = _rms(_held_out(data, data.baseline))
    after = _rms(_held_out(data, _with(data, [found.candidate for found in retained])))
    return {
        "command": "diagnose",
        "recording": recording.name,
        "unit": "mm",
        "verdict": _verdict(retained),
        "warnings": list(recording.warnings),
        "effects": [found.as_json() for found in retained],
        "refused": [found.as_json() for found in refused],
        "held_out": {
            "before_mm": before,
            "after_mm": after,
            "noise_mm": float(np.hypot(data.noise, data.pose_error)),
            "noise_from": "from points of one pose and from the flange poses",
            "folds": LEAST_FOLDS,
            "scheme": "whole poses",
        },
        "against": None,
        "differences": None,
        "next_experiment": _next(retained),
    }


def _verdict(retained) -> str:
    if not retained:
        return "no unmodelled effect of the sensor was found"
    return f"{len(retained)} unmodelled effect{'s' * (len(retained) > 1)} of the sensor"


def _next(retained) -> str:
    if retained:
        return "correct the sensor's calibration by what was found, then record the ball again"
    return (
        "none; measure the ball at other distances and places of the field to see smaller effects"
    )


@dataclass(frozen=True)
class Data:
    """Distances `residual` (n,) mm from the ball, `normal` (n, 3) in the base, `pose` (n,), `baseline` (n, 9) columns
    of hand-eye and centre, `noise` of a point and `pose_error` of a pose's coordinate (mm); `local` (3, n) points and
    `turn` (P, 3, 3) T_base_sensor."""

    residual: np.ndarray
    normal: np.ndarray
    pose: np.ndarray
    baseline: np.ndarray
    noise: float
    pose_error: float
    local: np.ndarray
    turn: np.ndarray

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """V^-1/2 values (n, k), V = noise^2 I + pose_error^2 N N^T in each pose; N (m, 3) its normals."""
        white = np.array(values, float)
        for k in np.unique(self.pose):
            on = self.pose == k
            basis, size, _ = np.linalg.svd(self.normal[on], full_matrices=False)
            shrink = 1 - 1 / np.sqrt(1 + (self.pose_error * size / self.noise) ** 2)
            white[on] -= basis @ (shrink[:, None] * (basis.T @ white[on]))
        return white / self.noise


def _linearised(recording: Recording, run) -> Data:
    pose = np.unique(recording.poses, return_inverse=True)[1]
    first = np.unique(pose, return_index=True)[1]
    flange = flange_poses(recording)[first]
    error = max(run.made.robot_sigma.get("position_mm", 0.0), 1e-4)
    mount, centre = run.made.sensor.copy(), run.made.centre.copy()
    for _ in range(_STEPS):
        data = _at(recording.points.T, pose, flange, (mount, centre, run.made.radius), error)
        target = data.whitened(data.residual[:, None])[:, 0]
        step = _solved(data.whitened(data.baseline), target)[1]
        mount[:3, :3] = rotation_matrix(step[3:6]) @ mount[:3, :3]
        mount[:3, 3] += step[:3]
        centre = centre + step[6:9]
    return data


def _at(local, pose, flange, solution, error) -> Data:
    """The problem linearised at a hand-eye transform, centre and radius."""
    mount, centre, radius = solution
    sensor = flange @ mount
    turn = sensor[:, :3, :3]
    points = np.einsum("nij,jn->ni", turn[pose], local) + sensor[pose, :3, 3]
    away = points - centre
    distance = np.linalg.norm(away, axis=1)
    normal = away / distance[:, None]
    residual = distance - radius
    in_flange = np.einsum("nji,nj->ni", flange[pose, :3, :3], normal)
    arm = local.T @ mount[:3, :3].T
    by_turn = np.einsum("ni,nij->nj", in_flange, -skew(arm))
    baseline = np.concatenate([in_flange, by_turn, -normal], axis=1)
    noise = _noise(residual, normal, pose)
    spread = max(noise, _spread(residual))
    inliers = np.abs(residual - np.median(residual)) < 6 * spread
    rows = (residual[inliers], normal[inliers], pose[inliers], baseline[inliers])
    return Data(*rows, noise, error, local[:, inliers], turn)


def _spread(values) -> float:
    """Standard deviation, robust."""
    return float(np.median(np.abs(values - np.median(values))) / norm.isf(0.25))


def _noise(residual, normal, pose) -> float:
    """mm, RMS within poses after a shift of each, robust."""
    parts = []
    for k in np.unique(pose):
        on = pose == k
        rows = normal[on]
        parts.append(residual[on] - rows @ np.linalg.lstsq(rows, residual[on], rcond=1e-6)[0])
    return max(_spread(np.concatenate(parts)), 1e-6)


def _candidates(recording: Recording, data: Data, run) -> list[Candidate]:
    x, y, z = data.local
    size = max(np.abs(np.stack([x, y])).max(), 1e-9)
    across = (x / size, y / size)
    depth = z - np.median(z)
    is_profile = run.made.kind == "profiles"
    flat = (across[0],) if is_profile else across
    powers = [*flat, *(flat[i] * flat[j] for i in range(len(flat)) for j in range(i + 1))]
    along = np.einsum("ni,ni->n", data.normal, data.turn[data.pose][:, :, 2])  # normal . sensor z
    sight = np.stack([0 * x, 0 * y, 1 + 0 * z]) if is_profile else data.local
    sight = np.einsum("nij,jn->ni", data.turn[data.pose], sight / np.linalg.norm(sight, axis=0))
    cosine = np.clip(-np.einsum("ni,ni->n", data.normal, sight), np.cos(_STEEPEST), 1)
    tangent = np.tan(np.arccos(cosine)) * -cosine
    candidates = [
        Candidate(surface.RangeScale.effect, "scale of z", ("mm/mm",), (along * depth)[:, None]),
        Candidate(
            surface.FieldBias.effect,
            "z errs by a quadratic polynomial of the place in the field",
            ("mm",) * len(powers),
            along[:, None] * np.stack(powers, axis=1),
        ),
        Candidate(
            surface.IncidenceBias.effect,
            "shift along the ray with incidence",
            ("mm",),
            tangent[:, None],
        ),
        Candidate(artefact.BallRadius.effect, "radius of the ball", ("mm",), -np.ones((len(x), 1))),
    ]
    return candidates + _of_columns(recording, data, along)


def _of_columns(recording: Recording, data: Data, along) -> list[Candidate]:
    """One candidate for every recorded column that varies: z errs in proportion to it."""
    pose = np.unique(recording.poses, return_inverse=True)[1]
    candidates = []
    for name, cells in recording.covariates.items():
        mean = np.bincount(pose, cells) / np.bincount(pose)
        if np.ptp(mean) > 0:
            scaled = (mean - mean.mean()) / mean.std()
            column = (along * scaled[data.pose])[:, None]
            candidates.append(
                Candidate(recorded.RecordedColumn.effect, f"z errs with {name}", ("mm",), column)
            )
    return candidates


def _with(data: Data, candidates) -> np.ndarray:
    return np.concatenate([data.baseline, *(candidate.columns for candidate in candidates)], axis=1)


def _search(data: Data, candidates) -> tuple[list[Found], list[Found]]:
    """Forward selection by F-tests, each confirmed by held-out poses."""
    chosen: list[Found] = []
    tests = len(candidates)
    while candidates:
        base = [found.candidate for found in chosen]
        trials = [_tested(data, base, found, tests) for found in candidates]
        best = min(trials, key=lambda found: found.p_value)
        if not best.retained:
            return chosen, [found for found in trials if found.p_value < UNMODELLED_LEVEL]
        chosen.append(best)
        candidates = [found for found in candidates if found is not best.candidate]
    return chosen, []


def _tested(data: Data, base, candidate: Candidate, tests: int) -> Found:
    small, large = _with(data, base), _with(data, [*base, candidate])
    target = data.whitened(data.residual[:, None])[:, 0]
    first, _ = _solved(data.whitened(small), target)
    second, solution = _solved(data.whitened(large), target)
    k = candidate.columns.shape[1]
    free = len(np.unique(data.pose)) * 3 - large.shape[1]
    free = max(free, 4)  # poses, not points, are what repeats
    variance = max(second / (len(target) - large.shape[1]), 1.0)
    statistic = (first - second) / k / variance
    p_value = min(1.0, tests * float(fisher.sf(statistic, k, free)))
    white = data.whitened(large)
    covariance = variance * np.linalg.pinv(white.T @ white)
    values = -solution[-k:]
    std = np.sqrt(np.diag(covariance)[-k:])
    size = float(np.sqrt(np.mean((candidate.columns @ values) ** 2)))
    before, after = _held_out(data, small), _held_out(data, large)
    t = paired_t(data.pose, before, after, np.ones(len(target), bool))
    retained = p_value < UNMODELLED_LEVEL and t > CRITICAL_T
    return Found(candidate, values, std, p_value, size, _rms(before), _rms(after), retained)


def _solved(rows, target) -> tuple[float, np.ndarray]:
    """Sum of squares, and the solution x of rows x = -target."""
    solution = np.linalg.lstsq(rows, -target, rcond=1e-10)[0]
    remaining = target + rows @ solution
    return float(remaining @ remaining), solution


def _rms(errors: np.ndarray) -> float:
    return rms(errors, np.ones(len(errors), bool))


def _held_out(data: Data, rows: np.ndarray) -> np.ndarray:
    """(n,) mm, distances of the points of held-out poses from the ball."""
    white, target = data.whitened(rows), data.whitened(data.residual[:, None])[:, 0]
    fold = data.pose % LEAST_FOLDS
    errors = np.empty_like(data.residual)
    for k in range(LEAST_FOLDS):
        train, test = fold != k, fold == k
        solution = np.linalg.lstsq(white[train], -target[train], rcond=1e-10)[0]
        errors[test] = data.residual[test] + rows[test] @ solution
    return np.abs(errors)
