"""Which effects are missing: sets searched in the linearised problem, solved non-linearly, each then questioned."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from workbench.diagnosis.data import far_off, of_data, unevenly
from workbench.diagnosis.elastic_choice import exchange_elastic_terms, probabilities_of_names
from workbench.diagnosis.evidence import Projected
from workbench.diagnosis.findings import finding, tells, with_hidden
from workbench.diagnosis.hypotheses import Hypothesis, family_wise, judged
from workbench.diagnosis.joint_functions import merge_joint_functions
from workbench.diagnosis.locate import located
from workbench.diagnosis.parts import against, folded, near, outdone
from workbench.diagnosis.problem import Bench, Found, Problem
from workbench.diagnosis.rest import grown_by_prediction
from workbench.diagnosis.rounded_readings import rounded_readings
from workbench.diagnosis.scatter import CLAIMED, Scatter, beside, place_of, scattered, told
from workbench.diagnosis.search import Search, name_of
from workbench.diagnosis.sets import LAW, SECOND, Sets, room

LEVEL = 0.005
"""Chance that a recording with nothing missing is said to miss something."""
_ROUNDS, _GROWN, _WIDE = 3, 3, 6
_MANY = 1200  # samples beyond which a search takes only every so many poses
_FIRST, _BESIDE, _EACH, _UNNAMED = (
    48,
    24,
    4,
    6,
)  # hypotheses taken from each table into the search of sets
_SMALL = "not beyond chance, or too small, beside the others"
LAW_ERROR = 0.015
"""Share of an elastic law's effect that it may be wrong by: angles by tenths of a degree, lengths by a millimetre."""


def find(
    bench: Bench,
    samples: np.ndarray | None = None,
    *,
    level: float = LEVEL,
    progress: Callable[[str], None] = lambda text: None,
) -> Found:
    """What the baseline of a bench leaves out, on `samples` (n,) bool (None: all).

    level: chance of a false alarm on the whole search. Raises what the bench's solve raises.
    """
    search = Search(bench, samples, level, progress)
    search.solve()
    if search.problem.n > _MANY and not getattr(bench, "whole", False):
        return _confirmed(search, samples)
    found = _found(search)
    return bench.reviewed(found, samples) if hasattr(bench, "reviewed") else found


def _found(search: Search) -> Found:
    """Set found, pruned and questioned on the search's samples."""
    level, before, table = search.level, search.plain, search.table(())
    places = located(search.problem, table)
    first = _first(search)
    search.spread = unevenly(search.problem.keeping())
    if search.spread is not None:  # what grows with a covariate also passes for a function of it
        search.say("the noise is not the same everywhere")
        first = _first(search, anew=True)
    moving = _elsewhere(search) or _beside_unknowns(search)
    if not moving:
        search.scatter, own = _moving(search) or search.scatter, search.scatter
        moving = search.scatter is not own
    if (
        moving and search.accepted
    ):  # what moves by chance also passes for laws: all is asked anew beside it
        search.say(f"{search.scatter.site.where} moves from sample to sample")
        search.level = CLAIMED  # how much it moves is only known nearly
        first = _first(search, anew=True)
    merge_joint_functions(search)
    names = probabilities_of_names(search)
    findings = tuple(with_hidden(search, finding(search, i, names)) for i in search.everyone)
    rest = family_wise(search.table(search.everyone))
    after = search.plain.keeping()
    outliers, data = of_data(after)
    if rest <= level or search.scatter:
        data = tuple(
            f for f in data if not search.scatter and f.p_value < rest
        )  # noise is judged where little is left
    if any(h.unnamed for h in search.accepted):
        outliers, data = _beyond_functions(search, after, outliers, data)
    if moving:
        data, places = _with_scatter(search, before, data, places)
        first = min(first, search.scatter.p_value)
    lattice = rounded_readings(after, level)
    rounded = {f.where for f in lattice}
    others = tuple(f for f in data if f.effect != "encoder-quantisation" or f.where not in rounded)
    data = (*lattice, *others)
    left = located(search.problem.keeping(), search.table(search.everyone))
    return Found(
        findings, before, after, first, rest, places, left, outliers, data, tuple(search.trail)
    )


def _beyond_functions(search: Search, after: Problem, outliers, data):
    """Outliers and findings on the data where functions without a name are accepted, which are only nearly right.

    What such a function leaves is not the same everywhere, and lies far off where it bends sharply: only outliers that
    hold more than what it may miss are outliers.
    """
    own = sum(search.beside(i)[0] for i in search.everyone if search.accepted[i].unnamed)
    data = tuple(
        f for f in data if f.effect == "outliers" and far_off(after, outliers) > (1 - LAW) * own
    )
    return outliers & bool(data), data


def _first(search: Search, anew: bool = False) -> float:
    """The chance that nothing is missing; where that is small, what is is searched for."""
    if anew:
        search.accepted = ()
        search.solve()
    first = family_wise(search.table(()), LAW_ERROR**2 * search.problem.given)
    if first <= search.level:
        _named(search)
    return first


def _moving(search: Search) -> Scatter | None:
    """The place that moves by chance, unless what is left has a law, though not a known one."""
    found = scattered(search.problem.keeping(), CLAIMED)
    if found is None or found.p_value > family_wise(search.table(search.everyone)):
        return None
    return found


def _with_scatter(search: Search, before: Problem, data, places):
    """Findings on the data and places with what moves by chance, unless a finding there says more of it."""
    if any(h.unnamed or tells(search, h) for h in search.accepted):
        return data, places
    place = (place_of(search.scatter),)
    return (told(search.scatter, before), *data), (*places, *place) if search.accepted else (
        *place,
        *places,
    )


def _elsewhere(search: Search) -> bool:
    """Whether movement by chance, at a place where no function without a name is, is likelier than all of these."""
    unknown = [h.where for h in search.accepted if h.unnamed]
    laws = tuple(i for i in search.everyone if not search.accepted[i].unnamed)
    bare, kept = search.problem.keeping(laws), search.problem.keeping()
    found = scattered(bare, CLAIMED) if unknown else None
    if found is None or any(near(found.site.where, where) for where in unknown):
        return False
    before, after = (float((p.clear(p.residual) ** 2).sum()) for p in (bare, kept))
    if found.gain < 0.5 * kept.degrees * np.log(before / after):
        return False
    search.scatter = found
    return True


def _beside_unknowns(search: Search) -> bool:
    """Laws asked again beside what a function without a name leaves at its own place, as it is only nearly right.

    Whether the function itself is not needed there: then there is no more than movement by chance.
    """
    unknown = [
        (search.beside(i)[0], h.source[0]) for i, h in enumerate(search.accepted) if h.unnamed
    ]
    if not unknown:
        return False
    site = max(unknown, key=lambda pair: pair[0])[1]
    search.scatter = beside(
        search.problem.keeping(), site.where, getattr(site, "port", "frame"), CLAIMED
    )
    if search.scatter is None:
        return False
    search.say(f"what is left at {site.where} is taken for the unknown's own")
    search.solve()
    _sure(search)
    if any(h.unnamed and h.where == site.where for h in search.accepted):
        _beaten(search)
        folded(search)
        return False
    search.scatter = None
    search.solve()
    search.scatter = scattered(search.problem.keeping(), CLAIMED)
    return search.scatter is not None


def _sure(search: Search):
    """Leave out, the least sure first, whatever is not beyond chance by itself, and what is less likely than nothing.

    The last one is only exchanged, for the likeliest that is beyond chance, where something is.
    """
    while len(search.accepted) > 1:
        p = [_alone(search, i) for i in search.everyone]
        if max(p) > search.level:
            search.without({int(np.argmax(p))}, _SMALL)
            continue
        odds = [search.own(i).log_weight for i in search.everyone]
        if min(odds) + SECOND >= 0:
            return
        search.without({int(np.argmin(odds))}, "nothing is likelier than it, beside the others")
    if search.accepted and _alone(search, 0) > search.level:
        clear = [
            h
            for h in search.table(())
            if h.p / h.weight <= search.level and (h.evidence > 0 or not h.unnamed)
        ]
        search.accepted = tuple(_with_effect(search.bench, h) for h in clear[:1])
        search.solve()


def _alone(search: Search, i: int) -> float:
    """p-value of an accepted hypothesis beside the others by itself, over the whole search."""
    return search.beside(i)[1] / search.accepted[i].weight


def _named(search: Search):
    _settle(search)
    _prune(search)
    _judged_again(search)
    best = outdone(search)
    if best is not None:
        search.say(
            f"{best.effect} at {best.where} {best.label} for all laws: it is likelier than what stays of them"
        )
        search.accepted = (_with_effect(search.bench, best),)
        search.solve()
        _judged_again(search)
    if exchange_elastic_terms(search):
        _sure(search)
        against(search)
    _ordered(search)


def _judged_again(search: Search):
    """What is still missing joins; whatever is not sure, beaten, a part of something else or against its load goes."""
    _grow(search)
    grown_by_prediction(search)
    _sure(search)
    _beaten(search)
    folded(search)
    against(search)


def _beaten(search: Search):
    """Whatever is likelier beside all others instead of a law; if without a name, by more than laws may miss.

    What is then left out itself, or yields against its load, has beaten nothing: what it took the place of stays.
    """
    failed: set[tuple] = set()
    for _ in range(_ROUNDS):
        slack, before = (1 - LAW) * search.explained(), search.accepted
        for i in search.everyone:
            own, best = search.own(i), _likelier(search, i, slack, failed)
            if best is not None:
                break
        else:
            return
        search.say(
            f"{best.effect} at {best.where} {best.label} for {own.effect} at {own.where}: it is likelier"
        )
        kept = [h for j, h in enumerate(search.accepted) if j != i and room(h, best)]
        search.accepted = (*kept, _with_effect(search.bench, best))
        search.solve()
        _prune(search)
        if not search.stands(best):
            search.say(
                f"{own.effect} at {own.where} {own.label}: stays, as that does not stand there"
            )
            search.accepted = before
            search.solve()
            failed.add((name_of(own), best.key))


def _likelier(search: Search, i: int, slack: float, failed: set[tuple]) -> Hypothesis | None:
    """What is likelier in the place of a law that is accepted, and at least as sure; None where nothing is.

    failed: names of laws with effect and place of what did not stand in their place.
    """
    own = search.own(i)
    if own.unnamed:
        return None
    rivals = [
        h
        for h in search.table(search.others(i))
        if h.log_weight > own.log_weight
        and h.p / h.weight <= search.level
        and h.gain > own.gain + (slack if h.unnamed else 0.0)
        and (name_of(own), h.key) not in failed
    ]
    return max(rivals, key=lambda h: h.log_weight, default=None)


def _confirmed(search: Search, samples) -> Found:
    """The search on every so many poses, which is as valid and quicker; what is left is judged on all."""
    whole, n = search.problem, search.problem.n
    _, label = np.unique(whole.pose, return_inverse=True)
    part = label % -(-n // _MANY) == 0
    if samples is not None:
        part = _within(samples, part)
    found = _found(replace(search, samples=part, problem=search.bench.problem((), part), tables={}))
    effects = [e for f in found.findings for e in f.effects]
    after = search.bench.problem(effects, samples).keeping()
    table = judged(after)
    outliers, spread = of_data(after)
    if any(
        f.effect == "unknown" for f in found.findings
    ):  # as the part has it, where laws and functions were judged
        spread = tuple(f for f in spread if f.effect in {own.effect for own in found.spread})
        outliers = outliers & any(f.effect == "outliers" for f in spread)
    return replace(
        found,
        before=whole,
        after=after,
        p_rest=family_wise(table),
        rest=located(after, table),
        outliers=outliers,
        spread=spread,
    )


def _within(samples: np.ndarray, part: np.ndarray) -> np.ndarray:
    """A part (k,) bool of the True ones of `samples` (n,), as (n,) bool."""
    out = np.zeros(len(samples), bool)
    out[np.flatnonzero(samples)[part]] = True
    return out


def _settle(search: Search):
    """The likeliest set and a solve with it, until the set stays as it is."""
    tried: list[set] = []
    for _ in range(_ROUNDS):
        bare = search.problem.keeping(())
        projected = Projected(bare)
        short, present = _shortlist(search)
        chosen = Sets.of(projected, bare, short).best(present)
        if {name_of(h) for h in chosen} in tried:
            break
        tried.append({name_of(h) for h in chosen})
        search.accepted = tuple(_with_effect(search.bench, h) for h in chosen)
        search.say("; ".join(f"{h.effect} at {h.where} {h.label}".strip() for h in chosen))
        search.solve()


def _shortlist(search: Search) -> tuple[list[Hypothesis], tuple[int, ...]]:
    """Hypotheses for the search of sets: likely alone, beside all, or in the place of one; and who is accepted."""
    alone = search.table(())
    pools = [(alone, _FIRST), (alone, -_UNNAMED)]
    if search.accepted:
        pools += [
            (search.table(search.everyone), _BESIDE),
            (search.table(search.everyone), -_UNNAMED),
        ]
    if len(search.accepted) <= _WIDE:
        pools += [(search.table(search.others(i)), _EACH) for i in search.everyone]
    own = {name_of(h) for h in search.accepted}
    mine = [h for h in alone if name_of(h) in own]
    chosen = {name_of(h): h for h in mine}
    for table, count in pools:
        rows = [h for h in table if bool(h.unnamed) == (count < 0)][: abs(count)]
        chosen |= {name_of(h): h for h in rows if name_of(h) not in chosen}
    return list(chosen.values()), tuple(range(len(mine)))


def _with_effect(bench, h: Hypothesis) -> Hypothesis:
    """An unknown gets an effect, too: the fitted function."""
    return replace(h, effects=(bench.smooth(*h.source),)) if h.unnamed and not h.effects else h


def _prune(search: Search):
    """Leave out, the least sure first, whatever beside the others is not beyond chance, or too small to be told."""
    while search.accepted:
        own = [search.beside(i) for i in search.everyone]
        p = [_chance(search, i, *mine) for i, mine in zip(search.everyone, own)]
        worst = int(np.argmax(p))
        if p[worst] <= search.level:
            gains = np.array([gain for gain, _ in own])
            least = max(_inexact(search), search.left())
            if len(gains) == 1 or gains.min() >= least:
                break
            search.without(search.too_small(gains, least), _SMALL)
            continue
        if len(search.accepted) == 1:
            break
        search.without({worst}, _SMALL)


def _chance(search: Search, i: int, gain: float, p: float) -> float:
    """p-value over the whole search that nothing is missing without an accepted hypothesis.

    Its own is an upper limit, so that only where that is above the level all others are looked at.
    """
    own = min(1.0, p / search.accepted[i].weight)
    return own if own <= search.level else family_wise(search.table(search.others(i)))


def _inexact(search: Search) -> float:
    """The least gain that is not the error of the elastic laws in the model themselves, which geometry makes."""
    elastic = any(effect.elastic for h in search.accepted for effect in h.effects)
    return LAW_ERROR**2 * (search.problem.given + elastic * search.explained())


def _grow(search: Search):
    """What is named and explains about as much as any function of what is left joins; it was beaten by what is gone."""
    for _ in range(_GROWN):
        left = search.left()
        table = search.table(search.everyone)
        named = [
            h
            for h in table
            if not h.unnamed and h.gain > LAW * left and h.p / h.weight <= search.level
        ]
        if not left or not named:
            break
        best = max(named, key=lambda h: h.log_weight)
        search.say(
            f"{best.effect} at {best.where} {best.label}: as good as any function of what is left"
        )
        search.accepted = (*search.accepted, best)
        search.solve()


def _ordered(search: Search):
    """What explains most first, then what explains most beside it, and so on."""
    left, kept = list(search.everyone), []
    if len(left) < 2:
        return
    bare = search.problem.keeping(())
    projected, columns = Projected(bare), search.problem.added
    while left:
        best = max(
            left, key=lambda i: projected.fall(np.concatenate([columns[j] for j in (*kept, i)], 1))
        )
        kept.append(best)
        left.remove(best)
    search.accepted = tuple(search.accepted[i] for i in kept)
    search.solve()


__all__ = ["LEVEL", "find"]
