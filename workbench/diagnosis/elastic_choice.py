"""Names of elastic terms, chosen and given a probability by the posterior over sets of them.

A search that adds and exchanges one term at a time can end with one link in place of a joint and another link, and its
conditional probabilities know only single exchanges. Here the accepted elastic terms are compared with all other sets.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.elastic_sets import ElasticSets, Key, is_member
from workbench.diagnosis.hypotheses import Hypothesis

_LEAST = 0.005  # probability from which on a term is listed as an alternative
_SHOWN = 6


@dataclass(frozen=True)
class Name:
    """`probability` that an elastic term is present, over all sets; `instead`: (key, probability, alike) of others.

    The probability of an alternative is that the term is absent and the alternative, which is not accepted, present.
    """

    probability: float
    instead: tuple[tuple[Key, float, float], ...] = ()


def exchange_elastic_terms(search) -> bool:
    """Replace the accepted elastic terms by the likeliest set of them; whether anything was exchanged.

    search: as in `select`. A variant that is accepted (with its masses estimated) stays where its name stays.
    """
    mine = _members(search.accepted)
    if not mine:
        return False
    sets, start = _sets(search, mine)
    if sets is None:
        return False
    wanted = {sets.terms[i].key for i in sets.best(start)}
    held = {search.accepted[i].key for i in mine}
    if wanted == held:
        return False
    new = [
        h for h in (_of_key(search, mine, key) for key in sorted(wanted - held)) if h is not None
    ]
    gone = {i for i in mine if search.accepted[i].key not in wanted}
    if not new and not gone:
        return False
    before = (
        ", ".join(
            f"{search.accepted[i].effect} at {search.accepted[i].where}" for i in sorted(gone)
        )
        or "nothing"
    )
    after = ", ".join(f"{h.effect} at {h.where}" for h in new) or "nothing"
    search.say(f"{after} instead of {before}: the likelier set of elastic terms")
    search.accepted = (*(h for i, h in enumerate(search.accepted) if i not in gone), *new)
    search.solve()
    return True


def probabilities_of_names(search) -> dict[Key, Name]:
    """Of every elastic term that might be present: its posterior over sets; empty where none was accepted."""
    mine = _members(search.accepted)
    if not mine:
        return {}
    sets, start = _sets(search, mine)
    if sets is None:
        return {}
    window, weights = sets.window(sets.best(start))
    chance = np.zeros(len(sets.terms))
    for members, weight in zip(window, weights):
        chance[list(members)] += weight
    accepted = {search.accepted[i].key for i in mine}
    return {
        term.key: Name(float(min(chance[i], 1.0)), _instead(sets, i, window, weights, accepted))
        for i, term in enumerate(sets.terms)
    }


def _instead(sets: ElasticSets, i: int, window, weights, accepted: set[Key]):
    """What is present in the sets without term i, besides what is accepted anyway."""
    share = np.zeros(len(sets.terms))
    for members, weight in zip(window, weights):
        if i not in members:
            share[list(members)] += weight
    order = np.argsort(-share)[:_SHOWN]
    return tuple(
        (sets.terms[j].key, float(share[j]), sets.alike(i, j))
        for j in order
        if share[j] >= _LEAST and sets.terms[j].key not in accepted
    )


def _members(accepted: Sequence[Hypothesis]) -> list[int]:
    """Numbers of the accepted terms that belong to the sets."""
    return [i for i, h in enumerate(accepted) if not h.unnamed and is_member(h.effect, h.effects)]


def _sets(search, mine: list[int]) -> tuple[ElasticSets | None, tuple[int, ...]]:
    """The sets in the problem that keeps all other terms, and the set that is accepted."""
    others = tuple(i for i in search.everyone if i not in mine)
    sets = ElasticSets.of(search.problem.keeping(others))
    if sets is None:
        return None, ()
    numbers = {term.key: i for i, term in enumerate(sets.terms)}
    keys = [search.accepted[i].key for i in mine]
    return sets, tuple(numbers[key] for key in keys if key in numbers)


def _of_key(search, mine: list[int], key: Key) -> Hypothesis | None:
    """The plain variant of a term as the table without the elastic terms judges it."""
    others = tuple(i for i in search.everyone if i not in mine)
    rows = [h for h in search.table(others) if h.key == key and is_member(h.effect, h.effects)]
    return next(
        (h for h in rows if not h.label or h.label.startswith("order")), rows[0] if rows else None
    )


__all__ = ["Name", "exchange_elastic_terms", "probabilities_of_names"]
