"""Sets of effects at once: what is weak alone, or passes for a third effect, shows only beside its partner.

All in the linearised, projected problem, from one table of inner products of the likeliest
hypotheses: every pair is tried, then sets grow, shrink and exchange members as long as their
posterior rises. Sets of one kind at all places (every joint yields a little) are further starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from workbench.diagnosis.evidence import SIZES, Projected, log_evidence
from workbench.diagnosis.hypotheses import Hypothesis
from workbench.diagnosis.problem import Problem

SECOND = float(np.log(0.2))
"""Log prior odds of one more effect."""
LAW = 0.95
"""Share of what a set with unnamed functions explains from which on known laws are preferred: no law is exact."""
_LARGEST, _STEPS, _UNNAMED = 12, 60, 2
_WRONG, _NEGATIVE = 6, 2.0  # how often a set is searched without what is negative, by more than so many sigmas
_SLOW = 6.0  # orders that a smooth function follows
_SERIES = 3  # waves at one joint from which on one function of its angle is thought of
_PAIRED, _KINDS = 40, 3  # hypotheses of which all pairs are searched; kinds from which the search starts

Members = tuple[int, ...]


@dataclass(frozen=True)
class Sets:
    """Inner products of K hypotheses: `gram` (T, T) and `score` (T,) of all their columns, `start` (K + 1,)."""

    short: tuple[Hypothesis, ...]
    projected: Projected
    gram: np.ndarray
    score: np.ndarray
    start: np.ndarray
    barred: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, projected: Projected, problem: Problem, short: Sequence[Hypothesis]) -> "Sets":
        """Of some hypotheses, their columns taken at a problem that keeps none of them."""
        columns = [h.columns(problem) for h in short]
        every = projected.of_columns(np.concatenate(columns, 1)[None])
        start = np.concatenate([[0], np.cumsum([c.shape[1] for c in columns])]).astype(int)
        crowd = projected.crowd
        return cls(tuple(short), projected, every.gram[0] / crowd, every.score[0] / crowd, start)

    @cached_property
    def rooms(self) -> np.ndarray:
        """(K, K) bool: which may act side by side."""
        return np.array([[i != j and _room(a, b) for j, b in enumerate(self.short)] for i, a in enumerate(self.short)])

    @cached_property
    def unnamed(self) -> np.ndarray:
        """(K,) bool."""
        return np.array([bool(h.unnamed) for h in self.short])

    @cached_property
    def priors(self) -> np.ndarray:
        """(K,) log prior of each."""
        return np.array([h.log_prior for h in self.short])

    @cached_property
    def groups(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Numbers (C,) of the hypotheses with equally many columns, and those columns (C, w)."""
        widths = np.diff(self.start)
        rows = [np.flatnonzero(widths == w) for w in np.unique(widths)]
        return [(r, self.start[r][:, None] + np.arange(widths[r[0]])) for r in rows]

    def index(self, members: Members) -> np.ndarray:
        """Columns of a set."""
        return np.concatenate([np.zeros(0, int), *(np.arange(self.start[i], self.start[i + 1]) for i in members)])

    def grown(self, base: Members) -> tuple[np.ndarray, float]:
        """(K,) log weight of a set with each other hypothesis beside it (-inf where there is no room), and its own.

        By Schur complements: what the set has spent is solved for once, for all that may join it.
        """
        held, shrink = self.index(base), 1 / SIZES**2
        inside = self.gram[np.ix_(held, held)] + shrink[:, None, None] * np.eye(len(held))
        right = np.concatenate([self.gram[held], self.score[held, None]], 1)
        solved = np.linalg.solve(inside, np.broadcast_to(right, (len(SIZES), *right.shape)))
        spent = np.linalg.slogdet(inside)[1] - len(held) * np.log(shrink)
        gained = solved[:, :, -1] @ self.score[held]
        left = self.score - np.einsum("bt,sb->st", self.gram[held], solved[:, :, -1])
        weights = np.full(len(self.short), -np.inf)
        for rows, columns in self.groups:
            evidence = self._joined(held, solved, left, spent, gained, columns, shrink)
            weights[rows] = evidence + self.priors[rows]
        prior = float(self.priors[list(base)].sum()) + (len(base) - 1) * SECOND
        weights = np.where(self._free(base), weights + prior + SECOND, -np.inf)
        return weights, float(log_evidence(spent, gained, self.projected)) + prior

    def _joined(self, held, solved, left, spent, gained, columns, shrink):
        """(C,) log evidence of the set with each of C hypotheses with columns (C, w)."""
        width = columns.shape[1]
        cross = self.gram[columns[:, :, None], held]
        own = self.gram[columns[:, :, None], columns[:, None, :]] + shrink[:, None, None, None] * np.eye(width)
        own = own - np.einsum("cvb,sbcw->scvw", cross, solved[:, :, columns], optimize=True)
        score = left[:, columns]
        more = (score * np.linalg.solve(own, score[..., None])[..., 0]).sum(-1)
        volume = np.linalg.slogdet(own)[1] - width * np.log(shrink)[:, None]
        return log_evidence(spent[:, None] + volume, gained[:, None] + more, self.projected)

    def _free(self, base: Members) -> np.ndarray:
        free = np.ones(len(self.short), bool) if not base else self.rooms[list(base)].all(0)
        if sum(bool(self.short[i].unnamed) for i in base) >= _UNNAMED:
            free &= ~self.unnamed
        free[list(self.barred)] = False
        return free

    def gain(self, members: Members) -> float:
        """Fall of the sum of squares by a set, its coefficients hardly held back."""
        held = self.index(members)
        gram = self.gram[np.ix_(held, held)] + np.eye(len(held)) / SIZES[-1] ** 2
        return float(self.score[held] @ np.linalg.solve(gram, self.score[held]))

    def best(self, present: Members = ()) -> tuple[Hypothesis, ...]:
        """The likeliest set: from what is accepted, or else from the best single, the best pair and every kind.

        Functions without a name are let in only where the known laws leave more than laws do.
        """
        lawful = self._lawful(tuple(i for i in present if not self.short[i].unnamed))
        rivals = [i for i, h in enumerate(self.short) if h.unnamed]
        if rivals:
            alone = max(rivals, key=lambda i: self.grown((i,))[1])
            free = [self._climb(s, False) for s in sorted({lawful, (alone,)})]
            chosen = max(free, key=lambda pair: pair[1])[0]
            if self.gain(lawful) < LAW * self.gain(chosen) or self._series(lawful, chosen):
                lawful = chosen
            lawful = self._patched(lawful)
        return tuple(self.short[i] for i in lawful)

    def _series(self, lawful: Members, chosen: Members) -> bool:
        """Whether laws only make a series of waves of what is one function of an angle at the same joint."""
        places = {self.short[i].where for i in chosen if self.short[i].unnamed}
        waves = [i for i in lawful if i not in chosen and self.short[i].effect == "transmission-harmonic"]
        return any(sum(self.short[i].where == place for i in waves) > 1 for place in places)

    def _patched(self, lawful: Members) -> Members:
        """One function of its angle instead of a long series of waves at a joint, where that is the likelier."""
        waves = [i for i in lawful if self.short[i].effect == "transmission-harmonic"]
        for place in {self.short[i].where for i in waves}:
            mine = [i for i in waves if self.short[i].where == place]
            own = (place.replace("joint-", "q"),)
            function = [i for i, h in enumerate(self.short) if h.unnamed == own and h.where == place]
            if len(mine) >= _SERIES and function:
                other, weight = self._climb((*(i for i in lawful if i not in mine), *function), False)
                lawful = other if weight > self.grown(lawful)[1] else lawful
        return lawful

    def _lawful(self, named: Members) -> Members:
        """The likeliest set of named effects in which nothing yields against its load."""
        for _ in range(_WRONG):
            chosen = max((self._climb(s, True) for s in self._starts(named)), key=lambda pair: pair[1])[0]
            wrong = self._wrong(chosen)
            if wrong is None or len(chosen) == 1:
                break
            self.barred.add(wrong)
            named = tuple(i for i in chosen if i != wrong)
        return chosen

    def _wrong(self, members: Members) -> int | None:
        """The member that is clearly negative and cannot be, the clearest; None where there is none."""
        held = self.index(members)
        gram = self.gram[np.ix_(held, held)] + np.eye(len(held)) / SIZES[-1] ** 2
        inverse = np.linalg.inv(gram)
        sigma = np.sqrt(max(self.projected.yy - self.gain(members), 1e-300) / self.projected.degrees)
        z = -(inverse @ self.score[held]) / np.sqrt(np.diag(inverse)) / sigma
        owner = np.repeat(members, np.diff(self.start)[list(members)])
        first = np.concatenate([np.arange(self.start[i + 1] - self.start[i]) for i in members])
        cannot = first < np.array([getattr(self.short[i].source, "positive", 0) for i in owner])
        clear = np.where(cannot, z, 0.0)
        return int(owner[np.argmin(clear)]) if clear.min() < -_NEGATIVE else None

    def _starts(self, named: Members) -> list[Members]:
        if named:
            return [named]
        kinds = sorted(self._kinds(), key=lambda s: -self.grown(s)[1])[:_KINDS]
        return [s for s in ((self._single(),), self._pair(), *kinds) if s]

    def _single(self) -> int:
        return int(np.argmax(np.where(self.unnamed, -np.inf, self.grown(())[0])))

    def _pair(self) -> Members:
        first = np.flatnonzero(~self.unnamed)[:_PAIRED].tolist()
        return max(self._best_of((i,), self.grown((i,))[0], True) for i in first)[1]

    def _kinds(self) -> list[Members]:
        """All places of one effect, those among the likeliest."""
        kinds: dict[str, list[int]] = {}
        for i, h in enumerate(self.short):
            members = kinds.setdefault(h.effect, [])
            if len(members) < _LARGEST and not isinstance(h.source, tuple) and self.rooms[i, members].all():
                members.append(i)
        return [tuple(members) for members in kinds.values() if len(members) > 2]

    def _climb(self, present: Members, named: bool) -> tuple[Members, float]:
        """The set after additions, removals and exchanges that each raise its weight most."""
        for _ in range(_STEPS):
            more, weight = self.grown(present)
            moves = [self._best_of(present, more, named)] if len(present) < _LARGEST else []
            if len(present) > 1:
                for i in present:
                    fewer = tuple(j for j in present if j != i)
                    others, without = self.grown(fewer)
                    moves += [(without, fewer), self._best_of(fewer, others, named)]
            top = max(moves, default=(-np.inf, present))
            if top[0] <= weight + 1e-6:
                return present, weight
            present = top[1]
        return present, weight

    def _best_of(self, base: Members, weights: np.ndarray, named: bool) -> tuple[float, Members]:
        weights = np.where(self.unnamed, -np.inf, weights) if named else weights
        return float(weights.max()), (*base, int(np.argmax(weights)))


def _room(h: Hypothesis, other: Hypothesis) -> bool:
    if bool(h.unnamed) != bool(other.unnamed):
        return not _covers(*((h, other) if h.unnamed else (other, h)))
    if h.unnamed:
        return h.key != other.key or h.unnamed != other.unnamed
    return h.family != other.family or (h.together and h.label != other.label)


def _covers(function: Hypothesis, law: Hypothesis) -> bool:
    """Whether an unnamed function of angles at a joint has room for a law of slow waves or of another angle there."""
    if function.where != law.where or not all(name[0] == "q" for name in function.unnamed):
        return False
    slow = law.effect == "transmission-harmonic" and law.effects and law.effects[0].order <= _SLOW
    return bool(slow) or law.effect == "joint-coupling"
