"""Proof of what a search found: errors on samples that no step of it saw, and permutation controls.

First the whole: the search is repeated inside each fold, and what it finds there must predict the other samples
better than the baseline does. Then each term, by leaving it out with all others in place; the weakest goes first, and
the others are judged again without it. Last, each term's part in what the folds found by themselves, where a confounded
effect that is chosen in another fold stands for the term.

Each step uses only the splits that can judge the terms (`judging`): a law of time is judged by blocks of the
workspace, a curve by splits that leave no range of its angle out. The terms that stay reduce the held-out error there.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from robot_model.effects.transmission import TransmissionHarmonic
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import ALIKE
from workbench.diagnosis.linear.problem import Bench, Finding, Found, Problem
from workbench.diagnosis.validation.conditional_gains import ConditionalGains
from workbench.diagnosis.validation.controls import controls
from workbench.diagnosis.validation.folds import JUDGED, Scheme, schemes, thinned
from workbench.diagnosis.validation.heldout import Errors, left_out, paired, rms, sigma_of
from workbench.diagnosis.validation.judging import (
    REAL,
    Judged,
    combined_t,
    headline,
    is_supported,
    judging_schemes,
    not_supported,
    with_carriers,
    with_possible_masses,
)
from workbench.diagnosis.validation.parallel import searches
from workbench.diagnosis.validation.terms import Proof, Term

_WAVE = TransmissionHarmonic.effect
_MOTOR = 10  # times as likely as most orders, from which on an order is one of the motor
_MOST = 0.5  # of what a term makes, that others make of it
Find = Callable[[Bench, np.ndarray], list[Finding]]
Say = Callable[[str], None]


@dataclass(frozen=True)
class _Whole:
    """Errors by scheme: of the baseline and of what every fold found by itself, `nested`, fold by fold; `t` of each."""

    schemes: list[Scheme]
    plain: list[np.ndarray]
    errors: list[np.ndarray]
    nested: list[dict[int, list[Finding]]]
    t: list[float]


def prove(
    bench: Bench,
    found: Found,
    find: Find,
    noise: tuple[float, str],
    say: Say = lambda text: None,
    jobs: int = 1,
):
    """(Proof, terms that stay, terms refused) of what was found on all samples.

    find: the search for terms, made inside each fold as find(bench, samples). noise: RMS distance that the
    instrument leaves (mm, px), and how it is known. A term stays where its held-out gain conditional on the others is
    real, where it is real, too, in what the folds found by themselves, and where it passes its controls. jobs:
    processes that search the folds.
    """
    usual = ~found.outliers
    errors = Errors(bench)
    terms, refused = _inside(found.after, *_earned(bench, list(found.findings), None, say))
    whole = _whole(bench, found, find if terms else None, errors, say, jobs)
    terms, lost = _stable(errors, terms, whole, usual)
    terms, more = _controlled(bench, terms, say)
    terms, orphans = with_carriers(bench, terms)
    terms, impossible = with_possible_masses(bench, terms)
    gone = [*refused, *lost, *more, *orphans, *impossible]
    terms, worse, rows = _supported(errors, terms, gone, whole, usual)
    effects = _effects([term.finding for term in terms])
    fixed = [errors(effects, s.fold) for s in whole.schemes] if effects else whole.plain
    made = _with_angles(_proof(bench, rows, fixed, noise, usual), errors, usual)
    return made, tuple(terms), (*gone, *worse)


def _with_angles(proof: Proof, errors: Errors, usual: np.ndarray) -> Proof:
    """The proof with the rotation angles that belong to its errors, where orientation is measured."""
    angles = np.stack([errors.angles_of(one) for one in proof.errors])
    if not np.isfinite(angles).any():
        return proof
    return replace(proof, angles=angles, angles_rms=(rms(angles[0], usual), rms(angles[1], usual)))


def _supported(errors: Errors, terms: list[Term], gone: list[Term], whole: _Whole, usual):
    """Terms that together reduce the held-out error, terms that do not, and the errors by scheme.

    Judged by what the folds found by themselves; where that fails, by that without what was refused. As long as the
    error does not fall, the term with the least support goes.
    """
    unit, sigma = errors.bench.unit, sigma_of(errors.bench)
    refused: list[Term] = []
    predicted = whole.errors
    while terms:
        judges = _judges_of_all(errors.bench, terms, whole.schemes)
        rows = _judged_rows(whole, predicted, judges, usual, sigma)
        if is_supported(rows):
            return terms, refused, rows
        if predicted is whole.errors and gone:
            predicted = _without(errors, whole, gone)
            continue
        weakest = min(terms, key=lambda term: term.t_nested)
        refused.append(not_supported(weakest, rows, unit))
        left = [term for term in terms if term is not weakest]
        terms, orphans = with_carriers(errors.bench, left)
        refused += orphans
        predicted = _without(errors, whole, [*gone, *refused])
    return [], refused, _judged_rows(whole, whole.plain, whole.schemes, usual, sigma)


def _without(errors: Errors, whole: _Whole, refused: Sequence[Term]) -> list[np.ndarray]:
    """Errors (n,) by scheme of what the folds found by themselves, except what is one of the refused terms."""
    out = []
    for scheme, found, plain in zip(whole.schemes, whole.nested, whole.plain):
        kept = {}
        for k, findings in found.items():
            left = [
                f for f in findings if not any(_is_finding(f, term.finding) for term in refused)
            ]
            kept[k] = _effects(left)
        out.append(errors.predicted(scheme, kept, plain))
    return out


def _is_finding(finding: Finding, other: Finding) -> bool:
    return _name(finding) == _name(other)


def _judges_of_all(bench, terms: Sequence[Term], parts: list[Scheme]) -> list[Scheme]:
    """The schemes that can judge every term; where no scheme can, those that can judge the largest."""
    findings = [term.finding for term in terms]
    problem = bench.problem(_effects(findings), hypotheses=False)
    numbers = _numbered(findings)
    able = [
        judging_schemes(bench, f.effects, parts, problem, own) for f, own in zip(findings, numbers)
    ]
    common = [s for s in parts if all(any(s is one for one in mine) for mine in able)]
    return common or able[int(np.argmax([f.gain for f in findings]))]


def _judged_rows(whole: _Whole, predicted, judges: Sequence[Scheme], usual, sigma) -> list[Judged]:
    """Errors by scheme; those of several kinds of samples (corners, stripes) are weighted by their noise `sigma`."""
    rows = []
    for scheme, before, after in zip(whole.schemes, whole.plain, predicted):
        able = any(scheme is one for one in judges)
        rows.append(
            Judged(scheme, before, after, rms(before, usual, sigma), rms(after, usual, sigma), able)
        )
    return rows


def _inside(
    problem: Problem, terms: list[Term], refused: list[Term]
) -> tuple[list[Term], list[Term]]:
    """The terms but waves of the last order that was asked for, whose best order may be any beyond; and the refused."""
    waves = [s for s in problem.scans if s.effect == _WAVE]
    last = {
        s.where: s.options[s.mass < _MOTOR * np.median(s.mass)].max() for s in waves
    }  # a motor's: by themselves
    reason = "its order is the last that was asked for, so that the wave that is there may be any of a higher order"
    kept = []
    for term in terms:
        found = term.finding
        if found.effect == _WAVE and found.effects[0].order == last.get(found.where):
            refused = [*refused, replace(term, kept=False, reason=reason)]
        else:
            kept.append(term)
    return kept, refused


def _whole_is_insignificant(t: float) -> str:
    return f"the whole search, made on parts of the samples, does not predict the others better (t = {t:.1f})"


def _whole(bench, found: Found, find: Find | None, errors: Errors, say, jobs: int) -> _Whole:
    """The search repeated inside every fold of every scheme; None: there is nothing to be proved."""
    usual, parts = ~found.outliers, schemes(bench.pose, found.before)
    plain = [errors((), s.fold) for s in parts]
    if find is None:
        return _Whole(parts, plain, plain, [{} for _ in parts], [0.0 for _ in parts])
    nested = _search_nested(bench, find, parts, say, jobs)
    made = [
        errors.predicted(s, {k: _effects(f) for k, f in a.items()}, p)
        for s, a, p in zip(parts, nested, plain)
    ]
    t = [
        paired(bench.pose, before, after, usual, sigma_of(bench))
        for before, after in zip(plain, made)
    ]
    return _Whole(parts, plain, made, nested, t)


def _proof(bench, rows: Sequence[Judged], fixed, noise, usual) -> Proof:
    """The figures of the scheme that judges; where nothing is claimed, the baseline predicts."""
    shown = headline(rows)
    at = next(i for i, row in enumerate(rows) if row is shown)
    t = paired(bench.pose, shown.before, shown.after, usual, sigma_of(bench))
    return Proof(
        before=shown.rms_before,
        after=shown.rms_after,
        fixed=rms(fixed[at], usual, sigma_of(bench)),
        t=t,
        folds=len(shown.scheme.folds),
        noise=noise[0],
        noise_from=noise[1],
        errors=np.stack([shown.before, shown.after]),
        fold=shown.scheme.fold,
        schemes=tuple(_scheme_row(bench, row, usual, same) for row, same in zip(rows, fixed)),
        scheme=shown.scheme.name,
    )


def _scheme_row(bench, row: Judged, usual, fixed) -> dict:
    return {
        "folds_by": row.scheme.name,
        "folds": len(row.scheme.folds),
        "before": row.rms_before,
        "after": row.rms_after,
        "after_same_terms": rms(fixed, usual, sigma_of(bench)),
        "t": paired(bench.pose, row.before, row.after, usual, sigma_of(bench)),
        "judges": row.judges,
    }


def _search_nested(
    bench, find: Find, parts: list[Scheme], say, jobs: int
) -> list[dict[int, list[Finding]]]:
    """What the search finds on the other folds, and what of it a held-out test on those alone leaves, fold by fold."""
    found: list[dict[int, list[Finding]]] = [{} for _ in parts]
    work = [(i, s, k) for i, s in enumerate(parts) for k in s.folds]
    say(f"the whole search repeated without each of {len(work)} blocks")
    start = time.perf_counter()
    with searches(bench, partial(earned_inside, find=find), jobs) as searched:
        results = searched([s.fold != k for _, s, k in work])
        for done, ((i, s, k), terms) in enumerate(zip(work, results), 1):
            found[i][k] = terms
            left = (time.perf_counter() - start) / done * (len(work) - done)
            say(
                f"{s.name}: the whole search was made without block {k + 1} of {len(s.folds)}; "
                f"about {left:.0f} s left"
            )
    return found


def earned_inside(bench: Bench, samples: np.ndarray, find: Find) -> list[Finding]:
    """What search and held-out test leave on `samples` (n,) bool, which are then all that it has seen.

    Fewer of them where the bench can do with fewer; a bench that is `whole` sees in a fold what it saw outside.
    """
    searched = judged = samples
    if not bench.whole:
        searched, judged = thinned(bench.pose, samples), thinned(bench.pose, samples, JUDGED)
    return [term.finding for term in _earned(bench, find(bench, searched), judged)[0]]


def _earned(
    bench, findings: list[Finding], samples, say: Say = lambda text: None
) -> tuple[list[Term], list[Term]]:
    """Terms with a real held-out gain conditional on one another, and the removed ones, in the problem solved with all.

    To first order about that solution, by samples left out of the linearised fit.
    """
    say(f"held-out gain of {len(findings)} terms, each conditional on the others")
    if not findings:
        return [], []
    problem = bench.problem(_effects(findings), samples, hypotheses=False)
    numbers = dict(zip(map(id, findings), _numbered(findings)))
    trial = ConditionalGains(bench, problem, sigma_of(bench, samples))

    def judged(left: Sequence[Term]) -> list[Term]:
        kept = [i for term in left for i in numbers[id(term.finding)]]
        return [trial.judged(term, numbers[id(term.finding)], kept) for term in left]

    left, gone = _without_insignificant(judged, [Term(f) for f in findings])
    for _ in findings:
        again = _with_best(judged, left, gone)
        if again is None:
            break
        left, lost = _without_insignificant(judged, again)
        gone = [term for term in gone if not any(term.finding is t.finding for t in left)]
        gone += [t for t in lost if not any(t.finding is term.finding for term in gone)]
    return left, gone


Judge = Callable[[Sequence[Term]], list[Term]]


def _without_insignificant(judged: Judge, terms: Sequence[Term]) -> tuple[list[Term], list[Term]]:
    """Terms whose gain conditional on one another is real, and the others; the weakest goes first."""
    left, gone = list(terms), []
    while left:
        left = judged(left)
        worst = min(left, key=lambda term: term.t)
        if worst.t > REAL and worst.gain > 0:
            break
        gone.append(replace(worst, kept=False, reason=_insignificant(worst.t)))
        left.remove(worst)
    return left, gone


def _with_best(judged: Judge, left: list[Term], gone: Sequence[Term]) -> list[Term] | None:
    """The terms with the one of those removed whose gain next to them is largest and real; None where there is none.

    Of two terms that share a signature the wrong one may go first, and with it what needs it.
    """
    best = None
    for term in gone:
        candidate = judged([*left, Term(term.finding)])[-1]
        if candidate.t > REAL and candidate.gain > 0:
            best = max(best, candidate, key=lambda one: one.t) if best else candidate
    return None if best is None else [*left, best]


def _insignificant(t: float) -> str:
    return f"its held-out gain conditional on the others is not significant (t = {t:.1f}; required: above {REAL:g})"


def _numbered(findings) -> list[list[int]]:
    """Numbers of each finding's effects among those of all, in order."""
    edges = np.cumsum([0, *(len(f.effects) for f in findings)])
    return [list(range(a, b)) for a, b in zip(edges, edges[1:])]


def _stable(errors: Errors, terms, whole: _Whole, usual) -> tuple[list[Term], list[Term]]:
    """The terms whose gain is real, too, where each fold knows only what was found without it; and the others.

    None at all where the whole does not help to predict what it has not seen: what it says is luck then.
    """
    bench = errors.bench
    if terms:
        judges = _judges_of_all(bench, terms, whole.schemes)
        t = combined_t(
            [value for s, value in zip(whole.schemes, whole.t) if any(s is one for one in judges)]
        )
        if not t > REAL:
            return [], [
                replace(term, kept=False, t_nested=t, reason=_whole_is_insignificant(t))
                for term in terms
            ]
    kept, lost = [], []
    folds = [_solved(bench, a) for a in whole.nested] if terms else []
    with_all = [_linear(s, rows) for s, rows in zip(whole.schemes, folds)]
    findings = [term.finding for term in terms]
    problem, numbers = (
        (bench.problem(_effects(findings), hypotheses=False), _numbered(findings))
        if terms
        else (None, [])
    )
    own = _made(problem, findings) if terms else []
    made = [one.made for rows in folds for one in rows.values()]
    ways = tuple((scheme.name, len(rows)) for scheme, rows in zip(whole.schemes, folds))
    for term, moved, mine in zip(terms, own, numbers):
        t = []
        for scheme in judging_schemes(bench, term.finding.effects, whole.schemes, problem, mine):
            at = next(i for i, one in enumerate(whole.schemes) if one is scheme)
            less = _linear(scheme, folds[at], (term.finding, moved))
            t.append(paired(bench.pose, less, with_all[at], usual, sigma_of(bench)))
        again = sum(_alike(moved, others) for others in made)
        nested = min(t) if min(t) < -REAL else max(t)
        term = replace(term, again=again, chances=len(made), t_nested=nested, ways=ways)
        if term.t_nested > REAL:
            kept.append(term)
        else:
            reason = f"where the search is repeated inside the folds, it does not predict the others (t = {nested:.1f})"
            lost.append(replace(term, kept=False, reason=reason))
    return kept, lost


@dataclass(frozen=True)
class _Solved:
    """What a fold found, the problem of all samples solved with it, and what each finding makes, as of `_made`."""

    findings: list[Finding]
    problem: Problem
    made: list[np.ndarray]


def _solved(bench, nested: dict[int, list[Finding]]) -> dict[int, _Solved]:
    """What each fold found, with all samples solved with that."""
    out = {}
    for k, found in nested.items():
        problem = bench.problem(_effects(found), hypotheses=False)
        out[k] = _Solved(found, problem, _made(problem, found))
    return out


def _made(problem: Problem, findings: Sequence[Finding]) -> list[np.ndarray]:
    """(N,) mm, px: what each finding makes, orthogonal to the baseline."""
    bare = problem.conditional_on(())
    unit = problem.sigma / np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    return [
        unit * bare.clear(sum(problem.added[i] @ problem.values[i] for i in own))
        for own in _numbered(findings)
    ]


def _alike(moved: np.ndarray, others: list[np.ndarray]) -> bool:
    """Whether what some findings make together is most of what one makes, (N,) each, by whatever names, and as it does.

    What they make is scaled as is best, since a fold finds another size, but not turned round.
    """
    if not others:
        return False
    made = np.stack(others, 1)
    share = least_squares(made, moved)
    like = np.maximum(share, 0.0) @ made.T
    return bool(((moved - like) ** 2).sum() < (1 - _MOST) * (moved**2).sum())


def _linear(scheme: Scheme, folds: dict[int, _Solved], without=None) -> np.ndarray:
    """(n,) errors where every fold is predicted with what was found without it, to first order.

    without: a finding that is left out, and what it makes, as of `_made`.
    """
    out = np.empty(len(scheme.fold))
    for k, solved in folds.items():
        numbers = _numbered(solved.findings)
        kept = [i for own in numbers for i in own]
        if without is not None:
            same = [_same(f, m, *without) for f, m in zip(solved.findings, solved.made)]
            kept = [i for own, is_same in zip(numbers, same) if not is_same for i in own]
        mine = scheme.fold == k
        problem = solved.problem.conditional_on(kept)
        out[mine] = left_out(problem, np.where(mine, 0, -1), only=0)[mine]
    return out


def _same(finding: Finding, made: np.ndarray, other: Finding, moved: np.ndarray) -> bool:
    """Whether two findings are one: the same effect at one place, or effects that are confounded in these poses.

    made, moved (N,): what the two make.
    """
    both = float((made**2).sum() * (moved**2).sum())
    return _name(finding) in _names(other) or float(made @ moved) ** 2 >= ALIKE * both > 0


def _names(finding: Finding) -> set[tuple[str, str]]:
    """A finding, its effects and its alternatives: what is about as likely in its place, or explains as much there."""
    alternatives = (
        a for a in finding.alternatives if a.probability >= 1 - ALIKE or a.alike >= ALIKE
    )
    return {_name(one) for one in (finding, *finding.effects, *alternatives)}


def _name(one) -> tuple[str, str]:
    return one.effect, one.where


def _controlled(bench, terms: list[Term], say) -> tuple[list[Term], list[Term]]:
    """The terms with their controls, and those that failed them."""
    kept, failed = [], []
    for term in terms:
        say(f"controls of {term.title}")
        others = _effects([other.finding for other in terms if other is not term])
        made = replace(term, controls=controls(bench, others, term.finding.effects))
        broken = [one.kind for one in made.controls if one.passed is False]
        if broken:
            reason = f"what it depends on, {' and '.join(broken)}, gains as much"
            failed.append(replace(made, kept=False, reason=reason))
        else:
            kept.append(made)
    return kept, failed


def _effects(findings: Sequence[Finding]) -> tuple[Effect, ...]:
    return tuple(e for finding in findings for e in finding.effects)


__all__ = ["REAL", "earned_inside", "prove"]
