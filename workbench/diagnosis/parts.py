"""Laws that are only a part of what else is accepted, or that cannot be: taken out once all is solved."""

from workbench.diagnosis.evidence import Projected
from workbench.diagnosis.findings import ELASTIC
from workbench.diagnosis.hypotheses import Hypothesis
from workbench.diagnosis.search import Search
from workbench.diagnosis.sets import LAW, Sets, same_place

_ROUNDS = 3


def folded(search: Search):
    """Laws that explain less than an unknown at their place, or near it than it is wrong by, are a part of it.

    A smooth function is no more exact than a law: what it misses of what is there lies about where it lies.
    """
    gains = [search.beside(i)[0] for i in search.everyone]
    unknown = [(h.where, gain) for h, gain in zip(search.accepted, gains) if h.unnamed]
    gone = _twins(search, gains)
    for i, h in enumerate(search.accepted):
        own = same_place(h)
        least = [
            gain * (1.0 if where in own else 1 - LAW)
            for where, gain in unknown
            if near(h.where, where)
        ]
        if not h.unnamed and gains[i] < max(least, default=0.0):
            gone.add(i)
    if gone:
        search.without(gone, "taken for a part of what else is there")


def against(search: Search):
    """Leave out what yields against its load once all is solved: an alarm, and not a law."""
    for _ in range(_ROUNDS):
        gone = {i for i in search.everyone if search.against(i)}
        if not gone:
            return
        search.without(
            {min(gone, key=lambda i: search.beside(i)[0])}, "it would yield against its load"
        )


def outdone(search: Search) -> Hypothesis | None:
    """A function without a name that is likelier than all laws together that stay, and explains more than laws miss.

    A dozen laws can make what one function makes, be preferred to it for that, and then lose their members one by one.
    """
    if not search.accepted or any(h.unnamed for h in search.accepted):
        return None
    functions = [h for h in search.table(()) if h.unnamed and not h.effects]
    if not functions:
        return None
    bare, best = search.problem.keeping(()), max(functions, key=lambda h: h.log_weight)
    sets = Sets.of(Projected(bare), bare, [*(search.own(i) for i in search.everyone), best])
    alone = (len(search.accepted),)
    better = LAW * sets.gain(alone) > sets.gain(search.everyone)
    return best if better and sets.grown(alone)[1] > sets.grown(search.everyone)[1] else None


def _twins(search: Search, gains: list[float]) -> set[int]:
    """The less likely of two laws that yield at one place in two ways, where it adds less to the other than laws are
    wrong by.
    """
    gone: set[int] = set()
    for i, h in enumerate(search.accepted):
        for j in range(i):
            other = search.accepted[j]
            same = other.where in same_place(h) or h.where in same_place(other)
            if same and h.effect != other.effect and {h.effect, other.effect} <= set(ELASTIC):
                small = min(i, j, key=lambda k: search.own(k).log_weight)
                gone |= {small} if gains[small] < (1 - LAW) * search.together((i, j)) else set()
    return gone


def near(place: str, other: str) -> bool:
    """Whether two places are the same, or of neighbouring links."""
    numbers = [int(p.rpartition("-")[2]) for p in (place, other) if "-" in p]
    return place == other or len(numbers) == 2 and abs(numbers[0] - numbers[1]) <= 1


__all__ = ["against", "folded", "near", "outdone"]
