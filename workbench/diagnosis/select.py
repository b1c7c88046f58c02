"""Which effects are missing: sets searched in the linearised problem, solved non-linearly, each then questioned."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from workbench.diagnosis.data import CLAIMED, of_data
from workbench.diagnosis.evidence import Projected
from workbench.diagnosis.hypotheses import Hypothesis, family_wise, judged
from workbench.diagnosis.locate import located
from workbench.diagnosis.problem import Alternative, Bench, Finding, Found, Problem
from workbench.diagnosis.scatter import Scatter, evened_by, place_of, scattered, told
from workbench.diagnosis.sets import LAW, Sets

LEVEL = 0.01
"""Chance that a recording with nothing missing is said to miss something."""
_ROUNDS, _GROWN, _WIDE = 3, 3, 6
_MANY = 1200  # samples beyond which a search takes only every so many poses
_FIRST, _BESIDE, _EACH, _UNNAMED = 48, 24, 4, 6  # hypotheses taken from each table into the search of sets
_CREDIBLE = 0.95
LAW_ERROR = 0.015
"""Share of an elastic law's effect that it may be wrong by: angles by tenths of a degree, lengths by a millimetre."""
_YIELDS = ("link-compliance", "bearing-compliance", "pedestal-compliance")
ELASTIC = ("joint-compliance", *_YIELDS)
_NEAR = 6.0  # variances of noise: a difference that chance makes once in seventy times
_PRIORS = 30.0  # typical sizes: ten times a prior of three


@dataclass
class _Search:
    """A search under way: what is accepted, its problem, and a line for each step."""

    bench: Bench
    samples: np.ndarray | None
    level: float
    progress: Callable[[str], None]
    accepted: tuple[Hypothesis, ...] = ()
    trail: list[str] = field(default_factory=list)
    problem: Problem | None = None
    tables: dict = field(default_factory=dict)
    scatter: Scatter | None = None

    def say(self, line: str):
        self.trail.append(line)
        self.progress(line)

    def solve(self):
        """Everything solved with what is accepted; tables of before are void."""
        effects = [e for h in self.accepted for e in h.effects]
        problem = self.bench.problem(effects, self.samples)
        self.problem, self.tables = problem if self.scatter is None else evened_by(problem, self.scatter), {}

    def table(self, kept: tuple[int, ...]) -> list[Hypothesis]:
        """Everything judged beside those accepted whose numbers are kept."""
        if kept not in self.tables:
            wanted = [(h.family, h.label) for h in self.accepted]
            self.tables[kept] = judged(self.problem.keeping(kept), wanted=wanted)
        return self.tables[kept]

    @property
    def everyone(self) -> tuple[int, ...]:
        return tuple(range(len(self.accepted)))

    def others(self, i: int) -> tuple[int, ...]:
        return tuple(j for j in self.everyone if j != i)


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
    search = _Search(bench, samples, level, progress)
    search.solve()
    if search.problem.n > _MANY and not getattr(bench, "whole", False):
        return _confirmed(search, samples)
    found = _found(search)
    return bench.reviewed(found, samples) if hasattr(bench, "reviewed") else found


def _found(search: _Search) -> Found:
    """Set found, pruned and questioned on the search's samples."""
    level = search.level
    before, table = search.problem, search.table(())
    first, places = family_wise(table, LAW_ERROR**2 * before.given), located(before, table)
    if first <= level:
        _named(search)
    search.scatter = scattered(search.problem.keeping(), CLAIMED)
    if search.scatter and search.scatter.p_value > family_wise(search.table(search.everyone)):
        search.scatter = None  # what is left has a law, though not a known one
    if search.scatter and search.accepted:  # what moves by chance also passes for laws: all is asked anew beside it
        before, first = _anew(search)
    findings = tuple(_finding(search, i) for i in search.everyone)
    after, table = search.problem.keeping(), search.table(search.everyone)
    outliers, data = of_data(after)
    if family_wise(table) <= level or search.scatter or any(h.unnamed for h in search.accepted):
        data = ()  # noise is judged where nothing else is left to judge
    if search.scatter:
        data, places = _with_scatter(search, before, data, places)
        first = min(first, search.scatter.p_value)
    return Found(findings, before, after, first, family_wise(table), places, located(after, table), outliers, data,
                 tuple(search.trail))  # fmt: skip


def _with_scatter(search: _Search, before: Problem, data, places):
    """Findings on the data and places with what moves by chance, unless an unknown there says more of it."""
    at = search.scatter.site.where
    if any(h.unnamed and h.where == at for h in search.accepted):
        return data, places
    place = (place_of(search.scatter),)
    return (told(search.scatter, before), *data), (*places, *place) if search.accepted else (*place, *places)


def _anew(search: _Search) -> tuple[Problem, float]:
    """The search beside a place that moves by chance; the baseline's problem and what is missing in it beside that."""
    search.say(f"{search.scatter.site.where} moves from sample to sample")
    search.accepted = ()
    search.solve()
    before = search.problem
    first = family_wise(search.table(()), LAW_ERROR**2 * before.given)
    if first <= search.level:
        _named(search)
    return before, first


def _named(search: _Search):
    _settle(search)
    _prune(search)
    _usual(search)
    _grow(search)
    _ordered(search)


def _confirmed(search: _Search, samples) -> Found:
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
    return replace(found, before=whole, after=after, p_rest=family_wise(table), rest=located(after, table),
                   outliers=outliers, spread=spread)  # fmt: skip


def _within(samples: np.ndarray, part: np.ndarray) -> np.ndarray:
    """A part (k,) bool of the True ones of `samples` (n,), as (n,) bool."""
    out = np.zeros(len(samples), bool)
    out[np.flatnonzero(samples)[part]] = True
    return out


def _settle(search: _Search):
    """The likeliest set and a solve with it, until the set stays as it is."""
    tried: list[set] = []
    for _ in range(_ROUNDS):
        bare = search.problem.keeping(())
        projected = Projected(bare)
        short, present = _shortlist(search)
        chosen = Sets.of(projected, bare, short).best(present)
        if {_name(h) for h in chosen} in tried:
            break
        tried.append({_name(h) for h in chosen})
        search.accepted = tuple(_with_effect(search.bench, h) for h in chosen)
        search.say("; ".join(f"{h.effect} at {h.where} {h.label}".strip() for h in chosen))
        search.solve()


def _shortlist(search: _Search) -> tuple[list[Hypothesis], tuple[int, ...]]:
    """Hypotheses for the search of sets: likely alone, beside all, or in the place of one; and who is accepted."""
    alone = search.table(())
    pools = [(alone, _FIRST), (alone, -_UNNAMED)]
    if search.accepted:
        pools += [(search.table(search.everyone), _BESIDE), (search.table(search.everyone), -_UNNAMED)]
    if len(search.accepted) <= _WIDE:
        pools += [(search.table(search.others(i)), _EACH) for i in search.everyone]
    own = {_name(h) for h in search.accepted}
    mine = [h for h in alone if _name(h) in own]
    chosen = {_name(h): h for h in mine}
    for table, count in pools:
        rows = [h for h in table if bool(h.unnamed) == (count < 0)][: abs(count)]
        chosen |= {_name(h): h for h in rows if _name(h) not in chosen}
    return list(chosen.values()), tuple(range(len(mine)))


def _name(h: Hypothesis):
    return (*h.key, h.label)


def _with_effect(bench, h: Hypothesis) -> Hypothesis:
    """An unknown gets an effect, too: the fitted function."""
    return replace(h, effects=(bench.smooth(*h.source),)) if h.unnamed and not h.effects else h


def _prune(search: _Search):
    """Leave out, the least sure first, whatever beside the others is not beyond chance, or too small to be told."""
    while search.accepted:
        tables = [search.table(search.others(i)) for i in search.everyone]
        p = [family_wise(table) for table in tables]
        worst = int(np.argmax(p))
        if p[worst] <= search.level:
            gains = np.array([_own(search, i, table).gain for i, table in zip(search.everyone, tables)])
            worst, least = int(np.argmin(gains)), max(_told_from(search), _left(search))
            if len(gains) == 1 or gains[worst] >= least:
                break
            _without(search, {worst, *np.flatnonzero(gains < least / 2)[: len(gains) - 1]})
            continue
        if len(search.accepted) == 1:
            break
        _without(search, {worst})


def _without(search: _Search, gone: set[int]):
    for i in gone:
        one = search.accepted[i]
        search.say(f"{one.effect} at {one.where} {one.label}: not beyond chance, or too small, beside the others")
    search.accepted = tuple(h for i, h in enumerate(search.accepted) if i not in gone)
    search.solve()


def _told_from(search: _Search) -> float:
    """The least gain that is not the error of the elastic laws in the model themselves, which geometry makes."""
    elastic = any(effect.elastic for h in search.accepted for effect in h.effects)
    return LAW_ERROR**2 * (search.problem.given + elastic * _explained(search))


def _left(search: _Search) -> float:
    """Gain of the best function of what is left, where that is beyond chance: what is less than it is not told."""
    table = search.table(search.everyone)
    if family_wise(table) > search.level:
        return 0.0
    return max((h.gain for h in table if h.unnamed and h.p / h.weight <= search.level), default=0.0)


def _usual(search: _Search):
    """A joint that yields instead of anything else that does, where what is left weighs more than their difference.

    Gears yield more than links and bearings, and what is not explained yet could turn the balance either way.
    """
    for i in search.everyone:
        mine, left = search.accepted[i], _left(search)
        if not left or mine.effect not in _YIELDS:
            continue
        table = search.table(search.others(i))
        least = _own(search, i, table).gain - left
        joints = [h for h in table if h.effect == "joint-compliance" and h.gain > least]
        if joints:
            other = max(joints, key=lambda h: h.gain)
            places = f"{other.effect} at {other.where} for {mine.effect} at {mine.where}"
            search.say(f"{places}: about as good, and more usual")
            search.accepted = (*search.accepted[:i], other, *search.accepted[i + 1 :])
            search.solve()


def _grow(search: _Search):
    """What is named and explains about as much as any function of what is left joins; it was beaten by what is gone."""
    for _ in range(_GROWN):
        left = _left(search)
        table = search.table(search.everyone)
        named = [h for h in table if not h.unnamed and h.gain > LAW * left and h.p / h.weight <= search.level]
        if not left or not named:
            break
        best = max(named, key=lambda h: h.log_weight)
        search.say(f"{best.effect} at {best.where} {best.label}: as good as any function of what is left")
        search.accepted = (*search.accepted, best)
        search.solve()


def _ordered(search: _Search):
    """What explains most first, then what explains most beside it, and so on."""
    left, kept = list(search.everyone), []
    if len(left) < 2:
        return
    bare = search.problem.keeping(())
    projected, columns = Projected(bare), search.problem.added
    while left:
        best = max(left, key=lambda i: projected.fall(np.concatenate([columns[j] for j in (*kept, i)], 1)))
        kept.append(best)
        left.remove(best)
    search.accepted = tuple(search.accepted[i] for i in kept)
    search.solve()


def _own(search: _Search, i: int, table) -> Hypothesis:
    """The accepted hypothesis as the table beside the others judges it."""
    mine = search.accepted[i]
    return next((h for h in table if _name(h) == _name(mine)), table[0])


def _finding(search: _Search, i: int) -> Finding:
    """The finding with its posterior among all that might stand in its place beside the others."""
    table, mine = search.table(search.others(i)), search.accepted[i]
    own = _own(search, i, table)
    slack = (1 - LAW) * _explained(search)
    rivals = [h for h in table if own.unnamed or not h.unnamed or h.gain > own.gain + slack]
    total = logsumexp([h.log_weight for h in rivals])
    shares: dict[tuple, float] = {}
    for h in rivals:
        shares[h.key] = shares.get(h.key, 0.0) + float(np.exp(h.log_weight - total))
    size = float(np.sqrt(own.gain / len(search.problem.sample)))
    return Finding(
        *mine.key, mine.label, mine.effects, max(family_wise(table), 1e-300), shares.get(mine.key, 0.0), size,
        own.gain, mine.unnamed, _alternatives(rivals, shares, own, _left(search), _NEAR * _variance(search)),
    )  # fmt: skip


def _variance(search: _Search) -> float:
    """Variance of a whitened coordinate that is left."""
    kept = search.problem.keeping()
    return float((kept.clear(kept.residual) ** 2).sum()) / max(kept.degrees, 1)


def _alarms(search: _Search, i: int) -> tuple[str, ...]:
    """What is not plausible about the fitted sizes of a finding."""
    source = search.accepted[i].source
    if isinstance(source, tuple):
        return ()
    values = search.problem.values[i]
    negative = source.positive and (values < 0).any()
    large = (np.abs(values) > _PRIORS * source.typical).any()
    said = ((negative, "it is negative, which nothing that yields can be"),
            (large, "it is more than ten times what such an effect is expected to be at most"))  # fmt: skip
    return tuple(words for true, words in said if true)


def _explained(search: _Search) -> float:
    """Fall of the sum of squares by all that is accepted: known laws are wrong by a share of it."""
    kept, bare = search.problem.keeping(), search.problem.keeping(())
    return float((bare.clear(bare.residual) ** 2).sum() - (kept.clear(kept.residual) ** 2).sum())


def _alternatives(table, shares, own, left: float, noise: float) -> tuple[Alternative, ...]:
    """What else is in the 95 % credible set, or so near in what it explains that what is left could tip the balance.

    And what yields in another place and explains as much but for chance: only its prior speaks against it.
    """
    ranked, covered, out = sorted(shares.items(), key=lambda item: -item[1]), 0.0, []
    for key, share in ranked:
        other = max((h for h in table if h.key == key), key=lambda h: h.log_weight)
        twin = other.effect in ELASTIC and own.effect in ELASTIC and other.gain > own.gain - noise
        near = left > 0 and not other.unnamed and other.gain > own.gain - left and other.rank <= own.rank
        near = near or twin
        if key != own.key and (covered < _CREDIBLE or near):
            alike = min(1.0, other.gain / max(own.gain, 1e-300))
            why = f"it makes {100 * alike:.0f} % of the same signature in these poses"
            out.append(Alternative(*key, other.label, share, alike, why, other.missing))
        covered += share
    return tuple(out)


__all__ = ["LEVEL", "find"]
