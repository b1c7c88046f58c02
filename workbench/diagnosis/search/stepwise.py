"""The stepwise search: terms are added, dropped and exchanged as long as the log posterior of the set rises.

From several starts: what is accepted already, the best single term, and the compliances of all joints.
"""

from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.search.objective import LogPosterior, Members
from workbench.diagnosis.search.prior import is_elastic

LAW = 0.95
"""Share of what smooth nonparametric functions explain that laws must explain: no law is exact."""
_MAX_TERMS, _MAX_SMOOTH = 15, 2
"""Terms in a set, and smooth nonparametric functions among them, at most. The posterior usually stops growing before.
Of a real arm with error curves of ever smaller waves, 18 terms take three times as long to find as 15."""
_LEAST_RISE = 1e-6
"""Of the log posterior: less is rounding, by which moves would go in circles."""


@dataclass(frozen=True)
class Stepwise:
    """A search over the sets of terms of one objective.

    `waves`: numbers of waves of one order, which may be significant only as a set.
    """

    objective: LogPosterior
    waves: Members = ()

    def most_probable_set(self, present: Members = ()) -> Members:
        """The set with the highest log posterior that is reached.

        Where laws explain `LAW` of what smooth functions do, the remainder is the model error of the laws and is
        ignored: the simpler of the two is taken.
        """
        objective = self.objective
        lawful = self._most_probable_laws(present)
        if not objective.is_smooth.any():
            return lawful
        if present:
            starts = [present, lawful]
        else:
            starts = [lawful, self._single(objective.is_smooth)]
        free = self._best(starts)
        explained = objective.gain(lawful)
        if explained >= LAW * objective.gain(free):
            return max(lawful, free, key=lambda members: objective.value_at(members, explained))
        return free

    def _most_probable_laws(self, present: Members) -> Members:
        """The most probable set of laws, searched without the many columns of smooth functions."""
        laws = np.flatnonzero(~self.objective.is_smooth)
        alone = Stepwise(self.objective.select_terms(laws))
        named = tuple(int(i) for i in np.flatnonzero(np.isin(laws, present)))
        starts = [named] if named else []
        starts += [alone._single(alone._allowed(())), alone.with_all_joints(named)]
        starts += [alone.with_terms(named, np.flatnonzero(np.isin(laws, self.waves)))]
        return tuple(int(laws[i]) for i in alone._best(starts))

    def with_all_joints(self, members: Members) -> Members:
        """A set whose elastic terms are replaced by the compliances of all joints, as far as they are candidates.

        All joints of an arm deflect under the same links, so that a harmonic and a compliant link together may imitate
        two compliant joints. Exchanges of single terms do not lead from one pair to the other.
        """
        objective = self.objective
        usual = objective.priors.is_usual
        exchanged = [i for i in members if not is_elastic(objective.terms[i])]
        for i in np.flatnonzero(usual):
            if objective.compatible_pairs[i, exchanged].all():
                exchanged.append(int(i))
        return tuple(exchanged) if usual.any() else members

    def with_terms(self, members: Members, numbers: np.ndarray) -> Members:
        """A set with further terms, as far as they are compatible with it."""
        joined = list(members)
        for i in numbers:
            if self.objective.compatible_pairs[i, joined].all():
                joined.append(int(i))
        return tuple(joined)

    def climb(self, members: Members) -> Members:
        """The local maximum that is reached from a set by the moves that raise the log posterior most."""
        value = self.objective.value(members)
        while True:
            reached, best = self._best_move(members, value)
            if reached <= value + _LEAST_RISE:
                return members
            members, value = best, reached

    def _best(self, starts: list[Members]) -> Members:
        ends = [self.climb(start) for start in dict.fromkeys(starts)]
        return max(ends, key=self.objective.value, default=())

    def _best_move(self, members: Members, value: float) -> tuple[float, Members]:
        """The best set with one term more; where that is not better, the best with one term less or exchanged."""
        objective = self.objective
        top = (-np.inf, members)
        if len(members) < _MAX_TERMS:
            top = objective.most_probable_extension(members, self._allowed(members))
        if top[0] > value + _LEAST_RISE:
            return top
        for i in members:
            fewer = tuple(j for j in members if j != i)
            exchanged = objective.most_probable_extension(fewer, self._allowed(fewer))
            top = max(top, (objective.value(fewer), fewer), exchanged)
        return top

    def _allowed(self, members: Members) -> np.ndarray:
        """(K,) bool: terms that may join a set, no functions where it has `_MAX_SMOOTH` of them."""
        is_smooth = self.objective.is_smooth
        functions = sum(bool(is_smooth[i]) for i in members)
        if functions >= _MAX_SMOOTH:
            return ~is_smooth
        return np.ones(len(is_smooth), bool)

    def _single(self, allowed: np.ndarray) -> Members:
        return self.objective.most_probable_extension((), allowed)[1]
