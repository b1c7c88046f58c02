"""Stability of the terms: what each adds to the predictions of folds that searched by themselves.

A confounded effect that is chosen in another fold stands for the term. To first order about the solution of all judged
samples with what a fold found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import CONFOUNDED_SHARE, MAJORITY
from workbench.diagnosis.linear.problem import Alternative, Finding, Problem
from workbench.diagnosis.validation.folds import Scheme, tested_samples
from workbench.diagnosis.validation.held_out import (
    critical_t,
    is_ambiguous,
    nested_components,
    rises_significantly,
    sigma_of,
    significance,
)
from workbench.diagnosis.validation.judging import combined_t, judging_schemes, without_others
from workbench.diagnosis.validation.left_out_blocks import left_out_rows
from workbench.diagnosis.validation.terms import Term

_MANY_COEFFICIENTS = 100
"""Coefficients of all terms from which on one kind of folds alone repeats the search. A repetition takes time with the
square of their number, and so many are found where the samples determine each of them well: a search without a fifth
of these finds the same."""


@dataclass(frozen=True)
class Nested:
    """A scheme with errors (n,) of the baseline, `baseline_errors`, and of what every fold found by itself.

    `found`: fold -> findings of the search without it; `t` of the gain, as of `significance`. `is_searched`: whether
    the folds searched; where not, every fold is predicted with the terms of all samples.
    """

    scheme: Scheme
    baseline_errors: np.ndarray
    errors: np.ndarray
    found: dict[int, list[Finding]]
    t: float
    is_searched: bool = True


def stable_terms(
    bench, terms: Sequence[Term], nested: Sequence[Nested], inliers: np.ndarray
) -> tuple[list[Term], list[Term]]:
    """The terms whose gain is significant, too, where each fold knows only what was found without it; and the others.

    inliers (n,) bool: samples that are no outliers. No term stays where what the folds found does not predict what they
    have not seen, and none of which no fold reselects most: what predicts there is then another effect.
    """
    nested = [result for result in nested if result.is_searched]
    if not terms:
        return [], []
    judging = schemes_judging_all(bench, terms, [result.scheme for result in nested])
    values = [result.t for result in nested if result.scheme in judging]
    t = combined_t(values, bench.sigma)
    if not t > critical_t(bench.sigma):
        reason = f"the nested search does not reduce the held-out error significantly (t = {t:.1f})"
        lost = [replace(term, kept=False, t_nested=t, reason=reason) for term in terms]
        return [], lost
    folds = _Folds(bench, terms, nested, inliers)
    tested = [folds.tested_in_folds(number, term) for number, term in enumerate(terms)]
    return [result for result in tested if result.kept], [
        result for result in tested if not result.kept
    ]


def schemes_judging_all(bench, terms: Sequence[Term], schemes: Sequence[Scheme]) -> list[Scheme]:
    """The schemes that can judge every term; where no scheme can, those that can judge the largest."""
    findings = [term.finding for term in terms]
    part = tested_samples(bench)
    problem = bench.problem(effects_of(findings), part, hypotheses=False)
    originals = {scheme.at(part): scheme for scheme in schemes}
    judging_sets = []
    for finding, indices in zip(findings, effect_indices(findings)):
        judging = judging_schemes(bench, finding.effects, list(originals), problem, indices)
        judging_sets.append([originals[judge] for judge in judging])
    common = [
        scheme
        for scheme in schemes
        if all(scheme in judges_of_term for judges_of_term in judging_sets)
    ]
    return common or judging_sets[int(np.argmax([finding.gain for finding in findings]))]


def searched_schemes(bench, terms: Sequence[Term], candidates: Sequence[Scheme]) -> list[Scheme]:
    """The schemes whose folds repeat the search: all, or the first that can judge every term where these are large."""
    if not is_large([term.finding for term in terms], bench):
        return list(candidates)
    return schemes_judging_all(bench, terms, candidates)[:1]


def is_large(findings: Sequence[Finding], bench) -> bool:
    """Whether findings on an arm have so many coefficients that one kind of folds alone repeats the search."""
    if bench.chain is None:
        return False
    count = sum(len(effect.parameters(bench.chain)) for effect in effects_of(findings))
    return count > _MANY_COEFFICIENTS


class _Folds:
    """The judged samples solved with what each fold found, and with all terms; as linear problems."""

    def __init__(self, bench, terms: Sequence[Term], nested: Sequence[Nested], inliers: np.ndarray):
        part = tested_samples(bench)
        if part is None:
            used = np.ones(len(bench.pose), bool)
        else:
            used = part
        findings = [term.finding for term in terms]
        self._bench, self._pose, self._usual = bench, bench.pose[used], inliers[used]
        self._part = part
        self._sigma = sigma_of(bench, part)
        self._problem = bench.problem(effects_of(findings), part, hypotheses=False)
        self._numbers = effect_indices(findings)
        self._moved = _displacements(self._problem, findings)
        self._solved = {
            result.scheme.at(part): _solved(bench, result.found, part) for result in nested
        }

    def tested_in_folds(self, number: int, term: Term) -> Term:
        """The term with its t in the folds, and whether it is kept."""
        moved = self._moved[number]
        t = self._t(term.finding, self._numbers[number], moved)
        if rises_significantly(min(t), self._sigma):
            nested = min(t)
        else:
            nested = max(t)
        folds = [fold for rows in self._solved.values() for fold in rows.values()]
        found = [fold.holds(term.finding, moved) for fold in folds]
        replaced = [_is_reselected(moved, fold.displacements) for fold in folds]
        judged_term = replace(
            term,
            finding=_limited_by_reselection(term.finding, sum(replaced), len(folds)),
            reselected_folds=sum(replaced),
            searched_folds=len(folds),
            t_nested=nested,
        )
        is_significant = nested > critical_t(self._sigma)
        if is_significant and any(replaced):
            return judged_term
        reason = f"what the nested search finds in its place does not reduce the held-out error (t = {nested:.1f})"
        if is_significant:
            reason = (
                "no fold finds it: what the folds find under its name, or what is confounded with it, makes something "
                "else"
            )
        elif not any(found) and any(replaced):
            reason = (
                "it is not needed: no fold finds it or what is confounded with it, and other terms together make the "
                "same there"
            )
        return replace(judged_term, kept=False, reason=reason)

    def _t(self, finding: Finding, indices: Sequence[int], moved: np.ndarray) -> list[float]:
        """t of the gain of a finding in each scheme that can judge it."""
        out = []
        schemes = list(self._solved)
        for scheme in judging_schemes(
            self._bench, finding.effects, schemes, self._problem, indices
        ):
            solved = self._solved[scheme]
            scored = self._sigma is not None
            pair = self._nested_components(scheme, solved, (finding, moved), scored)
            out.append(significance(self._pose, *pair, self._usual, self._sigma))
        return out

    def _nested_components(
        self, scheme: Scheme, folds: dict[int, "_SolvedFold"], left_out, scored: bool
    ) -> np.ndarray:
        """(2, m, n) components of the errors where every fold is predicted with what was found without it.

        Without a finding and with it, as of `nested_components` and `without_others`. left_out: the finding, and
        its displacement, as of `_displacements`.
        """
        components = {}
        for k, solved in folds.items():
            others, all_indices = [], []
            for f, m, numbers in zip(
                solved.findings, solved.displacements, effect_indices(solved.findings)
            ):
                all_indices += numbers
                others += [] if _same(f, m, *left_out) else numbers
            problems = [
                without_others(self._bench, solved.problem, indices, self._part)
                for indices in (others, all_indices)
            ]
            components[k] = self._components(problems, solved, scheme.fold == k, scored)
        out = np.full_like(next(iter(components.values())), np.nan)
        for k, part in components.items():
            out[..., scheme.fold == k] = part[..., scheme.fold == k]
        return out

    def _components(
        self, problems: Sequence[Problem], solved: "_SolvedFold", block: np.ndarray, scored: bool
    ) -> np.ndarray:
        """(2, m, n) `nested_components` of two models of what a fold found, for the samples held out, block (n,) bool.

        nan for samples that what the fold found does not predict, see `is_ambiguous`: as in the held-out errors.
        """
        fold = np.where(block, 0, -1)
        rows = np.stack([left_out_rows(problem, fold, 0, scored) for problem in problems])
        if self._bench.chain is None:
            nested = nested_components(problems[0], fold, rows, scored)
            return np.stack(nested)
        effects = effects_of(solved.findings)
        ambiguous = block & is_ambiguous(self._bench, effects, block, self._part)
        rows[:, ambiguous[problems[0].sample]] = 0.0  # they decorrelate no others
        components = np.stack(nested_components(problems[0], fold, rows, scored))
        components[..., ambiguous] = np.nan
        return components


@dataclass(frozen=True)
class _SolvedFold:
    """Findings of a fold, the problem of the judged samples with them, and their `_displacements`."""

    findings: list[Finding]
    problem: Problem
    displacements: list[np.ndarray]

    def holds(self, finding: Finding, moved: np.ndarray) -> bool:
        """Whether the fold found a finding, or what is confounded with it; moved (N,): what this makes."""
        pairs = zip(self.findings, self.displacements)
        return any(_same(solved, made, finding, moved) for solved, made in pairs)


def _solved(bench, nested: dict[int, list[Finding]], part) -> dict[int, _SolvedFold]:
    """Terms of each fold, with a part (n,) bool of the samples (None: all) solved with them."""
    out = {}
    for k, found in nested.items():
        problem = bench.problem(effects_of(found), part, hypotheses=False)
        out[k] = _SolvedFold(found, problem, _displacements(problem, found))
    return out


def _displacements(problem: Problem, findings: Sequence[Finding]) -> list[np.ndarray]:
    """(N,) mm, px: what each finding makes, orthogonal to the baseline."""
    bare = problem.conditional_on(())
    return [
        problem.units
        * bare.orthogonalise(sum(problem.added[i] @ problem.values[i] for i in indices))
        for indices in effect_indices(findings)
    ]


def _limited_by_reselection(finding: Finding, reselected: int, searched: int) -> Finding:
    """The finding, of fewer than half of the folds with at most the probability that one more fold reselects it.

    A term that only a minority of the folds selects has no bound on the number of false selections: Meinshausen and
    Buehlmann, J. R. Stat. Soc. B 72 (2010), theorem 1. The probability is that of Laplace's rule of succession.
    """
    limit = (reselected + 1) / (searched + 2)
    if reselected >= MAJORITY * searched or finding.probability <= limit:
        return finding
    other = Alternative(
        "unknown",
        finding.where,
        "several other effects together",
        finding.probability - limit,
        1.0,
        f"only {reselected} of {searched} folds find it",
    )
    alternatives = (other, *finding.alternatives)
    return replace(finding, probability=limit, alternatives=alternatives)


def _is_reselected(moved: np.ndarray, others: list[np.ndarray]) -> bool:
    """Whether what some findings make together is most of what one makes, (N,) each, by whatever names, and as it does.

    What they make is scaled as is best, since a fold finds another size, but not turned round.
    """
    if not others:
        return False
    columns = np.stack(others, 1)
    share = least_squares(columns, moved)
    like = np.maximum(share, 0.0) @ columns.T
    return bool(((moved - like) ** 2).sum() < (1 - MAJORITY) * (moved**2).sum())


def _same(finding: Finding, displacement: np.ndarray, other: Finding, moved: np.ndarray) -> bool:
    """Whether two findings are one: the same effect at one place, or effects that are confounded in these poses.

    displacement, moved (N,): what the two make.
    """
    product = float((displacement**2).sum() * (moved**2).sum())
    return (
        _name(finding) in _names(other)
        or float(displacement @ moved) ** 2 >= CONFOUNDED_SHARE * product > 0
    )


def _names(finding: Finding) -> set[tuple[str, str]]:
    """A finding, its effects and its alternatives: what is about as likely in its place, or explains as much there."""
    alternatives = (
        a
        for a in finding.alternatives
        if a.probability >= 1 - CONFOUNDED_SHARE or a.squared_correlation >= CONFOUNDED_SHARE
    )
    return {_name(named) for named in (finding, *finding.effects, *alternatives)}


def _name(named) -> tuple[str, str]:
    return named.effect, named.where


def effect_indices(findings) -> list[list[int]]:
    """Numbers of each finding's effects among those of all, in order."""
    counts = (len(f.effects) for f in findings)
    edges = np.cumsum([0, *counts])
    return [list(range(a, b)) for a, b in zip(edges, edges[1:])]


def effects_of(findings: Sequence[Finding]) -> tuple[Effect, ...]:
    """The effects of some findings, in order."""
    return tuple(e for finding in findings for e in finding.effects)
