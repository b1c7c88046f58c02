"""Differences between a recording and its simulation in three parts: parameters, noise, physics.

Parameters are selected stepwise. The frames (base and tool), the effects of the reference and the terms that the
diagnosis kept are always estimated; a parameter of the geometry joins where a partial F-test says that the data need
it, with the error level shared among all candidates (Bonferroni), and leaves again where the others make it needless.
A parameter that an earlier calibration held fixed is a candidate like every other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robot_model.measurements import samples_of
from robot_model.system import RobotChain, bind, geometry_free
from workbench.core.distributions import chi2, fisher, norm
from workbench.core.effect import Effect
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.diagnosis.levels import DATA_FAULT_LEVEL
from workbench.explanation.comparison.alternatives import alternative_sets
from workbench.explanation.comparison.reference import Reference
from workbench.explanation.comparison.uncertain_reference import (
    ValueUncertainty,
    generalised_least_squares,
)
from workbench.explanation.result import Diagnosis
from workbench.explanation.term_steps import step_of_simulation
from workbench.fitting.calibration_plans.plans import frames_of
from workbench.fitting.noise_scale import NOISE_ROUNDS
from workbench.fitting.priors.wider_priors import widened

_MAX_NAMED = 12  # parameters that are named


@dataclass(frozen=True)
class _Compared(Model):
    """The reference's model with the effects that the diagnosis added at its end: `added` parameters."""

    added: int = 0


@dataclass(frozen=True)
class Differences:
    """`parameters`: rows of those that differ, most significant first; `noise`: stated and found sigma and factor."""

    parameters: tuple[Mapping, ...]
    noise: Mapping
    tested: int

    def as_json(self, physics: Sequence[Mapping]) -> dict:
        """The key `differences` of the answer; physics: the effects that the diagnosis kept."""
        return {
            "parameters": [dict(row) for row in self.parameters],
            "parameters_tested": self.tested,
            "noise": dict(self.noise),
            "physics": [dict(row) for row in physics],
        }


def differences(
    reference: Reference, recording, effects: Sequence[Effect], outliers: Sequence[int] = ()
) -> Differences:
    """Compare a recording with a reference, given the effects that the diagnosis added to it.

    outliers: sample numbers that do not count.
    """
    moving = samples_of(recording)
    moving = moving.select(~np.isin(moving.sample_ids, list(outliers)))
    reference_only = [e for e in reference.effects if not _is_among(e, effects)]
    chain = bind(reference.robot, moving)
    added = sum(len(effect.parameters(chain)) for effect in effects)
    model = _Compared(chain, (*reference_only, *effects), added=added)
    values = {k: v for k, v in reference.values.items() if k in model.parameters.index}
    start = model.parameters.update(values)
    candidates = _candidates(model, start, reference_only)
    chosen = _selected(model, start, candidates)
    all_differences = _solved(model, _free(model, start, candidates))
    start = replace(start, table=all_differences.parameters.table)
    model = replace(model, chain=_scaled(model.chain, all_differences.sigma_scale), _bases={})
    compared = _ComparedWith(model, start, candidates, reference.uncertainty)
    fit, estimates = compared.significant(chosen)
    rows = _rows(model, start, fit, candidates, estimates)
    noise = _noise(reference, moving, all_differences)
    return Differences(tuple(rows[:_MAX_NAMED]), noise, len(candidates))


def with_differences(diagnosis: Diagnosis, reference: Reference, recording) -> Diagnosis:
    """The diagnosis with the comparison, the reference's robot, and what the reference does not say."""
    found = [e for term in diagnosis.terms for e in term.finding.effects]
    extra = [e for e in diagnosis.given if not _is_among(e, reference.effects)]
    compared = differences(reference, recording, (*extra, *found), diagnosis.outliers)
    steps = (step_of_simulation(reference, recording), *diagnosis.views.steps)
    return replace(
        diagnosis,
        views=replace(diagnosis.views, steps=steps),
        robot_keys=reference.robot_keys,
        differences=compared,
        warnings=(*diagnosis.warnings, *reference.notes),
    )


def _is_among(effect: Effect, others: Sequence[Effect]) -> bool:
    return any((e.effect, e.where) == (effect.effect, effect.where) for e in others)


def _solved(model: _Compared, free: Parameters) -> Fit:
    """Fit with wider priors for effects that are far larger than usual, as in the diagnosis that found them.

    Shrunk by their usual priors, they would leave a residual that counts as noise.
    """
    fit = solve(model, free)
    for _ in range(NOISE_ROUNDS):
        wider = widened(model, fit)
        if wider is fit.parameters:
            break
        fit = solve(model, wider)
    return fit


def _scaled(chain: RobotChain, scale: float) -> RobotChain:
    return replace(chain, sigma=chain.sigma * max(scale, 1e-12))


def _candidates(model: _Compared, start: Parameters, reference_only: Sequence[Effect]) -> list[str]:
    """Keys of what may differ: the geometry that can be free, and the parameters of the reference's own effects."""
    keys = [key for key in geometry_free(model.chain.robot) if key in start.index]
    return keys + [p.key for effect in reference_only for p in effect.parameters(model.chain)]


def _free(model: _Compared, start: Parameters, keys: Sequence[str]) -> Parameters:
    """Frames, the effects that the diagnosis added, and the named parameters free."""
    mask = start.matching(*frames_of(start)) | np.isin(start.keys, list(keys))
    mask[len(start) - model.added :] = True
    return start.only(mask)


def _selected(model: _Compared, start: Parameters, candidates: Sequence[str]) -> list[str]:
    """Keys of the parameters that the data need, by stepwise selection about the solution with frames and effects."""
    placed = solve(model, _free(model, start, ())).parameters
    names, orthogonal, remaining, degrees = _projected(model, placed, candidates)
    return [names[i] for i in _stepwise(orthogonal, remaining, degrees)]


def _projected(
    model: _Compared, parameters: Parameters, candidates: Sequence[str]
) -> tuple[list[str], np.ndarray, np.ndarray, int]:
    """Keys of the C candidates, their whitened columns (C, N) and the whitened residual (N,) at some parameters.

    All that is always estimated is projected out of both; columns are for one typical size. Last, the degrees of
    freedom of the residual.
    """
    free = _free(model, parameters, candidates)
    residual, rows = model.linearise(free)
    sigma = np.broadcast_to(model.sigma(parameters), residual.shape)
    white = (residual / sigma).ravel()
    columns = (rows / sigma).reshape(len(rows), -1) * free.typical[free.mask][:, None]
    keys = [key for key, is_free in zip(free.keys, free.mask) if is_free]
    is_candidate = np.isin(keys, candidates)
    orthogonal, remaining = _cleared(columns[~is_candidate], columns[is_candidate], white)
    names = [key for key, is_wanted in zip(keys, is_candidate) if is_wanted]
    degrees = white.size - int((~is_candidate).sum())
    return names, orthogonal, remaining, degrees


def _cleared(always, columns, white) -> tuple[np.ndarray, np.ndarray]:
    """Candidate columns (C, N) and residual (N,) with all that is always estimated projected out."""
    basis = _basis(always)
    orthogonal = columns - (columns @ basis) @ basis.T
    remaining = white - basis @ (basis.T @ white)
    return orthogonal, remaining


def _basis(columns) -> np.ndarray:
    """(N, R) orthonormal basis of the rows of (K, N)."""
    lengths = np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    u, s, _ = np.linalg.svd((columns / lengths).T, full_matrices=False)
    return u[:, s > 1e-9 * s.max(initial=0)]


def _stepwise(columns, white, degrees: int) -> list[int]:
    """Indices that a stepwise search selects: add the best, exchange one for a better, drop what is not needed."""
    seen = np.linalg.norm(columns, axis=1)
    usable = np.flatnonzero(seen > 1e-6 * max(seen.max(initial=0), 1e-300))
    chosen: list[int] = []
    limit = DATA_FAULT_LEVEL / max(len(columns), 1)
    while len(chosen) < len(usable):
        others = [int(i) for i in usable if i not in chosen]
        best = min(others, key=lambda i: _left(columns, white, [*chosen, i]))
        if _p_value(columns, white, chosen, best, degrees) > limit:
            return chosen
        chosen = _exchanged(columns, white, [*chosen, best], usable)
        chosen = _pruned(columns, white, chosen, degrees, limit)
    return chosen


def _left(columns, white, chosen) -> float:
    """Sum of squares that is left with some candidates fitted."""
    if not chosen:
        return float(white @ white)
    basis = _basis(columns[chosen])
    return float(white @ white - ((basis.T @ white) ** 2).sum())


def _p_value(columns, white, chosen, added: int, degrees: int) -> float:
    """p-value of the partial F-test of one more parameter."""
    before = _left(columns, white, chosen)
    after = _left(columns, white, [*chosen, added])
    free = max(degrees - len(chosen) - 1, 1)
    return float(fisher.sf(max(before - after, 0) / max(after / free, 1e-300), 1, free))


def _exchanged(columns, white, chosen: list[int], usable) -> list[int]:
    """The set with members exchanged, one at a time, as long as the fit becomes better by it."""
    for _ in range(2 * len(chosen)):
        now = _left(columns, white, chosen)
        trials = [
            [*chosen[:k], int(i), *chosen[k + 1 :]]
            for k in range(len(chosen))
            for i in usable
            if i not in chosen
        ]
        best = min(trials, key=lambda trial: _left(columns, white, trial), default=chosen)
        if not _left(columns, white, best) < now * (1 - 1e-9):
            break
        chosen = best
    return chosen


def _pruned(columns, white, chosen: list[int], degrees: int, limit: float) -> list[int]:
    for member in list(chosen):
        kept = [i for i in chosen if i != member]
        if _p_value(columns, white, kept, member, degrees) > limit:
            chosen = kept
    return chosen


@dataclass(frozen=True)
class _ComparedWith:
    """A model at the values `start` of a reference, whose `uncertainty` (None: none) counts as noise of its own.

    `candidates`: keys of the parameters that may differ.
    """

    model: _Compared
    start: Parameters
    candidates: Sequence[str]
    uncertainty: ValueUncertainty | None

    def significant(self, chosen: Sequence[str]) -> tuple[Fit, dict[str, tuple[float, float]]]:
        """Those of the selected parameters that differ by more than both uncertainties: fit, and estimates by key.

        The least significant one leaves first; what it showed is then a possible error of the reference.
        """
        limit = norm.isf(DATA_FAULT_LEVEL / (2 * max(len(self.candidates), 1)))
        remaining = list(chosen)
        while True:
            fit = solve(self.model, _free(self.model, self.start, remaining))
            estimates = self._estimates(fit, remaining)
            if self.uncertainty is None or not remaining:
                return fit, estimates
            sigmas = {key: abs(change) / std for key, (change, std) in estimates.items()}
            weakest = min(sigmas, key=sigmas.get)
            if sigmas[weakest] >= limit:
                return fit, estimates
            remaining.remove(weakest)

    def _estimates(self, fit: Fit, chosen: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Difference and standard deviation of each chosen parameter."""
        change = fit.parameters.values - self.start.values
        indices = [self.start.index[key] for key in chosen]
        if self.uncertainty is None or not chosen:
            known = identifiability(fit.normal, fit.parameters, 1.0)
            std = dict(zip(known.keys, np.sqrt(np.diag(known.covariance))))
            return {key: (float(change[i]), float(std[key])) for key, i in zip(chosen, indices)}
        names, orthogonal, white, _ = _projected(self.model, fit.parameters, self.candidates)
        typical = fit.parameters.typical
        columns = orthogonal[[names.index(key) for key in chosen]]
        unfitted = white - (change[indices] / typical[indices]) @ columns
        sizes = typical[[self.start.index[name] for name in names]]
        common = self.uncertainty.factor(names, sizes).T @ orthogonal
        coefficients, std = generalised_least_squares(columns, -unfitted, common)
        scale = typical[indices]
        return dict(zip(chosen, zip((coefficients * scale).tolist(), (std * scale).tolist())))


def _rows(model, start, fit: Fit, candidates, estimates: Mapping) -> list[dict]:
    """A row a parameter: difference, standard deviation, sigmas, RMS displacement, what it is confounded with.

    estimates: difference and standard deviation of each parameter, by key.
    """
    confounded_terms = _confounded(model, start, fit, candidates, list(estimates))
    parameters_of_row = []
    for key, (change, std) in estimates.items():
        index = start.index[key]
        column = model.linearise(fit.parameters.only(np.arange(len(start)) == index))[1][0, :3]
        where, _, name = key.partition(".")
        parameters_of_row.append(
            {
                "name": name,
                "where": where,
                "value": change,
                "std": std,
                "sigmas": abs(change) / max(std, 1e-300),
                "unit": start.table[index].unit,
                "size_mm": float(np.sqrt(((column * change) ** 2).sum(0).mean())),
                "confounded_with": confounded_terms[key],
            }
        )
    return sorted(parameters_of_row, key=lambda row: -row["sigmas"])


def _confounded(model, start, fit: Fit, candidates, chosen) -> dict[str, list[str]]:
    """Named parameter -> what may stand in its place: single candidates and, joined by " + ", sets of two or three."""
    names, orthogonal, white, _ = _projected(model, fit.parameters, candidates)
    change = fit.parameters.values - start.values
    typical = fit.parameters.typical
    for key in chosen:  # the residual without the named parameters
        place = start.index[key]
        white = white - orthogonal[names.index(key)] * change[place] / typical[place]
    numbers = [names.index(key) for key in chosen]
    found = {}
    for key, number in zip(chosen, numbers):
        confounded_sets = alternative_sets(orthogonal, white, numbers, number)
        found[key] = [" + ".join(names[i] for i in combination) for combination in confounded_sets]
    return found


def _noise(reference: Reference, moving, fit: Fit) -> dict:
    """Stated and found 1 sigma of a coordinate (mm), their ratio, and the p-value that the statement is right."""
    rows = slice(0, min(3, len(fit.residual)))
    residual = fit.residual[rows]
    share = residual.size / fit.residual.size
    degrees = max(fit.degrees * share, 1.0)
    found = float(np.sqrt((residual**2).sum() / degrees))
    stated = reference.sigma_mm
    if stated is None and moving.sigma is not None:
        stated = float(np.sqrt(np.mean(moving.sigma**2)))
    if stated is None:
        return {"stated": None, "found": found, "factor": None, "p_value": None}
    ratio = degrees * (found / stated) ** 2
    p = 2 * min(chi2.sf(ratio, degrees), chi2.cdf(ratio, degrees))
    return {"stated": stated, "found": found, "factor": found / stated, "p_value": float(p)}


__all__ = ["Differences", "differences", "with_differences"]
