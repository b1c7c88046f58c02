"""Stepwise selection of effects of a sensor that measures a ball.

Terms are added, exchanged and removed while the evidence grows: the fall of chi-square against Schwarz' criterion
(Ann. Stat. 6 (1978) 461). A term is kept if its F-test is significant and held-out poses confirm it. Errors that the
points of a pose share inflate the variance of a score; the tests are divided by this design effect (Kish, Survey
Sampling (1965), sec. 8.2).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from workbench.core.distributions import fisher, norm
from workbench.diagnosis.levels import (
    CONFIDENCE,
    CRITICAL_CLARK_WEST_T,
    LEAST_LOG_ODDS,
    LISTED_PROBABILITY,
    MOST_LISTED,
    RARE_PRIOR,
    ROUNDING,
    UNMODELLED_LEVEL,
)
from workbench.diagnosis.scanner.surface_candidates import Candidate
from workbench.diagnosis.scanner.surface_problem import SurfaceData
from workbench.diagnosis.validation.held_out import clark_west_t, rms

_SMALLEST = float(np.sqrt(ROUNDING))
"""Share of a column below which what is left of it after a projection is rounding."""
_COORDINATES = 3
"""Of a pose: its points show the distance of the sensor from the ball, and hardly more."""
_LEAST_DEGREES = 4
"""Degrees of freedom of a test with as few poses as parameters."""


_MOST_TERMS = 8
"""More effects of one sensor are not distinguishable by the points of one ball."""


@dataclass(frozen=True)
class Trial:
    """A candidate next to other terms: `fall` of chi-square with `rank` parameters, `dispersion` (variance of the
    residual over that of the noise, with the design effect), p-value after Bonferroni's correction."""

    candidate: Candidate
    fall: float
    rank: int
    dispersion: float
    p_value: float

    def log_evidence(self, dispersion: float, points: int) -> float:
        """Of the candidate against none, by Schwarz' criterion, with the prior of its kind."""
        prior = 0.0 if self.candidate.is_named else np.log(RARE_PRIOR)
        penalty = self.rank * np.log(points)
        return (self.fall / dispersion - penalty) / 2 + prior


@dataclass(frozen=True)
class Found:
    """A tested candidate with values and standard deviations (k,), size (mm, RMS), held-out RMS before and after (mm),
    its probability among the `alternatives` [(candidate, probability)] conditional on the other terms."""

    candidate: Candidate
    values: np.ndarray
    std: np.ndarray
    p_value: float
    size_mm: float
    before: float
    after: float
    is_retained: bool
    probability: float = 1.0
    alternatives: tuple[tuple[Candidate, float], ...] = ()


class Search:
    """Selection of terms among candidates."""

    def __init__(self, data: SurfaceData, candidates: Sequence[Candidate]):
        self.data = data
        self.candidates = list(candidates)
        self.tests = len({candidate.kind for candidate in self.candidates})
        self.target = data.whitened_residual()
        self.white = {
            id(candidate): data.whitened(candidate.columns) for candidate in self.candidates
        }
        self.white_baseline = data.whitened(data.baseline)

    def run(self) -> tuple[list[Found], list[Found]]:
        """Terms that are retained, and those that are significant and refused."""
        named = self._grown([], [term for term in self.candidates if term.is_named])
        terms = max(
            self._grown(named, self.candidates),
            self._grown([], self.candidates),
            key=self._log_evidence,
        )
        refused: list[Found] = []
        while True:
            tested = [self.found(term, _drop_term(terms, term)) for term in terms]
            doubtful = [found for found in tested if not found.is_retained]
            if not doubtful:
                return tested, refused
            worst = max(doubtful, key=lambda found: found.p_value)
            terms = _drop_term(terms, worst.candidate)
            if worst.p_value < UNMODELLED_LEVEL:
                refused.append(worst)

    def _grown(self, terms: list[Candidate], candidates: Sequence[Candidate]) -> list[Candidate]:
        """Terms with all that raises the evidence significantly."""
        for _ in range(_MOST_TERMS):
            ranked = self._ranked(terms, candidates)
            if not ranked or ranked[0][1] <= 0 or ranked[0][0].p_value >= UNMODELLED_LEVEL:
                break
            terms = self._improved([*terms, ranked[0][0].candidate], candidates)
        return terms

    def _log_evidence(self, terms: Sequence[Candidate]) -> float:
        """Of a set of terms by Schwarz' criterion, with the dispersion of what it leaves."""
        basis = _orthonormal(self._columns(terms))
        explained = ((basis.T @ self.target) ** 2).sum()
        remaining = float(self.target @ self.target - explained)
        points = len(self.target)
        rank = basis.shape[1]
        prior = sum(np.log(RARE_PRIOR) for term in terms if not term.is_named)
        log_misfit = points * np.log(max(remaining, 1e-300))
        return -(log_misfit + rank * np.log(points)) / 2 + prior

    def _improved(self, terms: list[Candidate], candidates) -> list[Candidate]:
        """Terms exchanged and removed while the evidence grows; a set that comes back ends it."""
        seen: set[frozenset] = set()
        while (key := frozenset(map(id, terms))) not in seen:
            seen.add(key)
            changed = self._exchanged(terms, candidates)
            if changed is None:
                break
            terms = changed
        return terms

    def _exchanged(self, terms: list[Candidate], candidates) -> list[Candidate] | None:
        for replaced in terms:
            others = _drop_term(terms, replaced)
            ranked = self._ranked(others, candidates)
            evidence = {id(trial.candidate): value for trial, value in ranked}
            if evidence[id(replaced)] < 0:
                return others
            best, value = ranked[0]
            if value > evidence[id(replaced)] + LEAST_LOG_ODDS:
                return [*others, best.candidate]
        return None

    def _ranked(self, terms: Sequence[Candidate], candidates) -> list[tuple[Trial, float]]:
        """Trials with their log evidence, largest first; one dispersion for all, of the best fit."""
        basis = _orthonormal(self._columns(terms))
        residual = self.target - basis @ (basis.T @ self.target)
        trials = [
            self._trial(candidate, basis, residual)
            for candidate in candidates
            if not any(candidate is term for term in terms)
        ]
        if not trials:
            return []
        dispersion = max(trials, key=lambda trial: trial.fall).dispersion
        points = len(self.target)
        ranked = [(trial, trial.log_evidence(dispersion, points)) for trial in trials]
        return sorted(ranked, key=lambda pair: -pair[1])

    def _columns(self, terms: Sequence[Candidate]) -> np.ndarray:
        return np.concatenate(
            [self.white_baseline, *(self.white[id(term)] for term in terms)], axis=1
        )

    def _trial(self, candidate: Candidate, basis: np.ndarray, residual: np.ndarray) -> Trial:
        columns = self.white[id(candidate)]
        unexplained = columns - basis @ (basis.T @ columns)
        orthogonal = _orthonormal(unexplained, np.linalg.norm(columns))
        rank = orthogonal.shape[1]
        if rank == 0:
            return Trial(candidate, 0.0, 0, 1.0, 1.0)
        score = orthogonal.T @ residual
        fall = float(score @ score)
        remaining = residual - orthogonal @ score
        degrees = max(len(residual) - basis.shape[1] - rank, _LEAST_DEGREES)
        variance = max(float(remaining @ remaining) / degrees, 1.0)
        design_effect = self._design_effect(orthogonal, remaining)
        dispersion = variance * max(design_effect / variance, 1.0)
        of_poses = _COORDINATES * len(self.data.sensor) - basis.shape[1] - rank
        statistic = fall / rank / dispersion
        p_value = float(fisher.sf(statistic, rank, max(of_poses, _LEAST_DEGREES)))
        return Trial(candidate, fall, rank, dispersion, min(1.0, p_value * self.tests))

    def _design_effect(self, orthogonal: np.ndarray, remaining: np.ndarray) -> float:
        """Mean square of the scores of single poses, over the square that independent points of variance 1 make."""
        shape = (len(self.data.sensor), orthogonal.shape[1])
        scores = np.zeros(shape)
        np.add.at(scores, self.data.pose, orthogonal * remaining[:, None])
        expected = (orthogonal**2).sum()
        return float((scores**2).sum() / expected)

    def found(self, candidate: Candidate, others: Sequence[Candidate]) -> Found:
        """A candidate next to other terms, with held-out errors and alternatives."""
        data = self.data
        ranked = self._ranked(others, self.candidates)
        trial = next(trial for trial, _ in ranked if trial.candidate is candidate)
        small = np.concatenate([data.baseline, *(other.columns for other in others)], axis=1)
        large = np.concatenate([small, candidate.columns], axis=1)
        before = data.held_out(small)
        after = data.held_out(large)
        everything = np.ones(len(self.target), bool)
        t = clark_west_t(data.pose, before[None], after[None], everything)
        values, std = self._estimates(candidate, others, trial.dispersion)
        probability, alternatives = _shares(candidate, ranked)
        return Found(
            candidate,
            values,
            std,
            trial.p_value,
            self._size(candidate.columns @ values),
            rms(before, everything),
            rms(after, everything),
            trial.p_value < UNMODELLED_LEVEL and t > CRITICAL_CLARK_WEST_T,
            probability,
            alternatives,
        )

    def detectable_sizes(self, terms: Sequence[Candidate]) -> Iterator[tuple[Candidate, float]]:
        """Candidates with a name and the RMS size (mm) that is found with 95 % probability next to some terms.

        Of several parameters the least visible one. A signature of d standard deviations is found with this
        probability where d is the quantile of the level plus that of the power (Teunissen, J. Geod. 92 (2018) 59).
        """
        level = UNMODELLED_LEVEL / self.tests / 2
        power = CONFIDENCE
        deviations = float(norm.isf(level) + norm.isf(1 - power))
        for candidate in self.candidates:
            if candidate.is_named and not any(candidate is term for term in terms):
                std = self._estimates(candidate, terms, 1.0)[1]
                sizes = [
                    self._size(deviations * sigma * column)
                    for sigma, column in zip(std, candidate.columns.T)
                    if np.isfinite(sigma)
                ]
                if sizes:
                    yield candidate, max(sizes)

    def _size(self, error: np.ndarray) -> float:
        """mm, RMS of the part of an error (n,) that no hand-eye transform and centre of the ball make."""
        basis = _orthonormal(self.data.baseline)
        remaining = error - basis @ (basis.T @ error)
        return float(np.sqrt(np.mean(remaining**2)))

    def _estimates(self, candidate, others, dispersion: float) -> tuple[np.ndarray, np.ndarray]:
        """Values and standard deviations (k,) of a candidate's parameters; nan for what only a combination shows."""
        all_columns = self._columns([*others, candidate])
        inverse = np.linalg.pinv(all_columns, rcond=ROUNDING)
        rows = inverse[-candidate.columns.shape[1] :]
        squares = (rows**2).sum(1)
        std = np.sqrt(dispersion * squares)
        std[self._undetermined(candidate, others)] = np.nan
        return rows @ self.target, std

    def _undetermined(self, candidate: Candidate, others: Sequence[Candidate]) -> np.ndarray:
        """(k,) parameters that change along a direction which the other terms and the baseline make as well."""
        columns = self.white[id(candidate)]
        scaled = columns / np.linalg.norm(columns, axis=0)
        basis = _orthonormal(self._columns(others))
        _, size, directions = np.linalg.svd(
            scaled - basis @ (basis.T @ scaled), full_matrices=False
        )
        null = directions[size < _SMALLEST]
        return (null**2).sum(0) > _SMALLEST


def _shares(candidate: Candidate, ranked) -> tuple[float, tuple[tuple[Candidate, float], ...]]:
    """Probability of a candidate, and of its alternatives, each with the best number of terms."""
    best: dict[tuple, tuple[Candidate, float]] = {}
    for trial, value in ranked:
        tested = trial.candidate
        if tested.kind not in best or value > best[tested.kind][1]:
            best[tested.kind] = (tested, value)
    total = logsumexp([value for _, value in best.values()])
    share = {kind: float(np.exp(value - total)) for kind, (_, value) in best.items()}
    others = [
        (best[kind][0], share[kind])
        for kind in best
        if kind != candidate.kind and share[kind] > LISTED_PROBABILITY
    ]
    others.sort(key=lambda pair: -pair[1])
    return share[candidate.kind], tuple(others[:MOST_LISTED])


def _orthonormal(columns: np.ndarray, scale: float | None = None) -> np.ndarray:
    """(n, r) orthonormal basis of columns (n, k); `scale`: what their length is compared with."""
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    largest = size[0] if scale is None else scale
    return basis[:, size > _SMALLEST * largest]


def _drop_term(terms: Sequence[Candidate], candidate: Candidate) -> list[Candidate]:
    return [term for term in terms if term is not candidate]
