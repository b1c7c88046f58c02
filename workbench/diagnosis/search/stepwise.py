"""The stepwise search: terms are added, dropped and exchanged as long as the log posterior of the set rises.

From what is accepted already, and from the best single term; with functions, also from the likeliest set of laws.
"""

from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.search.objective import LogPosterior, Members

LAW = 0.95
"""Share of what smooth nonparametric functions explain that laws must explain: no law is exact."""
_MAX_TERMS, _MAX_SMOOTH = 12, 2
"""Terms in a set, and smooth nonparametric functions among them, at most: recordings do not determine more."""
_STEPS = 60
"""Moves of a climb: a set of the largest size is made and wholly exchanged in fewer."""


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
        starts = [present or self._single(objective.is_smooth), lawful]
        free = self._best(starts, np.ones(len(objective.terms), bool))
        explained = objective.gain(lawful)
        if explained >= LAW * objective.gain(free):
            return max(lawful, free, key=lambda members: objective.value_at(members, explained))
        return free

    def _most_probable_laws(self, present: Members) -> Members:
        """The likeliest set of laws, searched without the many columns of functions."""
        laws = np.flatnonzero(~self.objective.is_smooth)
        alone = Stepwise(self.objective.among(laws))
        every = np.ones(len(laws), bool)
        named = tuple(int(i) for i in np.flatnonzero(np.isin(laws, present)))
        starts = [named, alone._single(every)]
        return tuple(int(laws[i]) for i in alone._best(starts, every))

    def _best(self, starts: list[Members], allowed: np.ndarray) -> Members:
        ends = [self._climb(start, allowed) for start in dict.fromkeys(starts)]
        return max(ends, key=self.objective.value, default=())

    def _climb(self, members: Members, allowed: np.ndarray) -> Members:
        """The set after moves that each raise its log posterior most."""
        weight = self.objective.value(members)
        for _ in range(_STEPS):
            reached, best = self._best_move(members, allowed, weight)
            if reached <= weight + 1e-6:
                break
            members, weight = best, reached
        return members

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
        return top

    def _open(self, members: Members, allowed: np.ndarray) -> np.ndarray:
        """(K,) the allowed terms, without functions where there are `_MAX_SMOOTH` of them."""
        functions = sum(bool(self.objective.is_smooth[i]) for i in members)
        return allowed & ~self.objective.is_smooth if functions >= _MAX_SMOOTH else allowed

    def _single(self, allowed: np.ndarray) -> Members:
        return self.objective.most_probable_extension((), allowed)[1]


__all__ = ["LAW", "Stepwise"]
