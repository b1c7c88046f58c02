"""Posterior of effects: summed over the variants at a place, and for elastic terms over sets (Occam's window).

Madigan & Raftery, JASA 89 (1994) 1535: the probability of a term is the share of those sets near the most probable one
that contain it. A probability conditional on all other terms considers only single exchanges; elastic terms move the
measured point so similarly that two of them can be exchanged for two others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from robot_model.effects.transmission import TransmissionHarmonic
from workbench.core.least_squares.linear_algebra import pseudo_inverse
from workbench.diagnosis.levels import (
    LEAST_LOG_ODDS,
    LISTED_PROBABILITY,
    MAJORITY,
    MAX_ROUNDS,
    MOST_LISTED,
    ROUNDING,
)
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.compatible import CLOSE_GAIN, only_generalises
from workbench.diagnosis.search.constant_load import accept_constant_loads, prefer_stated_masses
from workbench.diagnosis.search.instants import refine_instants
from workbench.diagnosis.search.most_probable_set import loads_as_solved, order_by_gain
from workbench.diagnosis.search.objective import LogPosterior, Members
from workbench.diagnosis.search.options import refine_options
from workbench.diagnosis.search.prior import LAW_ERROR, is_elastic
from workbench.diagnosis.search.state import ALL, ELASTIC, LAWS, name_of
from workbench.diagnosis.search.stepwise import Stepwise

Key = tuple[str, str]
_WINDOW = -float(np.log(LISTED_PROBABILITY))
"""Log posterior odds against the best set beyond which a set is left out."""
_MOST_LOG_ODDS = 100.0
"""Log odds from which on more make no difference."""
_EXPANDED, _SWAPS = 8, 6
"""Sets of the window whose neighbours are weighed, and terms that are tried in place of each, the most alike first."""


@dataclass(frozen=True)
class EffectPosterior:
    """`probability` that a term is present, over all sets; `replacements`: (key, probability, likeness) of others.

    A set without the term counts for the alternatives, not accepted, that it holds instead, each by its share of the
    term's signature: term and alternatives exclude one another, and their probabilities add up to at most one.
    variation: RMS difference of its first coefficient in the sets that hold it from that in the accepted set, over the
    latter: what the law of total variance adds to a variance that holds for the accepted set alone.
    """

    probability: float
    replacements: tuple[tuple[Key, float, float], ...] = ()
    variation: float = 0.0


@dataclass(frozen=True)
class Window:
    """The sets of terms near the most probable one and their probabilities. `names`: of each term what it counts as."""

    objective: LogPosterior
    term_sets: tuple[Members, ...]
    weights: np.ndarray

    @classmethod
    def near_set(cls, objective: LogPosterior, best: Members, open_: Sequence[int]) -> "Window":
        """About a set, of which the terms `open_` are exchanged for one another."""
        done: set[frozenset] = set()
        seen = {frozenset(s): objective.value(s) for s in _starts(objective, best)}
        for _ in range(_EXPANDED):
            top = max(seen.values())
            unvisited = [s for s in seen if seen[s] > top - _WINDOW and s not in done]
            if not unvisited:
                break
            chosen = max(unvisited, key=seen.__getitem__)
            done.add(chosen)
            neighbours = _neighbours(objective, tuple(sorted(chosen)), open_)
            for members in neighbours:
                seen.setdefault(frozenset(members), objective.value(members))
        top = max(seen.values())
        probable_sets = [s for s in seen if seen[s] > top - _WINDOW]
        logs = np.array([seen[s] for s in probable_sets])
        weights = np.exp(logs - logsumexp(logs))
        term_sets = tuple(tuple(sorted(s)) for s in probable_sets)
        return cls(objective, term_sets, weights)

    def more_probable_set(self, count: int) -> Members | None:
        """The likeliest set, where it is worth more than the set of the first `count` terms; None where it is not."""
        best = int(np.argmax(self.weights))
        accepted_set = tuple(range(count))
        accepted = self.objective.value(accepted_set)
        gain = self.objective.value(self.term_sets[best]) - accepted
        return self.term_sets[best] if gain > LEAST_LOG_ODDS else None

    def fewest(self, count: int, open_: Sequence[int]) -> Members:
        """The set of the first `count` terms less those of the open ones that most sets lack and it hardly needs.

        The median probability model: Barbieri & Berger, Ann. Stat. 32 (2004) 870.
        """
        members = tuple(range(count))
        keys = [self.objective.terms[i].key for i in open_]
        present = self._present(keys)
        open_ = [i for i, key in zip(open_, keys) if self.weights @ present[key] < MAJORITY]
        value = self.objective.value(members)
        for i in open_:
            fewer = tuple(j for j in members if j != i)
            if self.objective.value(fewer) > value - LEAST_LOG_ODDS:
                members = fewer
        return members

    def more_probable_exchange(self, count: int) -> Members | None:
        """The set of the first `count` terms with the one exchanged whose best alternative is likelier by most.

        None where every term is the likeliest at its place.
        """
        terms = self.objective.terms
        numbers = {h.key: i for i, h in enumerate(terms)}
        elastic_keys = [h.key for h in terms if is_elastic(h)]
        accepted_keys = {h.key for h in terms[:count]}
        names = self.names(accepted_keys, elastic_keys)
        best, exchanged = 0.0, None
        for i, h in enumerate(terms[:count]):
            name = names.get(h.key)
            if name is None or not name.replacements:
                continue
            other, probability, _ = name.replacements[0]
            if probability - name.probability > best:
                best = probability - name.probability
                positions = range(count)
                exchanged = tuple(numbers[other] if j == i else j for j in positions)
        return exchanged

    def names(self, accepted: set[Key], keys: Sequence[Key]) -> dict[Key, EffectPosterior]:
        """Of each key its probability, and of those accepted what is present instead in the sets without it."""
        present = self._present(keys)
        others = [key for key in keys if key not in accepted]
        occurrence = np.array([present[key] for key in others]).reshape(
            len(others), len(self.term_sets)
        )
        out = {}
        for key in keys:
            absent = self.weights * ~present[key]
            if key in accepted:
                replacements = self._replacements(key, others, occurrence, absent)
            else:
                replacements = ()
            out[key] = EffectPosterior(float(min(self.weights @ present[key], 1.0)), replacements)
        return out

    def variation(self, number: int, count: int) -> float:
        """`variation` of the name of one of the first `count` terms; 0 where its coefficients may have any sign."""
        accepted = tuple(range(count))
        if not self.objective.priors.positive[number]:
            return 0.0
        holding = [k for k, members in enumerate(self.term_sets) if number in members]
        value = self.objective.coefficient(accepted, number)
        others = [self.objective.coefficient(self.term_sets[k], number) for k in holding]
        holding_weights = self.weights[holding]
        weights = holding_weights / max(holding_weights.sum(), ROUNDING)
        deviations = (np.array(others) - value) ** 2
        return float(np.sqrt(weights @ deviations) / max(abs(value), 1e-300))

    def _replacements(
        self, key: Key, others: Sequence[Key], occurrence: np.ndarray, absent: np.ndarray
    ):
        """`EffectPosterior.replacements` of a key: occurrence (others, sets), absent (sets,) weights without it."""
        likeness = np.array([explained_share(self.objective, key, other) for other in others])
        likely = np.maximum(likeness, ROUNDING)
        likeness_of_sets = occurrence * likely[:, None]
        totals = np.maximum(likeness_of_sets.sum(0), ROUNDING)
        shares = likeness_of_sets / totals @ absent
        in_order = np.argsort(-shares)[:MOST_LISTED]
        ranked = [k for k in in_order if shares[k] >= LISTED_PROBABILITY]
        return tuple((others[k], float(shares[k]), float(likeness[k])) for k in ranked)

    def _present(self, keys: Sequence[Key]) -> dict[Key, np.ndarray]:
        """Key -> (sets,) bool."""
        keys_of_sets = [
            {self.objective.terms[i].key for i in members} for members in self.term_sets
        ]
        return {key: np.array([key in names for names in keys_of_sets]) for key in keys}


def _starts(objective: LogPosterior, best: Members) -> list[Members]:
    """A set, and the one that the compliances of all joints in the place of its elastic terms lead to."""
    search = Stepwise(objective)
    return [best, search.climb(search.with_all_joints(best))]


def _neighbours(objective: LogPosterior, members: Members, open_: Sequence[int]) -> list[Members]:
    """Sets with one of the open terms more, less, or exchanged."""
    compatible_pairs = objective.compatible_pairs
    out = [(*members, i) for i in open_ if compatible_pairs[i, list(members)].all()]
    for i in members:
        if i not in open_:
            continue
        fewer = tuple(j for j in members if j != i)
        out.append(fewer)
        free = [j for j in open_ if j != i and compatible_pairs[j, list(fewer)].all()]
        free.sort(key=lambda j: -_share(objective, i, j))
        out += [(*fewer, j) for j in free[:_SWAPS]]
    return out


def explained_share(objective: LogPosterior, key: Key, other: Key) -> float:
    """Share (0-1) of a term's first column, the baseline projected out, that another term's columns make."""
    in_reverse = reversed(list(enumerate(objective.terms)))
    numbers = {h.key: i for i, h in in_reverse}
    return _share(objective, numbers[key], numbers[other])


def _share(objective: LogPosterior, i: int, j: int) -> float:
    first = objective.start[i]
    columns = objective.index((j,))
    length = float(objective.gram[first, first])
    if not length > 0:
        return 0.0
    cross = objective.gram[first, columns]
    inner = objective.gram[np.ix_(columns, columns)]
    inverse = pseudo_inverse(inner, 1e-9)
    return float(np.clip(cross @ inverse @ cross / length, 0.0, 1.0))


def effect_posteriors(search) -> dict[Key, EffectPosterior]:
    """Of every elastic term that might be present, where one is accepted; search: as in `state`."""
    window = _elastic_window(search)
    if window is None:
        return {}
    terms = window.objective.terms
    count = len(search.accepted)
    names = window.names({h.key for h in terms[:count]}, [h.key for h in terms if is_elastic(h)])
    for number, h in enumerate(terms[:count]):
        if h.key in names:
            names[h.key] = replace(names[h.key], variation=window.variation(number, count))
    return names


def exchange_terms(search) -> None:
    """Exchange what is accepted for what is likelier once variants, and sets of elastic terms, are summed over."""
    _exchange_laws(search)
    _exchange_elastic(search)
    if any(h.effect == TransmissionHarmonic.effect and is_elastic(h) for h in search.accepted):
        # sets of elastic terms exchange a curve for the wave that is one of them
        _exchange_laws(search)
    accept_constant_loads(search)
    prefer_stated_masses(search)
    # a prediction does not depend on the last digits of an order
    refine_options(search, rounds=1 if search.for_prediction else MAX_ROUNDS)
    refine_instants(search)


def _exchange_laws(search) -> None:
    """Exchange accepted laws for effects whose posterior, summed over the variants at a place, is higher.

    The search compares sets of single variants. A step at one of many instants has a small share of its family's prior
    at each of them, so that a law without such an option may win against every single instant and still be less
    probable than all of them together. Names of elastic laws come from sets. An exchange changes what is likely in the
    place of the others, which are then compared again.
    """
    tried = [{name_of(h) for h in search.accepted}]
    for _ in range(MAX_ROUNDS):
        for i in search.accepted_indices:
            other = _more_probable_variant(search, i)
            if other is not None:
                search.accepted = (*search.accepted[:i], other, *search.accepted[i + 1 :])
                search.solve()
        names = {name_of(h) for h in search.accepted}
        if names in tried:
            break
        tried.append(names)
    if len(tried) > 1:
        search.solve_feasible()


def _more_probable_variant(search, i: int) -> Hypothesis | None:
    """The best variant of the effect with the highest marginal posterior; None where that is the accepted one.

    A law may take the place of a smooth nonparametric alternative, but no alternative that of a law: laws are not
    exact, and it makes the error of a law as well.
    """
    accepted = search.accepted[i]
    is_wave = accepted.effect == TransmissionHarmonic.effect  # of order 1 it counts as elastic
    if is_elastic(accepted) and not is_wave:
        return None
    # functions compete with functions alone; most of these solutions are exchanged before terms are named
    table = search.alternatives(i, ALL if accepted.smooth_covariates else LAWS)
    if law := _law_of_function(search, i, table):
        return law
    families: dict[Key, list[Hypothesis]] = {}
    tested = search.conditional_hypothesis(i, table)
    chance = CLOSE_GAIN * search.variance()
    with_elastic = bool(accepted.smooth_covariates) or is_elastic(accepted)
    for h in table:
        is_law = not h.smooth_covariates and (with_elastic or not is_elastic(h))
        is_law = is_law and not only_generalises(h, tested, chance)
        if is_law or (accepted.smooth_covariates and h.key == accepted.key):
            families.setdefault(h.key, []).append(h)
    marginal = {
        key: logsumexp([h.log_weight for h in variants]) for key, variants in families.items()
    }
    best = max(marginal, key=marginal.get, default=None)
    if accepted.key not in marginal or marginal[best] - marginal[accepted.key] < LEAST_LOG_ODDS:
        return None
    other = max(families[best], key=lambda h: h.log_weight)
    # signs and prior sizes of elastic terms are known to sets alone
    if is_elastic(other) and not _raises_posterior(search, i, other):
        return None
    return other


def _law_of_function(search, i: int, table: Sequence[Hypothesis]) -> Hypothesis | None:
    """The likeliest law that is an accepted nonparametric alternative, see `is_law_of_function`."""
    accepted = search.accepted[i]
    if not accepted.smooth_covariates:
        return None
    function = search.conditional_hypothesis(i, table)
    laws = [h for h in table if not is_elastic(h) and is_law_of_function(function, h)]
    return max(laws, key=lambda h: h.log_weight, default=None)


def is_law_of_function(function: Hypothesis, law: Hypothesis) -> bool:
    """Whether a law of a joint's own angle explains as much as a smooth function of this angle does.

    Any error of a joint that is a function of its own angle is a `joint-curve`; the two differ only by their bases.
    """
    is_there = not law.smooth_covariates and law.where == function.where
    return (
        is_there
        and law.reads == set(function.smooth_covariates)
        and law.gain >= (1 - LAW_ERROR) * function.gain
    )


def _raises_posterior(search, i: int, other: Hypothesis) -> bool:
    """Whether the accepted set, with signs and priors, is clearly likelier with another term in the place of one."""
    objective = _objective_with(search, [other])
    present = search.accepted_indices
    exchanged = tuple(len(present) if k == i else k for k in present)
    rise = objective.value(exchanged) - objective.value(present)
    return rise > LEAST_LOG_ODDS


def _objective_with(search, others: Sequence[Hypothesis]) -> LogPosterior:
    """The objective of sets of the accepted terms, which come first, and others."""
    accepted = search.current_terms()
    terms = [*accepted, *others]
    solved = loads_as_solved(search, accepted)
    return LogPosterior.of(search.problem.conditional_on(()), terms, accepted=solved)


def odds_of_both(search, i: int, others: Sequence[Hypothesis]) -> np.ndarray:
    """(K,) posterior odds of each other term in addition to an accepted one over the other in the place of it.

    0 where the two cannot act together.
    """
    objective = _objective_with(search, others)
    present = search.accepted_indices
    out = np.zeros(len(others))
    for k in range(len(others)):
        number = len(present) + k
        joint_value = objective.value((*present, number))
        if not objective.compatible_pairs[number, i] or not np.isfinite(joint_value):
            continue
        exchanged = objective.value(tuple(number if j == i else j for j in present))
        out[k] = np.exp(min(joint_value - exchanged, _MOST_LOG_ODDS))
    return out


def _exchange_elastic(search) -> None:
    """Accept the likeliest set of the window of elastic terms, where it is clearly likelier than the accepted one.

    Else, of each term, the name that the most of the probability of the sets has.

    The search exchanges what is at hand, the window all elastic terms: what is accepted and the probabilities of names
    then agree.
    """
    tried = [{name_of(h) for h in search.accepted}]
    for _ in range(MAX_ROUNDS):
        window = _elastic_window(search)
        if window is None:
            break
        count = len(search.accepted)
        members = window.more_probable_set(count) or window.more_probable_exchange(count)
        if members is None:
            elastic = [i for i in search.accepted_indices if is_elastic(search.accepted[i])]
            members = window.fewest(count, elastic)
        if len(members) == count and set(members) == set(range(count)):
            break
        # an accepted function without a law is solved with its effect, which its row in a table does not have
        terms = (*search.accepted, *window.objective.terms[len(search.accepted) :])
        chosen = [terms[i] for i in members]
        names = {name_of(h) for h in chosen}
        if names in tried:
            break
        tried.append(names)
        search.accepted = tuple(chosen)
        search.record_terms(chosen)
        search.solve_feasible()
    if len(tried) > 1:
        order_by_gain(search)


def _elastic_window(search) -> Window | None:
    """The sets about the accepted one, whose terms come first; None where no elastic term is accepted."""
    elastic = [i for i in search.accepted_indices if is_elastic(search.accepted[i])]
    if not elastic:
        return None
    accepted = search.current_terms()
    others = tuple(i for i in search.accepted_indices if i not in elastic)
    plain: dict[Key, object] = {}
    for h in search.table(others, ELASTIC):
        if not h.label.startswith(LABEL):
            plain.setdefault(h.key, h)
    known = {h.key for h in accepted}
    unlisted = (h for key, h in plain.items() if key not in known)
    terms = [*accepted, *unlisted]
    solved = loads_as_solved(search, accepted)
    problem = search.problem.conditional_on(())
    objective = LogPosterior.of(problem, terms, accepted=solved)
    open_ = [i for i, h in enumerate(terms) if is_elastic(h)]
    current_set = tuple(range(len(accepted)))
    return Window.near_set(objective, current_set, open_)
