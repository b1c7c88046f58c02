"""Sets of effects at once: what is weak alone, or passes for a third effect, shows only beside its partner.

All in the linearised, projected problem, from one table of inner products of the likeliest
hypotheses: every pair is tried, then sets grow, shrink and exchange members as long as their
posterior rises. Sets of one kind at all places (every joint yields a little) are further starts.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from robot_model.effects.transmission import JointCoupling, TransmissionHarmonic
from workbench.core.least_squares.linear_algebra import (
    inverse_positive,
    solve_positive,
    symmetric_eigen,
)
from workbench.diagnosis.evidence import SIZES, Projected, log_evidence
from workbench.diagnosis.hypotheses import Hypothesis
from workbench.diagnosis.problem import Problem
from workbench.diagnosis.rivals import SHARP_DEGREE
from workbench.diagnosis.schur import Beside, Left, Table

_WAVE = TransmissionHarmonic.effect
SECOND = float(np.log(0.2))
"""Log prior odds of one more effect."""
LAW = 0.95
"""Share of what a set with unnamed functions explains from which on known laws are preferred: no law is exact."""
_LARGEST, _STEPS, _UNNAMED = 12, 60, 2
_WRONG, _NEGATIVE = (
    6,
    2.0,
)  # how often a set is searched without what is negative, by more than so many sigmas
_SLOW = 6.0  # orders that a smooth function follows
_SERIES = 3  # waves at one joint from which on one function of its angle is thought of, and no further wave
_PAIRED, _KINDS = (
    40,
    3,
)  # hypotheses of which all pairs are searched; kinds from which the search starts

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
    seen: dict[frozenset, tuple[np.ndarray, float]] = field(default_factory=dict)
    last: dict = field(default_factory=dict)

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
        return np.array(
            [
                [i != j and room(a, b) for j, b in enumerate(self.short)]
                for i, a in enumerate(self.short)
            ]
        )

    @cached_property
    def unnamed(self) -> np.ndarray:
        """(K,) bool."""
        return np.array([bool(h.unnamed) for h in self.short])

    @cached_property
    def kinds(self) -> list:
        """Of each: ("move", 2) of functions of each joint's own move, at whatever joint; else its own name."""
        return [_kind(h) for h in self.short]

    @cached_property
    def series(self) -> dict[str, np.ndarray]:
        """Place -> (K,) bool: waves there, of which only a few may be laws of their own."""
        waves = np.array([h.effect == _WAVE for h in self.short])
        places = np.array([h.where for h in self.short])
        return {place: waves & (places == place) for place in set(places[waves].tolist())}

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
        return np.concatenate(
            [np.zeros(0, int), *(np.arange(self.start[i], self.start[i + 1]) for i in members)]
        )

    @cached_property
    def table(self) -> Table:
        """The inner products by groups of hypotheses with equally many columns."""
        return Table(
            self.gram, self.score, 1 / SIZES**2, tuple(columns for _, columns in self.groups)
        )

    def grown(self, base: Members) -> tuple[np.ndarray, float]:
        """(K,) log weight of a set with each other hypothesis beside it (-inf where there is no room), and its own.

        By Schur complements: what the set has spent is solved for once, for all that may join it.
        """
        key = frozenset(base)
        if key not in self.seen:
            self.seen[key] = self._weighed(base, self._beside(base).whole)
        weights, weight = self.seen[key]
        return np.where(self._free(base), weights, -np.inf), weight

    def _beside(self, base: Members) -> Beside:
        """What is solved for beside a set; the last one is kept, whose members may be taken out next."""
        if self.last.get("members") != base:
            self.last.update(members=base, beside=Beside(self.table, self.index(base)))
        return self.last["beside"]

    def _lose(self, base: Members) -> None:
        """All sets with one member less, weighed from what is solved for beside the whole."""
        edges = np.concatenate([[0], np.cumsum(np.diff(self.start)[list(base)])])
        for k in range(len(base)):
            fewer = base[:k] + base[k + 1 :]
            if frozenset(fewer) not in self.seen:
                try:
                    left = self._beside(base).without(slice(edges[k], edges[k + 1]))
                except (
                    np.linalg.LinAlgError
                ):  # too close to singular for this: `grown` solves it by itself
                    continue
                self.seen[frozenset(fewer)] = self._weighed(fewer, left)

    def _weighed(self, base: Members, left: Left) -> tuple[np.ndarray, float]:
        """As `grown`, room or not, from what is left beside a set."""
        weights = np.full(len(self.short), -np.inf)
        for (rows, columns), blocks in zip(self.groups, left.blocks):
            weights[rows] = self._joined(left, columns, blocks) + self.priors[rows]
        prior = float(self.priors[list(base)].sum()) + (len(base) - 1) * SECOND
        own = float(log_evidence(left.spent, left.gained, self.projected)) + prior
        return weights + prior + SECOND, own

    def _joined(self, left: Left, columns: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        """(C,) log evidence of a set with each of C hypotheses with columns (C, w), blocks (S, C, w, w).

        One Cholesky factor of each, the score as its last row, gives both determinant and gain.
        """
        shrink, width = self.table.shrink, columns.shape[1]
        both = np.zeros((*blocks.shape[:2], width + 1, width + 1))
        both[..., :-1, :-1] = blocks
        both[..., range(width), range(width)] += shrink[:, None, None]
        both[..., -1, :-1] = left.left[:, columns]
        both[..., -1, -1] = 1e300  # any number that is large enough
        try:
            factor = np.linalg.cholesky(both)
            more = (factor[..., -1, :-1] ** 2).sum(-1)
            spent = 2 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)[..., :-1]).sum(-1)
        except (
            np.linalg.LinAlgError
        ):  # hardly any noise: rounding of what is made exactly exceeds what is left
            values, vectors = symmetric_eigen(blocks)
            values = np.maximum(values, 0.0) + shrink[:, None, None]
            more = (np.einsum("scij,sci->scj", vectors, left.left[:, columns]) ** 2 / values).sum(
                -1
            )
            spent = np.log(values).sum(-1)
        volume = spent - width * np.log(shrink)[:, None]
        return log_evidence(
            left.spent[:, None] + volume, left.gained[:, None] + more, self.projected
        )

    def _free(self, base: Members) -> np.ndarray:
        free = np.ones(len(self.short), bool) if not base else self.rooms[list(base)].all(0)
        waves = Counter(self.short[i].where for i in base if self.short[i].effect == _WAVE)
        for place in (where for where, count in waves.items() if count >= _SERIES):
            free &= ~self.series[place]
        kinds = {self.kinds[i] for i in base if self.short[i].unnamed}
        if len(kinds) >= _UNNAMED:
            free &= ~self.unnamed | np.array([kind in kinds for kind in self.kinds])
        free[list(self.barred)] = False
        return free

    def gain(self, members: Members) -> float:
        """Fall of the sum of squares by a set, its coefficients hardly held back."""
        held = self.index(members)
        gram = self.gram[np.ix_(held, held)] + np.eye(len(held)) / SIZES[-1] ** 2
        return float(self.score[held] @ solve_positive(gram, self.score[held]))

    def best(self, present: Members = ()) -> tuple[Hypothesis, ...]:
        """The likeliest set: from what is accepted, or else from the best single, the best pair and every kind.

        Functions without a name are let in only where the known laws leave more than laws do.
        """
        laws = np.flatnonzero(~self.unnamed).tolist()
        free = [self._climb(s) for s in self._alike()]
        if self.unnamed.any():
            alone = np.where(self.unnamed, self.grown(())[0], -np.inf)
            free.append(self._climb((int(np.argmax(alone)),)))
        most = max((self.gain(members) for members, _ in free), default=0.0)
        inner = self._part(laws) if self.unnamed.any() else self
        found = inner.lawful(tuple(laws.index(i) for i in present if i in laws), LAW * most)
        self.barred.update(laws[i] for i in inner.barred)
        lawful = tuple(laws[i] for i in found)
        if self.unnamed.any():
            if (
                not free
                or self.gain(lawful) >= LAW * most
                or self.grown(lawful)[1] > max(w for _, w in free)
            ):
                free.append(self._climb(lawful))
            chosen = max(free, key=lambda pair: pair[1])[0]
            if self.gain(lawful) < LAW * self.gain(chosen) or self._series(lawful, chosen):
                lawful = chosen
            lawful = self._patched(lawful)
        return tuple(self.short[i] for i in lawful)

    def _part(self, members: Sequence[int]) -> "Sets":
        """The same of some of the hypotheses alone."""
        columns, widths = self.index(tuple(members)), np.diff(self.start)[list(members)]
        start = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        short = tuple(self.short[i] for i in members)
        return Sets(
            short, self.projected, self.gram[np.ix_(columns, columns)], self.score[columns], start
        )

    def _series(self, lawful: Members, chosen: Members) -> bool:
        """Whether laws only make a series of waves of what is one function of an angle at the same joint."""
        places = {self.short[i].where for i in chosen if self.short[i].unnamed}
        waves = [i for i in lawful if i not in chosen and self.short[i].effect == _WAVE]
        return any(sum(self.short[i].where == place for i in waves) > 1 for place in places)

    def _patched(self, lawful: Members) -> Members:
        """One function of its angle instead of a long series of waves at a joint, where that is the likelier."""
        waves = [i for i in lawful if self.short[i].effect == _WAVE]
        for place in {self.short[i].where for i in waves}:
            mine = [i for i in waves if self.short[i].where == place]
            own = (place.replace("joint-", "q"),)
            rest = tuple(i for i in lawful if i not in mine)
            functions = [
                i
                for i, h in enumerate(self.short)
                if h.where == place and (h.unnamed == own or h.effect == "joint-curve")
            ]
            if len(mine) >= _SERIES and functions:
                other, weight = max(
                    (self._climb((*rest, i)) for i in functions), key=lambda pair: pair[1]
                )
                lawful = other if weight > self.grown(lawful)[1] else lawful
        return lawful

    def lawful(self, named: Members, least: float) -> Members:
        """The likeliest set of named effects in which nothing yields against its load; what gains less than `least`
        is not looked at again, as it would only gain less."""
        for _ in range(_WRONG):
            chosen = max((self._climb(s) for s in self._starts(named)), key=lambda pair: pair[1])[0]
            wrong = self._wrong(chosen)
            if wrong is None or len(chosen) == 1 or self.gain(chosen) < least:
                break
            self.barred.add(wrong)
            named = tuple(i for i in chosen if i != wrong)
        return chosen

    def _wrong(self, members: Members) -> int | None:
        """The member that is clearly negative and cannot be, the clearest; None where there is none."""
        held = self.index(members)
        gram = self.gram[np.ix_(held, held)] + np.eye(len(held)) / SIZES[-1] ** 2
        inverse = inverse_positive(gram)
        sigma = np.sqrt(
            max(self.projected.yy - self.gain(members), 1e-300) / self.projected.degrees
        )
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
        return int(np.argmax(self.grown(())[0]))

    def _pair(self) -> Members:
        return max(
            self._best_of((i,), self.grown((i,))[0]) for i in range(min(_PAIRED, len(self.short)))
        )[1]

    def _kinds(self) -> list[Members]:
        """All places of one effect, those among the likeliest."""
        kinds: dict[str, list[int]] = {}
        for i, h in enumerate(self.short):
            members = kinds.setdefault(h.effect, [])
            if (
                len(members) < _LARGEST
                and not isinstance(h.source, tuple)
                and self.rooms[i, members].all()
            ):
                members.append(i)
        return [tuple(members) for members in kinds.values() if len(members) > 2]

    def _alike(self) -> list[Members]:
        """Functions of each joint's own covariate of one kind, at all joints that are among the likeliest."""
        kinds: dict[tuple, list[int]] = {}
        for i, kind in enumerate(self.kinds):
            if (
                self.unnamed[i]
                and (members := kinds.setdefault(kind, [])) is not None
                and self.rooms[i, members].all()
            ):
                members.append(i)
        return [tuple(members[:_LARGEST]) for members in kinds.values() if len(members) > 2]

    def _climb(self, present: Members) -> tuple[Members, float]:
        """The set after additions, and where none helps removals and exchanges, that each raise its weight most."""
        for _ in range(_STEPS):
            more, weight = self.grown(present)
            top = self._best_of(present, more) if len(present) < _LARGEST else (-np.inf, present)
            if top[0] <= weight + 1e-6 and len(present) > 1:
                top = max(self._changed(present))
            if top[0] <= weight + 1e-6:
                break
            present = top[1]
        return present, weight

    def _changed(self, present: Members) -> Iterator[tuple[float, Members]]:
        """Weights and sets with each member taken out, and with each exchanged for what is best instead."""
        self._lose(present)
        for i in present:
            fewer = tuple(j for j in present if j != i)
            others, without = self.grown(fewer)
            yield without, fewer
            yield self._best_of(fewer, others)

    def _best_of(self, base: Members, weights: np.ndarray) -> tuple[float, Members]:
        return float(weights.max()), (*base, int(np.argmax(weights)))


def room(h: Hypothesis, other: Hypothesis) -> bool:
    """Whether two may act side by side."""
    if bool(h.unnamed) != bool(other.unnamed):
        return not _covers(*((h, other) if h.unnamed else (other, h)))
    if h.unnamed:
        return h.key != other.key or h.unnamed != other.unnamed
    return h.family != other.family or (h.together and h.label != other.label)


def _kind(h: Hypothesis) -> tuple:
    number = h.where.rpartition("-")[2]
    own = h.unnamed and all(name.endswith(number) for name in h.unnamed)
    return tuple(name.removesuffix(number) for name in h.unnamed) if own else (*h.key, h.label)


def _covers(function: Hypothesis, law: Hypothesis) -> bool:
    """Whether an unnamed function leaves no room for a law: it makes what the law makes, of what the law reads.

    At a joint a function of any angles leaves none for slow waves and for another angle's share either.
    """
    if function.where not in same_place(law):
        return False
    if _fast(function, law):
        return False
    angles = all(name[0] == "q" for name in function.unnamed)
    slow = law.effect == _WAVE and law.effects and law.effects[0].order <= _SLOW
    if angles and function.where == law.where and (slow or law.effect == JointCoupling.effect):
        return True
    return bool(_reads(law) & set(function.unnamed))


def same_place(law: Hypothesis) -> tuple[str, ...]:
    """A law's place, and of a joint the links before and after it: they turn about its axis, too."""
    if not law.where.startswith("joint-"):
        return (law.where,)
    k = int(law.where.rpartition("-")[2])
    return law.where, f"link-{k}", f"link-{k - 1}" if k > 1 else "base"


def _reads(law: Hypothesis) -> set[str]:
    """Covariates of which a law of one joint is a function."""
    return set(law.effects[0].reads) if law.effects and law.where.startswith("joint-") else set()


def _fast(function: Hypothesis, law: Hypothesis) -> bool:
    """Whether a wave has more turns in these poses than a function can follow that may change sharply."""
    if law.effect != _WAVE or not isinstance(law.source, tuple):
        return False
    scan, order = law.source
    return order * np.ptp(scan.x) / 2 > SHARP_DEGREE
