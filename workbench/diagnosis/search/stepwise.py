"""The stepwise search: terms are added, dropped and exchanged as long as the log posterior of the set rises.

From several starts: what is accepted already, the best single term, the best pair, each effect at all places where it
is likely, and the compliances of all joints. Pairs are tried because neither of two terms that hide one another is
likely alone.
"""

from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.search.objective import LogPosterior, Members
from workbench.diagnosis.search.prior import is_elastic

LAW = 0.95
"""Share of what smooth nonparametric functions explain that laws must explain: no law is exact."""
_MAX_TERMS, _MAX_SMOOTH = 12, 2
"""Terms in a set, and smooth nonparametric functions among them, at most: recordings do not determine more."""
_PAIRED, _KINDS = 40, 3
"""Terms of which the best partner is sought for a start, and kinds of effects that start at all places."""


@dataclass(frozen=True)
class Stepwise:
    """A search over the sets of terms of one objective."""

    objective: LogPosterior

    def most_probable_set(self, present: Members = ()) -> Members:
        """The likeliest set.

        Where laws explain `LAW` of what smooth functions do, the remainder is the model error of the laws and is
        ignored: the simpler of the two is taken.
        """
        objective = self.objective
        lawful = self._most_probable_laws(present)
        if not objective.is_smooth.any():
            return lawful
        starts = [present, lawful] if present else [lawful, *self._free_starts()]
        free = self._best(starts, np.ones(len(objective.terms), bool))
        explained = objective.gain(lawful)
        if explained >= LAW * objective.gain(free):
            return max(lawful, free, key=lambda members: objective.value_at(members, explained))
        return free

    def _most_probable_laws(self, present: Members) -> Members:
        """The likeliest set of laws, searched without the many columns of functions."""
        laws = np.flatnonzero(~self.objective.is_smooth)
        alone = Stepwise(self.objective.among(laws))
        allowed = np.ones(len(laws), bool)
        named = tuple(int(i) for i in np.flatnonzero(np.isin(laws, present)))
        starts = [named, alone._single(allowed)] if named else alone._starts(allowed)
        starts.append(alone.with_all_joints(named))
        return tuple(int(laws[i]) for i in alone._best(starts, allowed))

    def with_all_joints(self, members: Members) -> Members:
        """A set with the compliances of all joints in the place of its elastic terms, as far as they are terms.

        All joints of an arm deflect under the same links, so that a harmonic and a bent link together may make what
        two joints do: exchanges of single terms do not lead from one pair to the other.
        """
        objective = self.objective
        usual = objective.priors.is_usual
        exchanged = [i for i in members if not is_elastic(objective.terms[i])]
        for i in np.flatnonzero(usual):
            if objective.compatible_pairs[i, exchanged].all():
                exchanged.append(int(i))
        return tuple(exchanged) if usual.any() else members

    def climb(self, members: Members) -> Members:
        """The set that single moves from a given one lead to."""
        return self._climb(members, np.ones(len(self.objective.terms), bool))

    def _best(self, starts: list[Members], allowed: np.ndarray) -> Members:
        ends = [self._climb(start, allowed) for start in dict.fromkeys(starts)]
        return max(ends, key=self.objective.value, default=())

    def _climb(self, members: Members, allowed: np.ndarray) -> Members:
        """The set after moves that each raise its log posterior most."""
        weight = self.objective.value(members)
        while True:
            reached, best = self._best_move(members, allowed, weight)
            if reached <= weight + 1e-6:
                return members
            members, weight = best, reached

    def _best_move(self, members: Members, allowed, weight: float) -> tuple[float, Members]:
        """The likeliest set with one term more, and where that is no likelier, with one less or another."""
        objective = self.objective
        top = (-np.inf, members)
        if len(members) < _MAX_TERMS:
            top = objective.most_probable_extension(members, self._open(members, allowed))
        if top[0] > weight + 1e-6:
            return top
        for i in members:
            fewer = tuple(j for j in members if j != i)
            exchanged = objective.most_probable_extension(fewer, self._open(fewer, allowed))
            top = max(top, (objective.value(fewer), fewer), exchanged)
        for fewer in self._without_place(members):
            top = max(top, objective.most_probable_extension(fewer, self._open(fewer, allowed)))
        return top

    def _without_place(self, members: Members) -> list[Members]:
        """The set without all laws of one place that read the same covariates, where there are several.

        One other may explain them all: an error curve of a joint is a series of harmonics, too.
        """
        groups: dict[tuple, list[int]] = {}
        for i in members:
            term = self.objective.terms[i]
            read = [name for effect in term.effects for name in effect.reads]
            if read and not term.smooth_covariates:
                groups.setdefault((term.where, *sorted(read)), []).append(i)
        several = [group for group in groups.values() if len(group) > 1]
        return [tuple(i for i in members if i not in group) for group in several]

    def _open(self, members: Members, allowed: np.ndarray) -> np.ndarray:
        """(K,) the allowed terms, without functions where there are `_MAX_SMOOTH` of them."""
        functions = sum(bool(self.objective.is_smooth[i]) for i in members)
        return allowed & ~self.objective.is_smooth if functions >= _MAX_SMOOTH else allowed

    def _starts(self, allowed: np.ndarray) -> list[Members]:
        return [self._single(allowed), self._pair(allowed), *self._kinds(allowed)]

    def _free_starts(self) -> list[Members]:
        return [self._single(self.objective.is_smooth), *self._kinds(self.objective.is_smooth)]

    def _single(self, allowed: np.ndarray) -> Members:
        return self.objective.most_probable_extension((), allowed)[1]

    def _pair(self, allowed: np.ndarray) -> Members:
        """The likeliest pair of which one is among the likeliest alone."""
        rows = np.flatnonzero(allowed)[:_PAIRED]
        pairs = [self.objective.most_probable_extension((int(i),), allowed) for i in rows]
        return max(pairs, default=(0.0, ()))[1]

    def _kinds(self, allowed: np.ndarray) -> list[Members]:
        """Each effect at all places, each kind of function at all joints, where more than two are at hand."""
        kinds: dict[tuple, list[int]] = {}
        for i in np.flatnonzero(allowed):
            term = self.objective.terms[i]
            if term.smooth_covariates or not isinstance(term.source, Scan):
                members = kinds.setdefault(_kind(term), [])
                if len(members) < _MAX_TERMS and self.objective.compatible_pairs[i, members].all():
                    members.append(int(i))
        many = [tuple(members) for members in kinds.values() if len(members) > 2]
        return sorted(many, key=self.objective.value, reverse=True)[:_KINDS]


def _kind(term) -> tuple:
    """("move",) of functions of each joint's own move, at whatever joint; else the effect."""
    if not term.smooth_covariates:
        return (term.effect,)
    number = term.where.rpartition("-")[2]
    if all(name.endswith(number) for name in term.smooth_covariates):
        return tuple(name.removesuffix(number) for name in term.smooth_covariates)
    return (*term.key, term.label)
