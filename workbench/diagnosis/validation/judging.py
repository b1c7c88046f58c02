"""Which splits of the samples can judge a term, and whether the terms together reduce the held-out error there.

A split judges a term only where the term can be predicted across it:

- a law of time (a step, a drift) cannot be predicted across a block of time that was not measured;
- a curve cannot be extrapolated to joint angles that only the block left out has.

Held-out errors before and after come from such a split, and terms that do not reduce that error are not kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.core.model import STATE_PORTS
from workbench.diagnosis.levels import CONFOUNDED_SHARE, OUTLIER_WEIGHT
from workbench.diagnosis.linear.problem import Problem, cached
from workbench.diagnosis.validation.controls import of_order
from workbench.diagnosis.validation.folds import TIME, Scheme, schemes
from workbench.diagnosis.validation.held_out import (
    critical_t,
    nested_components,
    paired_t,
    rises_significantly,
    rms,
    showing_poses,
    sigma_of,
    significance,
)
from workbench.diagnosis.validation.left_out_blocks import left_out_rows
from workbench.diagnosis.validation.terms import Term

_EXTRAPOLATED = 0.25
"""Share of what a term makes along directions that one block alone determines, from which on a split cannot judge it.

It does where it holds `CONFOUNDED_SHARE` of the information on a direction."""
_WORSE = 0.01
"""Relative rise of the held-out RMS that a split which judges the terms may show by chance."""


@dataclass(frozen=True)
class SchemeErrors:
    """Held-out errors (n,) of a scheme with the baseline and with the terms, their RMS, and `is_judging`: it can judge.

    `is_nested`: with what each fold found by itself; else with the terms of all samples, fitted without the fold.
    """

    scheme: Scheme
    before: np.ndarray
    after: np.ndarray
    rms_before: float
    rms_after: float
    is_judging: bool
    is_nested: bool = True

    @property
    def improves(self) -> bool:
        """Whether the terms reduce the error."""
        return self.rms_after < self.rms_before

    @property
    def worsens(self) -> bool:
        """Whether the terms raise the error by more than rounding of the estimate."""
        return not self.rms_after <= self.rms_before * (1 + _WORSE)


def judging_schemes(
    bench,
    effects: Sequence[Effect],
    candidates: Sequence[Scheme],
    problem: Problem,
    numbers: Sequence[int],
) -> list[Scheme]:
    """The schemes that can judge these effects; all of them where none can.

    problem: solved with the effects, whose numbers among its `added` are `numbers`.
    """
    able = list(candidates)
    if len(able) > 1 and of_order(bench, effects):
        able = [s for s in able if s.name != TIME]
    able = [s for s in able if extrapolated_share(problem, numbers, s.fold) <= _EXTRAPOLATED]
    return able or list(candidates)


def extrapolated_share(problem: Problem, numbers: Sequence[int], fold: np.ndarray) -> float:
    """Share (0-1) of what some effects make that only the block left out determines; fold (n,) int.

    With the effects' columns orthogonal to the baseline, orthonormal basis Q, and Q_b its rows of block b, the
    eigenvalues of Q_b' Q_b say which share of the information on each direction lies in the block.
    """
    bare = problem.conditional_on(())
    columns = np.concatenate([problem.added[i] for i in numbers], axis=1)
    basis = bare.orthogonal_basis(columns)
    contribution = bare.orthogonalise(sum(problem.added[i] @ problem.values[i] for i in numbers))
    total = float(contribution @ contribution)
    if not basis.shape[1] or not total > 0:
        return 0.0
    coordinates = basis.T @ contribution
    blocks = fold[problem.sample]
    lost = 0.0
    for k in np.unique(blocks):
        rows = basis[blocks == k]
        information, directions = symmetric_eigen(rows.T @ rows)
        alone = directions[:, information > CONFOUNDED_SHARE]
        lost += float(((alone.T @ coordinates) ** 2).sum())
    return lost / total


def require_compliances(bench, terms: Sequence[Term]) -> tuple[list[Term], list[Term]]:
    """The terms, and refused those that need a compliance where neither baseline nor terms hold one.

    A change of load with a deflection of each joint needs none: the same joints before and after an instant show it,
    also where the weight of the links deflects them by too little to be retained.
    """
    effects = [effect for term in terms for effect in term.finding.effects]
    baseline = getattr(bench, "baseline", ())
    if any(effect.carries_load for effect in (*baseline, *effects)):
        return list(terms), []
    reason = "it acts only through a compliance, and none is retained"
    orphans = [t for t in terms if any(map(_has_no_deflection, t.finding.effects))]
    retained = [t for t in terms if not any(t is orphan for orphan in orphans)]
    refused = [replace(t, kept=False, reason=reason) for t in orphans]
    return retained, refused


def _has_no_deflection(effect: Effect) -> bool:
    """Whether an effect needs a compliance, and is no change with deflections of its own."""
    is_change = effect.port not in STATE_PORTS and getattr(effect, "after", None) is not None
    return effect.needs_compliance and not is_change


def combined_t(values: Sequence[float], sigma: np.ndarray | None) -> float:
    """One t over several schemes: their mean, but the worst where one of them says that the error rises.

    sigma: of the bench, see `critical_t`.
    """
    if rises_significantly(min(values), sigma):
        return min(values)
    return float(np.mean(values))


def reported_scheme(rows: Sequence[SchemeErrors]) -> SchemeErrors:
    """The scheme whose errors are shown: the first nested one that judges and improves, else the first that judges."""
    nested = [row for row in rows if row.is_nested]
    judging = [row for row in nested if row.is_judging] or nested
    improving = (row for row in judging if row.improves)
    return next(improving, judging[0])


def is_supported(rows: Sequence[SchemeErrors]) -> bool:
    """Whether the terms reduce the held-out error in a scheme that can judge them, and raise it in none of these."""
    judging = [row for row in rows if row.is_judging] or list(rows)
    return reported_scheme(rows).improves and not any(row.worsens for row in judging)


def refused_term(term: Term, rows: Sequence[SchemeErrors], unit: str) -> Term:
    """The term as refused, with the reason."""
    judging = [row for row in rows if row.is_judging] or list(rows)
    worst = max(judging, key=lambda row: row.rms_after / max(row.rms_before, 1e-300))
    change = "rises" if worst.rms_after > worst.rms_before else "does not fall"
    reason = (
        f"the held-out error ({worst.scheme.name}) {change} with all terms that were found ({worst.rms_before:.3g} "
        f"{unit} before, {worst.rms_after:.3g} {unit} with them), and of these this one has the least support"
    )
    return replace(term, kept=False, reason=reason)


def without_others(bench, problem: Problem, indices: Sequence[int], samples) -> Problem:
    """A problem with the effects numbered `indices` alone; samples (n,) bool that it contains (None: all).

    To first order about its own solution, unless a load or a tilt is removed. The compliances would keep the loaded
    torque, with which they imitate nearly all of the effect of the load: the model without it is solved again.
    """
    effects = problem.effects
    others = [effect for i, effect in enumerate(effects) if i not in indices]
    if not any(effect.port in STATE_PORTS for effect in others):
        return problem.conditional_on(indices)
    chosen = [effects[i] for i in indices]
    return bench.problem(chosen, samples, hypotheses=False).conditional_on()


class ConditionalGains:
    """The held-out gain of terms conditional on one another, about one solution with all of them: `without_others`."""

    def __init__(self, bench, problem: Problem, samples=None):
        self._bench, self._problem, self._samples = bench, problem, samples
        self._sigma = sigma_of(bench, samples)
        self._schemes = schemes(problem.pose, problem)
        self._judges: dict[tuple, list[Scheme]] = {}
        self._rows: dict[tuple, np.ndarray] = {}
        self._problems: dict[tuple, Problem] = {}

    def with_gains(self, term: Term, indices: Sequence[int], present: Sequence[int]) -> Term:
        """The term, of the effects `indices`, with t, t_fall and gain of its presence among the effects `present`."""
        inliers = self._problem.weights > OUTLIER_WEIGHT
        sigma = self._sigma
        pose = self._problem.pose
        others = [i for i in present if i not in indices]
        t, falls, gain, showing = [], [], [], []
        for scheme in self._judges_of(term, tuple(indices)):
            base, with_it = self._left_out(scheme, others, present)
            t.append(significance(pose, base, with_it, inliers, sigma))
            lengths = [np.sqrt((errors**2).sum(0)) for errors in (base, with_it)]
            falls.append(paired_t(pose, *lengths, inliers, sigma))
            gain.append(rms(lengths[0], inliers, sigma) - rms(lengths[1], inliers, sigma))
            if sigma is not None:
                showing.append(showing_poses(pose, *lengths, inliers, sigma))
        worst = int(np.argmin(t))
        known = combined_t(t, sigma)
        return replace(
            term,
            t=known,
            t_fall=float(np.mean(falls)),
            gain=gain[0] if known > critical_t(sigma) else gain[worst],
            showing_poses=min(showing, default=None),
        )

    def _judges_of(self, term: Term, indices: tuple[int, ...]) -> list[Scheme]:
        def make():
            return judging_schemes(
                self._bench, term.finding.effects, self._schemes, self._problem, indices
            )

        return cached(self._judges, indices, make)

    def _left_out(self, scheme: Scheme, others: Sequence[int], present: Sequence[int]):
        """`nested_components` next to the effects `others` and `present`."""
        rows = [self._left_out_rows(scheme, indices) for indices in (others, present)]
        return nested_components(
            self._problem_with(others), scheme.fold, rows, self._sigma is not None
        )

    def _problem_with(self, indices: Sequence[int]) -> Problem:
        def make():
            return without_others(self._bench, self._problem, indices, self._samples)

        return cached(self._problems, tuple(sorted(indices)), make)

    def _left_out_rows(self, scheme: Scheme, indices: Sequence[int]) -> np.ndarray:
        """(N,) `left_out_rows` next to some effects; those of a sensor scored."""

        def make():
            problem = self._problem_with(indices)
            return left_out_rows(problem, scheme.fold, scored=self._sigma is not None)

        return cached(self._rows, (scheme.name, *sorted(indices)), make)
