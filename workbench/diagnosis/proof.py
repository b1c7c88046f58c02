"""Proof of what a search found: errors on samples that no step of it saw, and what is left when a cause is scrambled.

First the whole: the search is made anew inside each fold, and what it finds there must predict the other samples
better than the baseline does. Then each term, by leaving it out with all others in place; the weakest goes first, and
the others are judged again without it. Last, each term's part in what the folds found by themselves, where a twin that
is chosen in another fold stands for the term.

A law of time cannot be carried into a stretch of time that was not measured, so that it is judged by blocks of the
workspace alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from workbench.core.effect import Effect
from workbench.diagnosis.controls import controls, of_order
from workbench.diagnosis.folds import TIME, Scheme, schemes, thinned
from workbench.diagnosis.heldout import Errors, left_out, paired, rms, sigma_of
from workbench.diagnosis.parallel import searches
from workbench.diagnosis.problem import Bench, Finding, Found, Problem
from workbench.diagnosis.result import Proof, Term

REAL = 2.0
"""t of the paired gains above which a held-out gain is taken for real."""
_WAVE = "transmission-harmonic"
_LIKELY, _ALIKE = 0.1, 0.9  # probability, or share of a finding's signature, from which on another is its twin
_MOTOR = 10  # times as likely as most orders, from which on an order is one of the motor
_MOST = 0.5  # of what a term makes, that others make of it
_FAR = 0.05  # robust weight below which a sample is another process's
Find = Callable[..., Found]
Say = Callable[[str], None]


@dataclass(frozen=True)
class _Whole:
    """Errors by scheme: of the baseline and of what every fold found by itself, `anew`, fold by fold; and its `t`."""

    schemes: list[Scheme]
    plain: list[np.ndarray]
    errors: list[np.ndarray]
    anew: list[dict[int, list[Finding]]]
    t: float


def prove(
    bench: Bench, found: Found, find: Find, noise: tuple[float, str], say: Say = lambda text: None, jobs: int = 1
):
    """(Proof, terms that stay, terms refused) of what `find(bench)` found on all samples.

    find: the whole search, called again inside each fold as find(bench, samples). noise: RMS distance that the
    instrument leaves (mm, px), and how it is known. A term stays where its held-out gain beside the others is real,
    where it is real, too, in what the folds found by themselves, and where it passes its controls. jobs: processes
    that search the folds.
    """
    usual = ~found.outliers
    errors = Errors(bench)
    terms, refused = _inside(found.before, *_earned(bench, list(found.findings), None, say))
    whole = _whole(bench, found, find if terms else None, errors, say, jobs)
    terms, lost = _stable(errors, terms, whole, usual)
    terms, more = _controlled(bench, terms, say)
    effects = _effects([term.finding for term in terms])
    fixed = [errors(effects, s.fold) for s in whole.schemes] if effects else whole.plain
    proof = _with_angles(_proof(bench, whole, fixed, noise, usual, bool(terms)), errors, usual)
    return proof, tuple(terms), (*refused, *lost, *more)


def _with_angles(proof: Proof, errors: Errors, usual: np.ndarray) -> Proof:
    """The proof with the rotation angles that belong to its errors, where orientation is measured."""
    angles = np.stack([errors.angles_of(one) for one in proof.errors])
    if not np.isfinite(angles).any():
        return proof
    return replace(proof, angles=angles, angles_rms=(rms(angles[0], usual), rms(angles[1], usual)))


def _inside(problem: Problem, terms: list[Term], refused: list[Term]) -> tuple[list[Term], list[Term]]:
    """The terms but waves of the last order that was asked for, whose best order may be any beyond; and the refused."""
    waves = [s for s in problem.scans if s.effect == _WAVE]
    last = {s.where: s.options[s.mass < _MOTOR * np.median(s.mass)].max() for s in waves}  # a motor's: by themselves
    reason = "its order is the last that was asked for, so that the wave that is there may be any of a higher order"
    kept = []
    for term in terms:
        found = term.finding
        if found.effect == _WAVE and found.effects[0].order == last.get(found.where):
            refused = [*refused, replace(term, kept=False, reason=reason)]
        else:
            kept.append(term)
    return kept, refused


def _luck(t: float) -> str:
    return f"the whole search, made on parts of the samples, does not predict the others better (t = {t:.1f})"


def _whole(bench, found: Found, find: Find | None, errors: Errors, say, jobs: int) -> _Whole:
    """The search anew inside every fold of every scheme; None: there is nothing to be proved."""
    usual, parts = ~found.outliers, schemes(bench.pose, found.before)
    plain = [errors((), s.fold) for s in parts]
    if find is None:
        return _Whole(parts, plain, plain, [{} for _ in parts], 0.0)
    anew = _anew(bench, find, parts, say, jobs)
    made = [errors.predicted(s, {k: _effects(f) for k, f in a.items()}, p) for s, a, p in zip(parts, anew, plain)]
    t = [paired(bench.pose, before, after, usual, sigma_of(bench)) for before, after in zip(plain, made)]
    return _Whole(parts, plain, made, anew, float(np.mean(t)))


def _proof(bench, whole: _Whole, fixed, noise, usual, kept: bool) -> Proof:
    """The figures; where nothing is claimed, the baseline predicts."""
    errors = whole.errors if kept else whole.plain
    rows = zip(whole.schemes, whole.plain, errors, fixed)
    return Proof(
        rms(whole.plain[0], usual), rms(errors[0], usual), rms(fixed[0], usual),
        paired(bench.pose, whole.plain[0], errors[0], usual, sigma_of(bench)), len(whole.schemes[0].folds), *noise,
        np.stack([whole.plain[0], errors[0]]), whole.schemes[0].fold,
        tuple(_told(bench, s, usual, *row) for s, *row in rows),
    )  # fmt: skip


def _told(bench, scheme: Scheme, usual, before, after, fixed) -> dict:
    return {"folds_by": scheme.name, "folds": len(scheme.folds), "before": rms(before, usual),
            "after": rms(after, usual), "after_same_terms": rms(fixed, usual),
            "t": paired(bench.pose, before, after, usual, sigma_of(bench))}  # fmt: skip


def _anew(bench, find: Find, parts: list[Scheme], say, jobs: int) -> list[dict[int, list[Finding]]]:
    """What the search finds on the other folds, and what of it a held-out test on those alone leaves, fold by fold."""
    found: list[dict[int, list[Finding]]] = [{} for _ in parts]
    work = [(i, s, k) for i, s in enumerate(parts) for k in s.folds]
    say(f"the whole search anew without each of {len(work)} blocks")
    with searches(bench, partial(earned_inside, find=find), jobs) as searched:
        for (i, s, k), terms in zip(work, searched([s.fold != k for _, s, k in work])):
            found[i][k] = terms
            say(f"{s.name}: the whole search was made without block {k + 1} of {len(s.folds)}")
    return found


def earned_inside(bench: Bench, samples: np.ndarray, find: Find) -> list[Finding]:
    """What search and held-out test leave on `samples` (n,) bool, which are then all that it has seen.

    Fewer of them where the bench can do with fewer; a bench that is `whole` sees in a fold what it saw outside.
    """
    found = find(bench, samples if getattr(bench, "whole", False) else thinned(bench.pose, samples))
    return [term.finding for term in _earned(bench, list(found.findings), samples)[0]]


def _earned(bench, findings: list[Finding], samples, say: Say = lambda text: None) -> tuple[list[Term], list[Term]]:
    """Terms whose held-out gain beside one another is real, and those that went, in the problem solved with all.

    To first order about that solution, by samples left out of the linearised fit.
    """
    say(f"held-out gain of {len(findings)} terms, each beside the others")
    gone: list[Term] = []
    problem = bench.problem(_effects(findings), samples) if findings else None
    sigma = sigma_of(bench, samples)
    numbers = dict(zip(map(id, findings), _numbered(findings)))
    left = [Term(f) for f in findings]
    while left:
        kept = [i for term in left for i in numbers[id(term.finding)]]
        left = [_judged(bench, problem, kept, term, numbers[id(term.finding)], sigma) for term in left]
        worst = min(left, key=lambda term: term.t)
        if worst.t > REAL and worst.gain > 0:
            break
        gone.append(replace(worst, kept=False, reason=_unreal(worst.t)))
        left.remove(worst)
    return left, gone


def _unreal(t: float) -> str:
    return f"its held-out gain beside the others is not real (t = {t:.1f}, where more than {REAL:g} is expected)"


def _judged(bench, problem: Problem, kept: Sequence[int], term: Term, own: Sequence[int], sigma) -> Term:
    """The term with t and gain of its being there beside the problem's others, over the schemes that may judge it."""
    every, rest = problem.keeping(kept), problem.keeping([i for i in kept if i not in own])
    usual, t, gain = problem.weights > _FAR, [], []
    for scheme in _judges(bench, term.finding.effects, schemes(problem.pose, problem)):
        with_it, without = left_out(every, scheme.fold), left_out(rest, scheme.fold)
        t.append(paired(problem.pose, without, with_it, usual, sigma))
        gain.append(rms(without, usual, sigma) - rms(with_it, usual, sigma))
    worst = int(np.argmin(t))
    known = t[worst] if t[worst] < -REAL else float(np.mean(t))
    return replace(term, t=known, gain=gain[0] if known > REAL else gain[worst])


def _numbered(findings) -> list[list[int]]:
    """Numbers of each finding's effects among those of all, in order."""
    edges = np.cumsum([0, *(len(f.effects) for f in findings)])
    return [list(range(a, b)) for a, b in zip(edges, edges[1:])]


def _judges(bench, effects, parts):
    """The schemes that may judge these effects."""
    if len(parts) > 1 and of_order(bench, effects):
        return [s for s in parts if s.name != TIME]
    return parts


def _stable(errors: Errors, terms, whole: _Whole, usual) -> tuple[list[Term], list[Term]]:
    """The terms whose gain is real, too, where each fold knows only what was found without it; and the others.

    None at all where the whole does not help to predict what it has not seen: what it says is luck then.
    """
    if terms and not whole.t > REAL:
        return [], [replace(term, kept=False, reason=_luck(whole.t)) for term in terms]
    kept, lost = [], []
    bench, folds = errors.bench, [_solved(errors.bench, a) for a in whole.anew] if terms else []
    with_all = [_linear(s, rows) for s, rows in zip(whole.schemes, folds)]
    own = _made(bench.problem(_effects([t.finding for t in terms])), [t.finding for t in terms]) if terms else []
    made = [_made(problem, found) for rows in folds for found, problem in rows.values()]
    for term, moved in zip(terms, own):
        t = []
        for scheme in _judges(bench, term.finding.effects, whole.schemes):
            at = whole.schemes.index(scheme)
            less = _linear(scheme, folds[at], term.finding)
            t.append(paired(bench.pose, less, with_all[at], usual, sigma_of(bench)))
        again = sum(_alike(moved, others) for others in made)
        term = replace(term, again=again, chances=len(made), t_anew=max(t))
        if term.t_anew > REAL:
            kept.append(term)
        else:
            reason = f"searched anew without a part of the samples, it does not help to predict them (t = {max(t):.1f})"
            lost.append(replace(term, kept=False, reason=reason))
    return kept, lost


def _solved(bench, anew: dict[int, list[Finding]]) -> dict[int, tuple[list[Finding], Problem]]:
    """What each fold found, with all samples solved with that."""
    return {k: (found, bench.problem(_effects(found))) for k, found in anew.items()}


def _made(problem: Problem, findings: Sequence[Finding]) -> list[np.ndarray]:
    """(N,) mm, px: what each finding makes, beside what the baseline can make of it."""
    bare = problem.keeping(())
    unit = problem.sigma / np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    return [unit * bare.clear(sum(problem.added[i] @ problem.values[i] for i in own)) for own in _numbered(findings)]


def _alike(moved: np.ndarray, others: list[np.ndarray]) -> bool:
    """Whether what some findings make together is most of what one makes, (N,) each, by whatever names, and as it does.

    What they make is scaled as is best, since a fold finds another size, but not turned round.
    """
    if not others:
        return False
    made = np.stack(others, 1)
    share = np.linalg.lstsq(made, moved, rcond=None)[0]
    like = np.maximum(share, 0.0) @ made.T
    return bool(((moved - like) ** 2).sum() < (1 - _MOST) * (moved**2).sum())


def _linear(scheme: Scheme, folds: dict, without: Finding | None = None) -> np.ndarray:
    """(n,) errors where every fold is predicted with what was found without it, to first order; one may be left out.

    folds: as of `_solved`.
    """
    out = np.empty(len(scheme.fold))
    for k, (findings, problem) in folds.items():
        numbers = _numbered(findings)
        kept = [i for f, own in zip(findings, numbers) if without is None or not _same(f, without) for i in own]
        mine = scheme.fold == k
        out[mine] = left_out(problem.keeping(kept), np.where(mine, 0, -1), only=0)[mine]
    return out


def _same(finding: Finding, other: Finding) -> bool:
    """Whether two findings are one: the same effect at one place, or twins that these poses hardly tell apart."""
    return bool(_names(finding) & {_name(other)} or _names(other) & {_name(finding)})


def _names(finding: Finding) -> set[tuple[str, str]]:
    """A finding and its twins: what is about as likely in its place, or explains as much there."""
    twins = (a for a in finding.alternatives if a.probability >= _LIKELY or a.alike >= _ALIKE)
    return {_name(one) for one in (finding, *twins)}


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
