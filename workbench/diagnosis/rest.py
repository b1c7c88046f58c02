"""What else is there: known laws that are small beside the first ones, taken in where they predict samples left out.

A search that weighs evidence stops where something without a name explains more of what is left than any law does: it
might be that, and not the law. But a function with fifty numbers always explains more of what it is fitted to. So both
are asked to predict samples that were left out: a law joins where it helps to predict them by more than luck, and no
function without a name predicts them better than it does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.diagnosis.controls import of_order
from workbench.diagnosis.folds import TIME, schemes
from workbench.diagnosis.heldout import left_out, paired, rms
from workbench.diagnosis.hypotheses import Hypothesis, family_wise
from workbench.diagnosis.problem import Problem

_ROUNDS, _LAWS, _FUNCTIONS = 4, 12, 6
_REAL = 3.1  # t of a held-out gain that the best of a dozen reaches by luck once in a hundred times
_BETTER = 2.0
_FAR = 0.05  # robust weight below which a sample is another process's


@dataclass(frozen=True)
class _Tried:
    """A hypothesis with the errors (n,) that it leaves in each scheme that may judge it, and t and fall of the RMS."""

    hypothesis: Hypothesis
    errors: dict[str, np.ndarray]
    t: float
    fall: float


def grown_by_prediction(search) -> None:
    """Let laws join a search's accepted ones as long as one earns its place.

    search: as in `select`, with `table`, `everyone`, `problem`, `accepted`, `level`, `solve` and `say`.
    """
    for _ in range(_ROUNDS):
        table = search.table(search.everyone)
        if not search.accepted or family_wise(table) > search.level:
            return
        joined = _joined(search, table)
        if not joined:
            return
        for one in joined:
            search.say(
                f"{one.effect} at {one.where} {one.label}: it predicts what was left out".replace(
                    " :", ":"
                )
            )
        search.accepted = (*search.accepted, *joined)
        search.solve()


def _joined(search, table: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Laws that predict what is left out, each beside all before it, where no function without a name beats it.

    One after another from the likeliest laws of a table, to first order about what is accepted.
    """
    trial = _Trial(search.bench, search.problem.keeping())
    known = _one_each(
        [h for h in table if not h.unnamed and h.effects and h.p / h.weight <= search.level]
    )[:_LAWS]
    functions = [h for h in table if h.unnamed][:_FUNCTIONS]
    columns = {id(h): h.columns(search.problem) for h in (*known, *functions)}
    joined: list[Hypothesis] = []
    while known:
        tried = [trial.of(h, columns[id(h)]) for h in known]
        tried = [one for one in tried if one.t > _REAL and one.fall > 0]
        best = tried[0] if tried else None
        if best is None or any(trial.beats(trial.of(h, columns[id(h)]), best) for h in functions):
            break
        joined.append(best.hypothesis)
        trial = trial.beside(columns[id(best.hypothesis)])
        known = [
            one.hypothesis
            for one in tried
            if one is not best and _room(best.hypothesis, one.hypothesis)
        ]
    return joined


def _room(h: Hypothesis, other: Hypothesis) -> bool:
    return h.family != other.family or (h.together and h.label != other.label)


def _one_each(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The likeliest variant of each effect at each place, in their order."""
    seen: dict[tuple, Hypothesis] = {}
    for h in hypotheses:
        seen.setdefault(h.key, h)
    return list(seen.values())


class _Trial:
    """A problem with all that is accepted in its basis, its folds, and what is left out of it."""

    def __init__(self, bench, problem: Problem):
        self.bench, self.problem = bench, problem
        self.schemes = schemes(problem.pose, problem)
        self.usual = problem.weights > _FAR
        self.plain = {s.name: left_out(problem, s.fold) for s in self.schemes}

    def wider(self, columns: np.ndarray) -> Problem:
        """The problem with columns (N, P) in its basis."""
        basis = np.concatenate([self.problem.basis, self.problem.beside(columns)], 1)
        return replace(self.problem, basis=basis, bare=self.problem.first)

    def beside(self, columns: np.ndarray) -> "_Trial":
        """The same with one more accepted."""
        return _Trial(self.bench, self.wider(columns))

    def of(self, h: Hypothesis, columns: np.ndarray) -> _Tried:
        """A hypothesis tried."""
        wider = self.wider(columns)
        errors = {part.name: left_out(wider, part.fold) for part in self.judges(h)}
        t = [
            paired(self.problem.pose, self.plain[name], made, self.usual)
            for name, made in errors.items()
        ]
        falls = [
            rms(self.plain[name], self.usual) - rms(made, self.usual)
            for name, made in errors.items()
        ]
        return _Tried(
            h, errors, min(t) if min(t) < -_BETTER else float(np.mean(t)), float(np.mean(falls))
        )

    def judges(self, h: Hypothesis):
        """The schemes that may judge it: what reads the clock says nothing of times that were not measured."""
        clocked = "time" in h.unnamed or of_order(self.bench, h.effects)
        chosen = [s for s in self.schemes if not clocked or s.name != TIME]
        return chosen or self.schemes

    def beats(self, one: _Tried, other: _Tried) -> bool:
        """Whether one predicts really better than another, on every scheme that judges both."""
        both = one.errors.keys() & other.errors.keys()
        t = [
            paired(self.problem.pose, other.errors[name], one.errors[name], self.usual)
            for name in both
        ]
        return bool(t) and min(t) > _BETTER


__all__ = ["grown_by_prediction"]
