"""The most probable set of terms: searched in the linearised problem, solved, searched again at the solution."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

from workbench.core.model import STATE_PORTS
from workbench.diagnosis.levels import (
    LEAST_LOG_ODDS,
    MAX_ROUNDS,
    NEGLIGIBLE_SHARE,
    NOTABLE_SHARE,
    SIGNIFICANT_SIGMAS,
)
from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.search.common_orders import harmonics_of_common_order
from workbench.diagnosis.search.instants import refine_instants
from workbench.diagnosis.search.objective import Accepted, LogPosterior, Members
from workbench.diagnosis.search.options import (
    refine_options,
    with_estimated_options,
    with_exact_options,
)
from workbench.diagnosis.search.prior import LAW_ERROR
from workbench.diagnosis.search.state import LAWS, Search, name_of
from workbench.diagnosis.search.stepwise import LAW, Stepwise

_FIRST, _MAX_SMOOTH, _VARIANTS = 48, 6, 4
"""Terms of the search: the most probable alone, half as many in addition, functions of each table, variants of one
effect at one place that read the same covariates. As many as of these are tried in the place of each accepted term,
where no more than `_MAX_SMOOTH` are accepted: more are exchanged in pairs."""


def accept_most_probable_set(search: Search, thorough: bool = True) -> None:
    """Replace what is accepted by the set with the highest posterior, in the order in which its terms explain most.

    thorough: what would stand in the place of each accepted term is searched, too. It takes a table for each of them,
    so that it is left for the noise as it is finally known, as are terms that add little.
    """
    tried: list[set] = []
    for _ in range(MAX_ROUNDS):
        terms, present, harmonic_numbers = _candidate_terms(search, thorough)
        remainder = search.problem.conditional_on()
        solved = as_solved(search, terms[: len(present)])
        objective = LogPosterior.of(search.problem.conditional_on(()), terms, remainder, solved)
        members = Stepwise(objective, harmonic_numbers).most_probable_set(present)
        if search.bench.bends_with_effects and not present:
            members = dominant_law(objective, members, len(remainder.sample))
        chosen = [terms[i] for i in members]
        names = {name_of(h) for h in chosen}
        if names in tried or _is_gain_below(NEGLIGIBLE_SHARE, objective, members, present):
            break
        is_last = _is_last(search, objective, members, present, thorough)
        tried.append(names)
        search.accepted = tuple(_with_effect(search.bench, h) for h in chosen)
        search.record_terms(chosen)
        search.solve_feasible()
        order_by_gain(search)
        is_first = len(tried) == 1 and not thorough
        refine_options(search, is_first=is_first, rounds=1)
        refine_instants(search)
        if is_last:
            break
    order_by_gain(search)


def dominant_law(objective: LogPosterior, members: Members, count: int) -> Members:
    """The best law of a set alone where it explains nearly all of a large misfit of `count` coordinates; else the set.

    The other terms then explain errors of its linearisation: they are searched again about the solution with the law.
    """
    total_gain = objective.gain(members)
    laws = [(i,) for i in members if not objective.is_smooth[i]]
    best = max(laws, key=objective.gain, default=members)
    is_large = total_gain > SIGNIFICANT_SIGMAS**2 * count
    if is_large and objective.gain(best) > LAW * total_gain:
        return best
    return members


def as_solved(search: Search, terms: Sequence[Hypothesis]) -> Accepted:
    """The accepted ones that come first among the terms of an objective; changes of load with the solution's columns.

    These hold for the compliances of the solution and do not stand in for them, see `linearised.solution`. A load that
    acts all the time is less distinguishable from compliances: it counts for what all of these together do not make.
    """
    numbers = {name_of(h): i for i, h in enumerate(search.accepted)}
    loads = {}
    for place, h in enumerate(terms):
        number = numbers.get(name_of(h))
        is_load = any(e.port in STATE_PORTS for e in h.effects)
        if number is not None and is_load and not isinstance(h.source, Candidate):
            loads[place] = search.problem.added[number] * h.source.typical
    return Accepted(len(terms), loads)


def loads_as_solved(search: Search, terms: Sequence[Hypothesis]) -> Accepted:
    """As `as_solved`, for sets that all hold the accepted loads: their columns are those of the solution.

    A load that competes with the accepted compliances counts for what these do not make (`as_solved`). What remains is
    no load in a set that lacks one of them, and would represent a part of the missing compliance: two sets could each
    seem more probable about the solution of the other.
    """
    solved = as_solved(search, terms)
    problem = search.problem.conditional_on(())
    constant = {
        i: h.columns(problem)
        for i, h in enumerate(terms)
        if h.needs_compliance and i not in solved.loads
    }
    return replace(solved, loads={**solved.loads, **constant})


def _is_gain_below(
    share: float, objective: LogPosterior, members: Members, present: Members
) -> bool:
    """Whether a set is more probable than the accepted one by less than a share of its log posterior odds over no term.

    Or by less than justifies another solution.
    """
    if not present:
        return False
    value = objective.value(members)
    return 0 <= value - objective.value(present) < max(LEAST_LOG_ODDS, share * value)


def _is_last(
    search: Search, objective: LogPosterior, members: Members, present: Members, thorough: bool
) -> bool:
    """Whether a set, once solved, is left as it is.

    Before the noise is known, what adds little is left for the search with it. In a fold predictions alone count: a
    set that changes the sum of squares by less than the laws are wrong predicts as well as the next one.
    """
    if not thorough:
        return _is_gain_below(NOTABLE_SHARE, objective, members, present)
    if not search.for_prediction or not present:
        return False
    gain = objective.value(members) - objective.value(present)
    return 0 <= 2 * gain < LAW_ERROR * objective.degrees


def _candidate_terms(search: Search, thorough: bool) -> tuple[list[Hypothesis], Members, Members]:
    """Terms to search: the accepted ones, whose numbers are given, and what is likely alone or in addition.

    Then the numbers of harmonics of one order at several joints, which may be significant only as a set. thorough: also
    the most probable in the place of each.
    """
    if not search.screened:
        first = _most_probable(search.full_table(()), _FIRST, _MAX_SMOOTH)
        search.screened = with_estimated_options(search, first, ())
    table = search.table(search.accepted_indices)
    harmonics = harmonics_of_common_order(search.problem.conditional_on(), table, search.accepted)
    pools = [search.screened, harmonics]
    if search.accepted:
        additions = _most_probable(table, _FIRST // 2, _MAX_SMOOTH)
        pools.append(with_estimated_options(search, additions, search.accepted_indices))
    if thorough and len(search.accepted) <= _MAX_SMOOTH:
        for others in map(search.other_indices, search.accepted_indices):
            replacements = _most_probable(search.table(others, LAWS), _VARIANTS, 0)
            pools.append(with_estimated_options(search, replacements, others))
    chosen = {name_of(h): h for h in _at_current_solution(search, search.accepted)}
    present = tuple(range(len(chosen)))
    for pool in pools:
        possible = [h for h in pool if name_of(h) not in search.infeasible]
        for h in _at_current_solution(search, possible):
            chosen.setdefault(name_of(h), h)
    names = {name_of(h) for h in harmonics}
    harmonic_numbers = tuple(i for i, name in enumerate(chosen) if name in names)
    return list(chosen.values()), present, harmonic_numbers


def _at_current_solution(search: Search, terms: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The terms with their columns at the present solution."""
    terms = list(terms)
    problem = with_exact_options(search.problem, terms)
    return [h for h in (term.at(problem) for term in terms) if h is not None]


def _most_probable(table: list[Hypothesis], law_count: int, smooth_count: int) -> list[Hypothesis]:
    """The first so many laws and functions of a table."""
    terms = [h for h in table if not h.smooth_covariates]
    laws = _limit_variants(terms, law_count)
    return [*laws, *[h for h in table if h.smooth_covariates][:smooth_count]]


def _limit_variants(terms: list[Hypothesis], count: int) -> list[Hypothesis]:
    """The first so many terms with at most `_VARIANTS` variants of one effect at one place that read the same.

    A step at each of a dozen neighbouring instants would leave no room for other effects; a backlash that gravity seats
    in several ways, none for one that the side of approach seats.
    """
    seen: Counter = Counter()
    out = []
    for h in terms:
        variant = (h.key, frozenset(h.reads))
        seen[variant] += 1
        if seen[variant] <= _VARIANTS:
            out.append(h)
        if len(out) == count:
            break
    return out


def _with_effect(bench, h: Hypothesis) -> Hypothesis:
    """A smooth nonparametric alternative gets an effect, too: itself, fitted."""
    if h.smooth_covariates and not h.effects:
        effects = (bench.smooth(h.source, h.value),)
        return replace(h, effects=effects)
    return h


def order_by_gain(search: Search) -> None:
    """Terms by conditional gain: each explains most of the residual given those before it."""
    if len(search.accepted) < 2:
        return
    added = search.problem.added_effects
    search.reorder(added.order_by_gain(lambda remaining: _allowed_next(search, remaining)))


def _allowed_next(search: Search, remaining: list[int]) -> list[int]:
    """Those left that may come next: what needs a compliance follows all compliances."""
    accepted = search.accepted
    if not any(accepted[i].carries_load for i in remaining):
        return remaining
    return [i for i in remaining if not accepted[i].needs_compliance]
