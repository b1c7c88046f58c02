"""Proof of what a search found: errors on samples that no step of it saw, and what is left when a cause is scrambled.

Folds never part what was measured at one pose. There are two schemes, because they ask different things: blocks of
time, which a slow drift does not survive, and blocks of the workspace, which a wrong law does not. A law of time
cannot be carried into a stretch of time that was not measured, so that it is judged by the workspace alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher

from workbench.core.effect import Effect
from workbench.crossvalidation import blocks, hold_out
from workbench.diagnosis.controls import controls, of_order
from workbench.diagnosis.problem import Bench, Finding, Found, Problem
from workbench.diagnosis.result import Proof, Term

REAL = 2.0
"""t of the paired gains above which a held-out gain is taken for real."""
_TIME, _SPACE, _DEALT = "blocks of time", "blocks of the workspace", "placements and balls in turn"
_FOLDS, _HALVINGS = 5, 2
_SEARCHED = 900  # samples that a search inside a fold sees at most; what it finds is fitted on all of the fold
_LEAST_REPEATS = 10
_LIKELY = 0.1
_FAR = 0.05  # robust weight below which a sample is another process's
_HELD = 1e-3  # of a direction, what its prior is worth at least where one block alone determines it
Find = Callable[..., Found]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Scheme:
    """`name` of a way to part the samples and the `fold` (n,) int of each."""

    name: str
    fold: np.ndarray

    @property
    def folds(self) -> range:
        return range(int(self.fold.max()) + 1)


def prove(bench: Bench, found: Found, find: Find, noise: tuple[float, str], say: Say = lambda text: None):
    """(Proof, terms that stay, terms refused) of what `find(bench)` found on all samples.

    find: the whole search, called again inside each fold as find(bench, samples). noise: RMS distance that the
    instrument leaves (mm, px), and how it is known. A term stays where its held-out gain is real and it passes its
    controls; the weakest goes first, and the others are judged again without it.
    """
    usual = ~found.outliers
    schemes = _schemes(bench.pose, found.before)
    left_out = _Errors(bench)
    plain = [left_out((), s.fold) for s in schemes]
    terms, refused = _earned(bench, left_out, found, schemes, usual, say)
    anew = [_anew(bench, find, s, say) for s in schemes]
    errors = [_predicted(left_out, s, {k: _effects(f) for k, f in a.items()}, p)
              for s, a, p in zip(schemes, anew, plain)]  # fmt: skip
    terms, lost = _stable(left_out, terms, anew, errors, plain, schemes, usual)
    terms, more = _carried(bench, terms, errors, plain, usual)
    errors = errors if terms else plain  # where nothing is claimed, the baseline predicts
    effects = _effects([term.finding for term in terms])
    fixed = [left_out(effects, s.fold) for s in schemes] if effects else plain
    proof = Proof(
        rms(plain[0], usual), rms(errors[0], usual), rms(fixed[0], usual),
        paired(bench.pose, plain[0], errors[0], usual), len(schemes[0].folds), *noise,
        np.stack([plain[0], errors[0]]), schemes[0].fold,
        tuple(_told(s, usual, bench.pose, *rows) for s, *rows in zip(schemes, plain, errors, fixed)),
    )  # fmt: skip
    return proof, tuple(terms), (*refused, *lost, *more)


def _schemes(pose: np.ndarray, problem: Problem) -> list[Scheme]:
    """Blocks of time and, for an arm, blocks of the workspace; for pictures, every fifth placement and ball."""
    if "u" in problem.covariates:
        return [Scheme(_DEALT, _dealt(pose, problem))]
    by_order = np.argsort(problem.order, kind="stable")
    time = np.empty(problem.n, int)
    time[by_order] = blocks(pose[by_order], _FOLDS)
    space = _halved(pose, problem)
    return [Scheme(_TIME, time)] + ([] if space is None else [Scheme(_SPACE, space)])


def _dealt(pose: np.ndarray, problem: Problem) -> np.ndarray:
    """(n,) block of each sample: placements of boards and balls dealt out in turn, so that no block lacks a kind."""
    poses, group = np.unique(pose, return_inverse=True)
    board = np.zeros(len(poses), bool)  # a corner has two coordinates, a stripe one
    board[group[np.bincount(problem.sample, minlength=problem.n) > 1]] = True
    rank = np.where(board, np.cumsum(board) - 1, np.cumsum(~board) - 1)
    return (rank % min(_FOLDS, max(int(board.sum()), 2)))[group]


def _halved(pose: np.ndarray, problem: Problem) -> np.ndarray | None:
    """(n,) block of each sample: poses halved at the median of what spreads most, and each half again."""
    names = [c for c in ("q1", "q2", "q3") if np.ptp(problem.covariates.get(c, np.zeros(1))) > 0]
    if not names:
        return None
    poses, group = np.unique(pose, return_inverse=True)
    if len(poses) < 2 ** (_HALVINGS + 1):
        return None
    count = np.bincount(group)
    place = np.stack([np.bincount(group, problem.covariates[c]) / count for c in names])
    return _halves(place / np.maximum(place.std(1, keepdims=True), 1e-12), np.arange(len(poses)), _HALVINGS)[group]


def _halves(place, rows, times) -> np.ndarray:
    """(len(rows),) block of each row."""
    if times == 0:
        return np.zeros(len(rows), int)
    along = place[int(np.argmax(place[:, rows].std(1))), rows]
    upper = np.argsort(np.argsort(along, kind="stable"), kind="stable") >= len(rows) / 2
    out = np.empty(len(rows), int)
    for half, first in ((~upper, 0), (upper, 2 ** (times - 1))):
        out[half] = first + _halves(place, rows[half], times - 1)
    return out


def rms(errors: np.ndarray, usual: np.ndarray) -> float:
    """Root mean square of the errors (n,) that there are, of the usual samples."""
    kept = errors[usual & np.isfinite(errors)]
    return float(np.sqrt((kept**2).mean())) if kept.size else float("nan")


def paired(pose: np.ndarray, before: np.ndarray, after: np.ndarray, usual: np.ndarray) -> float:
    """t of the falls of the squared error, one fall a pose: their mean over its standard error."""
    kept = usual & np.isfinite(before) & np.isfinite(after)
    _, group = np.unique(pose[kept], return_inverse=True)
    if not kept.any() or group.max() < 2:
        return 0.0
    falls = np.bincount(group, before[kept] ** 2 - after[kept] ** 2) / np.bincount(group)
    spread = falls.std(ddof=1) / np.sqrt(len(falls))
    return float(falls.mean() / spread) if spread > 0 else 0.0


def _earned(bench, left_out: "_Errors", found: Found, schemes, usual, say) -> tuple[list[Term], list[Term]]:
    """The findings that stay, and those that do not, each with its figures and the reason."""
    findings, low = _thinned_out(bench, list(found.findings), None)
    refused = [replace(Term(f), t=t, kept=False, reason=_unreal(t)) for f, t in low]
    left = [Term(finding) for finding in findings]
    while left:
        say(f"held-out gain of {len(left)} terms, each beside the others")
        left = [_judged(left_out, left, i, schemes, usual) for i in range(len(left))]
        worst = min(left, key=lambda term: term.t)
        if worst.t > REAL and worst.gain > 0:
            break
        refused.append(replace(worst, kept=False, reason=_unreal(worst.t)))
        left.remove(worst)
    return _controlled(bench, left, refused, say)


def _unreal(t: float) -> str:
    return f"its held-out gain is not real (t = {t:.1f}, where {REAL:g} is expected)"


def _controlled(bench, left: list[Term], refused: list[Term], say) -> tuple[list[Term], list[Term]]:
    """The terms with their controls; one that fails them is refused."""
    kept = []
    for term in left:
        say(f"controls of {term.title}")
        others = _effects([other.finding for other in left if other is not term])
        made = replace(term, controls=controls(bench, others, term.finding.effects))
        failed = [one.kind for one in made.controls if not one.passed]
        if failed:
            reason = f"what it depends on, {' and '.join(failed)}, gains as much"
            refused.append(replace(made, kept=False, reason=reason))
        else:
            kept.append(made)
    return kept, refused


class _Errors:
    """Held-out errors of a bench, each set of effects and folds once."""

    def __init__(self, bench):
        self.bench, self.kept = bench, {}

    def __call__(self, effects, fold: np.ndarray) -> np.ndarray:
        """(n,) each sample predicted from the other folds."""
        return self._once(effects, fold, lambda: self.bench.held_out(effects, fold))

    def block(self, effects, block: np.ndarray) -> np.ndarray:
        """Errors of the samples of one block (n,) bool, predicted from all others."""
        return self._once(effects, block, lambda: self._predict(effects, block)[block])

    def _predict(self, effects, block):
        if not hasattr(self.bench, "chain"):  # a sensor's bench fits what is in no fold
            return self.bench.held_out(effects, np.where(block, 0, -1))
        model, fit, _ = self.bench.solve(effects)
        return np.sqrt(hold_out(model, fit.parameters, block, ~block, "huber").squares)

    def _once(self, effects, samples, make):
        key = tuple(sorted(map(_key, effects))), samples.tobytes()
        if key not in self.kept:
            self.kept[key] = make()
        return self.kept[key]


def _judged(left_out: _Errors, terms: Sequence[Term], i, schemes, usual) -> Term:
    """The term with t and gain of its being there beside all others, over the schemes that may judge it."""
    every = _effects([term.finding for term in terms])
    rest = _effects([term.finding for k, term in enumerate(terms) if k != i])
    t, gain = [], []
    for scheme in _judges(left_out.bench, terms[i].finding.effects, schemes):
        with_it, without = left_out(every, scheme.fold), left_out(rest, scheme.fold)
        t.append(paired(left_out.bench.pose, without, with_it, usual))
        gain.append(rms(without, usual) - rms(with_it, usual))
    worst = int(np.argmin(t))
    known = t[worst] if t[worst] < -REAL else float(np.mean(t))
    return replace(terms[i], t=known, gain=gain[0] if known > REAL else gain[worst])


def _judges(bench, effects, schemes):
    """The schemes that may judge these effects."""
    if len(schemes) > 1 and of_order(bench, effects):
        return [s for s in schemes if s.name != _TIME]
    return schemes


def _anew(bench, find: Find, scheme: Scheme, say) -> dict[int, list[Finding]]:
    """What the search finds on the other folds, and what of it a held-out test on those alone leaves, fold by fold."""
    found = {}
    for k in scheme.folds:
        say(f"{scheme.name}: the whole search without block {k + 1} of {len(scheme.folds)}")
        found[k] = earned_inside(bench, find, scheme.fold != k)
    return found


def _stable(left_out, terms, anew, errors, plain, schemes, usual) -> tuple[list[Term], list[Term]]:
    """The terms whose gain is real, too, where each fold knows only what was found without it; and the others."""
    kept, lost = [], []
    for term in terms:
        t = []
        for scheme in _judges(left_out.bench, term.finding.effects, schemes):
            k = schemes.index(scheme)
            less = {f: _effects([one for one in found if not _same(one, term)]) for f, found in anew[k].items()}
            t.append(paired(left_out.bench.pose, _predicted(left_out, scheme, less, plain[k]), errors[k], usual))
        again = [any(_same(one, term) for one in found) for a in anew for found in a.values()]
        term = replace(term, again=sum(again), chances=len(again), t_anew=max(t))
        if term.t_anew > REAL:
            kept.append(term)
        else:
            reason = f"searched anew without a part of the samples, it does not help to predict them (t = {max(t):.1f})"
            lost.append(replace(term, kept=False, reason=reason))
    return kept, lost


def _carried(bench, terms, errors, plain, usual) -> tuple[list[Term], list[Term]]:
    """All terms where the whole search helps to predict what it has not seen; else none, for what it says is luck."""
    t = float(np.mean([paired(bench.pose, before, after, usual) for before, after in zip(plain, errors)]))
    if t > REAL or not terms:
        return terms, []
    reason = f"the whole search, made on parts of the samples, does not predict the others better (t = {t:.1f})"
    return [], [replace(term, kept=False, reason=reason) for term in terms]


def _effects(findings: Sequence[Finding]) -> tuple[Effect, ...]:
    return tuple(e for finding in findings for e in finding.effects)


def _same(finding: Finding, term: Term) -> bool:
    """Whether a finding is the term's, or what is about as likely in its place."""
    close = [one for one in term.finding.alternatives if one.probability >= _LIKELY]
    return (finding.effect, finding.where) in {(one.effect, one.where) for one in (term.finding, *close)}


def earned_inside(bench: Bench, find: Find, samples: np.ndarray) -> list[Finding]:
    """What search and held-out test leave on `samples` (n,) bool, which are then all that it has seen.

    The test's errors follow to first order from one solve: e = (I - Q_b Q_b')^-1 r for a block b left out of a
    linear fit with orthonormal columns Q (Cook & Weisberg, Residuals and Influence in Regression (1982), sec. 3.6).
    """
    found = find(bench, _thinned(bench.pose, samples))
    return _thinned_out(bench, list(found.findings), samples)[0]


def _thinned_out(bench, left: list[Finding], samples) -> tuple[list[Finding], list[tuple[Finding, float]]]:
    """The findings whose gain beside one another is real in the linearised problem, and those that went, with t."""
    gone = []
    problem = bench.problem(_effects(left), samples) if left else None
    numbers = dict(zip(map(id, left), _numbered(left)))
    while left:
        kept = [i for f in left for i in numbers[id(f)]]
        t = [_linear_t(bench, problem, kept, f, numbers[id(f)]) for f in left]
        if min(t) > REAL:
            break
        worst = int(np.argmin(t))
        gone.append((left.pop(worst), t[worst]))
    return left, gone


def _linear_t(bench, problem: Problem, kept: Sequence[int], finding: Finding, own: Sequence[int]) -> float:
    """t of a finding's gain beside the problem's other effects that are kept, over the schemes that may judge it."""
    every, rest = problem.keeping(kept), problem.keeping([i for i in kept if i not in own])
    usual = problem.weights > _FAR
    judges = _judges(bench, finding.effects, _schemes(problem.pose, problem))
    t = [paired(problem.pose, _left_out(rest, s.fold), _left_out(every, s.fold), usual) for s in judges]
    return float(np.mean(t))


def _numbered(findings) -> list[list[int]]:
    """Numbers of each finding's effects among those of all, in order."""
    edges = np.cumsum([0, *(len(f.effects) for f in findings)])
    return [list(range(a, b)) for a, b in zip(edges, edges[1:])]


def _left_out(problem: Problem, fold: np.ndarray) -> np.ndarray:
    """(n,) length of each sample's residual (mm, px) when its block is left out of the linearised fit."""
    left = problem.clear(problem.residual)
    out, mine = np.empty_like(left), fold[problem.sample]
    for k in np.unique(fold):
        rows = mine == k
        block = problem.basis[rows]
        values, vectors = np.linalg.eigh(block.T @ block)
        along = vectors.T @ (block.T @ left[rows]) / np.maximum(1 - values, _HELD)
        out[rows] = left[rows] + block @ (vectors @ along)
    out *= problem.sigma / np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    return np.sqrt(np.bincount(problem.sample, out**2, minlength=problem.n))


def _thinned(pose: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(n,) bool: of the samples those of every second, third ... pose, so that there are not too many to search."""
    step = int(np.ceil(samples.sum() / _SEARCHED))
    place = np.unique(pose, return_inverse=True)[1]
    order = np.zeros(place.max() + 1, int)
    chosen = np.unique(place[samples])
    order[chosen] = np.arange(len(chosen))
    return samples & (order[place] % step == 0)


def _predicted(left_out: "_Errors", scheme: Scheme, chosen: dict[int, tuple[Effect, ...]], plain) -> np.ndarray:
    """(n,) errors where every fold is predicted with what was found without it."""
    out = plain.copy()
    for k, effects in chosen.items():
        if effects:
            out[scheme.fold == k] = left_out.block(effects, scheme.fold == k)
    return out


def _key(effect: Effect) -> str:
    return f"{effect.effect} {effect.where} {effect.options}"


def _told(scheme: Scheme, usual, pose, before, after, fixed) -> dict:
    return {"folds_by": scheme.name, "folds": len(scheme.folds), "before": rms(before, usual),
            "after": rms(after, usual), "after_same_terms": rms(fixed, usual),
            "t": paired(pose, before, after, usual)}  # fmt: skip


def replicates(pose: np.ndarray, index: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, int]:
    """(n,) group of each sample, those of one pose and one target together, and the degrees of freedom within."""
    _, group = np.unique(np.stack([pose, index]), axis=1, return_inverse=True)
    group = group.ravel()
    return group, len(residual) * (len(group) - (group.max() + 1))


def noise(pose, index, residual: np.ndarray, sigma: float | None, degrees: float) -> tuple[float, str]:
    """RMS distance (mm, px) that the instrument leaves, and how it is known.

    residual (m, n) of the final model with `degrees` of freedom left. From replicates where there are enough; else
    from the sigma of one coordinate that the recording states; else what is left in the end, an upper limit.
    """
    group, free = replicates(pose, index, residual)
    if free >= _LEAST_REPEATS * len(residual):
        within = sum(float(((row - _means(row, group)) ** 2).sum()) for row in residual)
        return float(np.sqrt(len(residual) * within / free)), "from replicates"
    if sigma is not None:
        return float(np.sqrt(len(residual)) * sigma), "as the recording states"
    return float(np.sqrt(len(residual) * (residual**2).sum() / max(degrees, 1.0))), "what is left in the end"


def _means(row, group):
    return (np.bincount(group, row) / np.bincount(group))[group]


def lack_of_fit(pose, index, residual: np.ndarray, rank: int) -> dict | None:
    """Lack of fit against pure error where there are replicates: F of means over repeats; None without repeats.

    Draper & Smith, Applied Regression Analysis, 3rd ed. (1998), sec. 2.1. rank: of the model's parameters.
    """
    group, free = replicates(pose, index, residual)
    if free < _LEAST_REPEATS * len(residual):
        return None
    means = np.stack([_means(row, group) for row in residual])
    between = len(residual) * (group.max() + 1) - rank
    if between < 1:
        return None
    pure = float(((residual - means) ** 2).sum()) / free
    lack = float((means**2).sum()) / between
    ratio = lack / max(pure, 1e-300)
    return {"f": ratio, "p_value": float(fisher.sf(ratio, between, free)), "degrees": [int(between), int(free)],
            "means_rms": float(np.sqrt((means**2).sum(0).mean())),
            "pure_error_rms": float(np.sqrt(len(residual) * pure))}  # fmt: skip
