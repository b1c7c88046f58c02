"""Unmodelled effects of a baseline: the most probable set of terms, searched together with the noise.

In this order: is anything missing at all (a family-wise test); the likeliest set of terms (`search`); the same where
the noise turns out to depend on a covariate, or a place to have a random effect; then findings with their
probabilities. What the set is worth is not judged here but by nested cross-validation (`proof`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.levels import RANDOM_EFFECT_LEVEL, UNMODELLED_LEVEL
from workbench.diagnosis.linear.hypotheses import (
    Hypothesis,
    family_wise,
    located,
    ranked_hypotheses,
)
from workbench.diagnosis.linear.problem import Bench, Finding, Found, Problem
from workbench.diagnosis.noise.data_findings import (
    find_data_faults,
    relative_noise,
    unweighted_squares,
)
from workbench.diagnosis.noise.random_effects import (
    RandomEffect,
    find_random_effect,
    is_rounding,
    place_of,
    random_effect_finding,
)
from workbench.diagnosis.noise.rounded_readings import rounded_readings
from workbench.diagnosis.search.compatible import is_neighbour
from workbench.diagnosis.search.findings import (
    bare_finding,
    explains_movement,
    finding,
    with_special_cases,
    with_unrecorded_covariates,
)
from workbench.diagnosis.search.most_probable_set import accept_most_probable_set
from workbench.diagnosis.search.posterior import effect_posteriors, exchange_terms
from workbench.diagnosis.search.prior import LAW_ERROR
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.search.stepwise import LAW
from workbench.diagnosis.validation.folds import MAX_TESTED_SAMPLES, thinned

_MANY = 1200  # samples beyond which a search takes only every so many poses


def find(
    bench: Bench,
    samples: np.ndarray | None = None,
    *,
    progress: Callable[[str], None] = lambda text: None,
    first: Callable[[Sequence[Hypothesis]], None] = lambda terms: None,
) -> Found:
    """Unmodelled effects of the baseline of a bench, on `samples` (n,) bool (None: all).

    first: called with the first set of terms, long before the
    search ends. Raises what the bench's solve raises.
    """
    search = Search(bench, samples, UNMODELLED_LEVEL, progress, first=first)
    count = len(bench.pose) if samples is None else int(samples.sum())
    if count > _MANY and not bench.needs_all_samples:
        return _search_on_subset(search, samples)
    search.solve()
    return bench.reviewed(_found(search), samples)


def found_terms(bench: Bench, samples: np.ndarray | None = None) -> list[Finding]:
    """The terms of `find` alone, without probabilities, alternatives and noise: what a fold of a proof asks for."""
    search = Search(bench, samples, UNMODELLED_LEVEL, lambda text: None, for_prediction=True)
    search.solve()
    _accept_terms(search)
    exchange_terms(search)
    return with_special_cases([bare_finding(h) for h in search.accepted])


def _accept_terms(search: Search) -> tuple[float, bool]:
    """Accept the likeliest set with the noise of the samples; the p-value of no term, and whether a place moves."""
    first = _test_and_search(search, thorough=False)
    search.noise_factors = relative_noise(search.problem.conditional_on())
    if search.noise_factors is not None:
        # noise that grows with a covariate passes for a function of it
        search.log_step("the noise is not the same everywhere")
        first = _repeat_search(search)
    elif search.accepted:
        accept_most_probable_set(search)
    moving = _prefer_random_effect(search)
    if not moving:
        search.random_effect = _significant_random_effect(search)
        moving = search.random_effect is not None
    if moving and is_rounding(search.random_effect.site):
        search.log_step("the readings are rounded")
        first = _repeat_search(search)
    elif moving and search.accepted:  # movement by chance also passes for laws
        search.log_step(f"{search.random_effect.site.where} moves from sample to sample")
        search.level = RANDOM_EFFECT_LEVEL  # how much it moves is only known nearly
        first = _repeat_search(search)
    return first, moving


def _found(search: Search) -> Found:
    """The likeliest set on the search's samples, as findings with their probabilities, and the noise."""
    level, before = search.level, search.stated_noise_problem
    places = located(search.problem, search.table(()))
    first, moving = _accept_terms(search)
    exchange_terms(search)
    names = effect_posteriors(search)
    findings_of_terms = [
        with_unrecorded_covariates(search, finding(search, i, names))
        for i in search.accepted_indices
    ]
    findings = tuple(with_special_cases(findings_of_terms))
    remainder = family_wise(search.table(search.accepted_indices))
    after = search.converged().conditional_on()
    outliers, data = find_data_faults(after, [e for h in search.accepted for e in h.effects])
    if search.random_effect:
        data = ()
    elif remainder <= level:  # noise is judged where little is left
        data = tuple(f for f in data if f.p_value < remainder)
    if any(h.smooth_covariates for h in search.accepted):
        outliers, data = _data_findings_with_functions(search, after, outliers, data)
    if moving:
        data, places = _with_random_effect(search, before, data, places)
        first = min(first, search.random_effect.p_value)
    data = (*_rounded(search, after), *data)
    remainder_places = located(
        search.problem.conditional_on(), search.table(search.accepted_indices)
    )
    return Found(
        findings,
        before,
        after,
        first,
        remainder,
        places,
        remainder_places,
        outliers,
        data,
        tuple(search.history),
    )


def _rounded(search: Search, after: Problem) -> tuple[Finding, ...]:
    """Findings of the rounding of readings, where it makes what moves from sample to sample."""
    moves = search.random_effect or find_random_effect(after, RANDOM_EFFECT_LEVEL)
    if moves is None or not is_rounding(moves.site):
        return ()
    return rounded_readings(after, moves.p_value)


def _data_findings_with_functions(search: Search, after: Problem, outliers, data):
    """Outliers and findings on the data where smooth nonparametric functions are accepted, which are only nearly right.

    What such a function leaves is not the same everywhere, and lies far off where it bends sharply: only outliers that
    hold more than what it may miss are outliers.
    """
    gain_of_functions = sum(
        search.conditional_gain(i)[0]
        for i in search.accepted_indices
        if search.accepted[i].smooth_covariates
    )
    data = tuple(
        f
        for f in data
        if f.effect == "outliers"
        and unweighted_squares(after, outliers) > (1 - LAW) * gain_of_functions
    )
    return outliers & bool(data), data


def _repeat_search(search: Search) -> float:
    """As `_test_and_search`, with the noise as it is known by now: from the set that is accepted."""
    search.solve()
    return _test_and_search(search)


def _test_and_search(search: Search, thorough: bool = True) -> float:
    """The chance that nothing is missing; where it is small, the likeliest set of terms is accepted."""
    first = family_wise(search.table(()), LAW_ERROR**2 * search.problem.given)
    if first <= search.level:
        accept_most_probable_set(search, thorough)
    elif search.accepted:
        search.accepted = ()
        search.solve()
    return first


def _significant_random_effect(search: Search) -> RandomEffect | None:
    """The place with a random effect, unless what is left has a law, though not a known one."""
    found = find_random_effect(search.problem.conditional_on(), RANDOM_EFFECT_LEVEL)
    if found is None or found.p_value > family_wise(search.table(search.accepted_indices)):
        return None
    return found


def _with_random_effect(search: Search, before: Problem, data, places):
    """Findings on the data and places with a random effect, unless a finding there says more of it."""
    is_known = is_rounding(search.random_effect.site)
    if is_known or any(
        h.smooth_covariates or explains_movement(search, h) for h in search.accepted
    ):
        return data, places
    place = (place_of(search.random_effect),)
    found = random_effect_finding(search.random_effect, before)
    return (found, *data), places + place if search.accepted else place + places


def _prefer_random_effect(search: Search) -> bool:
    """Whether a random effect, at a place without a smooth alternative, is likelier than all of these."""
    unknown = [h.where for h in search.accepted if h.smooth_covariates]
    laws = tuple(i for i in search.accepted_indices if not search.accepted[i].smooth_covariates)
    bare, full = search.problem.conditional_on(laws), search.problem.conditional_on()
    found = find_random_effect(bare, RANDOM_EFFECT_LEVEL) if unknown else None
    if found is None or any(is_neighbour(found.site.where, where) for where in unknown):
        return False
    before, after = (float((p.orthogonalise(p.residual) ** 2).sum()) for p in (bare, full))
    if found.gain < 0.5 * full.degrees * np.log(before / after):
        return False
    search.random_effect = found
    return True


def _search_on_subset(search: Search, samples) -> Found:
    """The search on every so many poses, which is as valid and quicker; what is left is judged on more of them."""
    bench = search.bench
    before = bench.problem((), samples, hypotheses=False)
    used = np.ones(len(bench.pose), bool) if samples is None else samples
    _, label = np.unique(before.pose, return_inverse=True)
    search.samples = used.copy()
    search.samples[used] = label % -(-before.n // _MANY) == 0
    search.solve()
    found = _found(search)
    effects = [e for f in found.findings for e in f.effects]
    bench.solve(effects, samples)
    after = bench.problem(effects, samples, hypotheses=False).conditional_on()
    remainder = bench.problem(
        effects, thinned(bench.pose, used, MAX_TESTED_SAMPLES)
    ).conditional_on()
    table = ranked_hypotheses(remainder)
    outliers, spread = find_data_faults(after, effects)
    # where functions are accepted, as the part has it, on which laws and functions were judged
    if any(f.effect == "unknown" for f in found.findings):
        spread = tuple(
            f
            for f in spread
            if f.effect in {noise_finding.effect for noise_finding in found.noise_findings}
        )
        outliers = outliers & any(f.effect == "outliers" for f in spread)
    return replace(
        found,
        before=before,
        after=after,
        p_remainder=family_wise(table),
        remainder=located(remainder, table),
        outliers=outliers,
        noise_findings=spread,
    )
