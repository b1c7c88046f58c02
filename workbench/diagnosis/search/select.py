"""Unmodelled effects of a baseline: the most probable set of terms, searched together with the noise.

In this order: a family-wise test of whether the residual has any structure; the most probable set of terms; the same
again where the noise depends on a covariate or a place has a random effect; findings with their probabilities. Nested
cross-validation (`validation.proof`) decides afterwards which of them are retained.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.levels import RANDOM_EFFECT_LEVEL, RARE_PRIOR, UNMODELLED_LEVEL
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
from workbench.diagnosis.noise.random_effect_findings import place_of, random_effect_finding
from workbench.diagnosis.noise.random_effects import (
    RandomEffect,
    find_random_effect,
    is_rounding,
    known_rounding,
)
from workbench.diagnosis.noise.rounded_readings import rounded_readings
from workbench.diagnosis.search.common_orders import common_order_p_value
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

_MAX_SEARCHED_SAMPLES = (
    1200  # samples beyond which the search uses only every second, third, ... pose
)


def find(
    bench: Bench,
    samples: np.ndarray | None = None,
    *,
    progress: Callable[[str], None] = lambda text: None,
    first: Callable[[Sequence[Hypothesis]], None] = lambda terms: None,
) -> Found:
    """Unmodelled effects of the baseline of a bench, on `samples` (n,) bool (None: all).

    first: called with the first set of terms, long before the search ends. Raises InputError where the bench cannot
    solve the baseline.
    """
    search = Search(bench, samples, UNMODELLED_LEVEL, progress, first=first)
    if samples is None:
        count = len(bench.pose)
    else:
        count = int(samples.sum())
    if count > _MAX_SEARCHED_SAMPLES and not bench.needs_all_samples:
        return _search_on_subset(search, samples)
    search.solve()
    return bench.reviewed(_found(search), samples)


def found_terms(bench: Bench, samples: np.ndarray | None = None) -> list[Finding]:
    """The terms of `find` without probabilities, alternatives and findings on the noise, as a fold needs them."""
    search = Search(bench, samples, UNMODELLED_LEVEL, lambda text: None, for_prediction=True)
    search.solve()
    _accept_terms(search)
    exchange_terms(search)
    return with_special_cases([bare_finding(h) for h in search.accepted])


def _accept_terms(search: Search) -> tuple[float, bool]:
    """Accept the most probable set of terms together with the noise model.

    Returns the p-value of a residual without structure, and whether a place has a random effect.
    """
    if _accept_known_rounding(search):
        search.solve()
    p_no_structure = _test_and_search(search, thorough=False)
    if search.accepted and _accept_known_rounding(search):
        p_no_structure = _repeat_search(search)
    search.noise_factors = relative_noise(search.problem.conditional_on())
    if search.noise_factors is not None:
        # noise that grows with a covariate is mistaken for a function of it
        search.log_step("the noise is not the same everywhere")
        p_no_structure = _repeat_search(search)
    elif search.accepted:
        accept_most_probable_set(search)
    if search.random_effect is not None:
        return p_no_structure, True
    has_random_effect = _prefer_random_effect(search)
    if not has_random_effect:
        search.random_effect = _significant_random_effect(search)
        has_random_effect = search.random_effect is not None
    if has_random_effect and is_rounding(search.random_effect.site):
        search.log_step("the readings are rounded")
        p_no_structure = _repeat_search(search)
    elif has_random_effect and search.accepted:  # random displacements are also mistaken for laws
        search.log_step(f"{search.random_effect.site.where} moves from sample to sample")
        search.level = (
            RANDOM_EFFECT_LEVEL  # the size of a random effect is only known approximately
        )
        p_no_structure = _repeat_search(search)
    return p_no_structure, has_random_effect


def _accept_known_rounding(search: Search) -> bool:
    """Whether the rounding errors of the readings join the noise, next to the laws that are accepted.

    A smooth function may follow some of these errors.
    """
    if search.random_effect is not None:
        return False
    laws = [i for i in search.accepted_indices if not search.accepted[i].smooth_covariates]
    problem = search.problem.conditional_on(laws)
    search.random_effect = known_rounding(problem, UNMODELLED_LEVEL)
    if search.random_effect is None:
        return False
    search.log_step("the readings are rounded")
    return True


def _found(search: Search) -> Found:
    """The most probable set on the search's samples, as findings with their probabilities, and the noise."""
    level, before = search.level, search.stated_noise_problem
    places = located(search.problem, search.table(()))
    p_no_structure, has_random_effect = _accept_terms(search)
    exchange_terms(search)
    names = effect_posteriors(search)
    findings_of_terms = [
        with_unrecorded_covariates(search, finding(search, i, names))
        for i in search.accepted_indices
    ]
    findings = tuple(with_special_cases(findings_of_terms))
    remaining = search.table(search.accepted_indices)
    p_remainder = family_wise(remaining)
    after = search.converged().conditional_on()
    effects = [e for h in search.accepted for e in h.effects]
    outliers, data = find_data_faults(after, effects)
    if search.random_effect:
        data = ()
    elif p_remainder <= level:  # the noise can be judged only where little structure remains
        data = tuple(f for f in data if f.p_value < p_remainder)
    if any(h.smooth_covariates for h in search.accepted):
        outliers, data = _data_findings_with_functions(search, after, outliers, data)
    if has_random_effect:
        data, places = _with_random_effect(search, before, data, places)
        p_no_structure = min(p_no_structure, search.random_effect.p_value)
    data = (*_rounded(search, after), *data)
    return Found(
        findings=findings,
        before=before,
        after=after,
        p_first=p_no_structure,
        p_remainder=p_remainder,
        located=places,
        remainder=located(search.problem.conditional_on(), remaining),
        outliers=outliers,
        noise_findings=data,
        history=tuple(search.history),
    )


def _rounded(search: Search, after: Problem) -> tuple[Finding, ...]:
    """Findings of rounded readings, where rounding is the random effect."""
    effect = search.random_effect or find_random_effect(after, RANDOM_EFFECT_LEVEL)
    if effect is None or not is_rounding(effect.site):
        return ()
    return rounded_readings(after, effect.p_value)


def _data_findings_with_functions(search: Search, after: Problem, outliers, data):
    """Outliers and findings on the data where smooth nonparametric functions are accepted, which are approximations.

    The residual of such a function varies from place to place and is large where its curvature is large. Outliers are
    therefore reported only if their sum of squares exceeds the share of the function that may be wrong.
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
    """As `_test_and_search`, with the present noise model, from the set that is accepted."""
    search.solve()
    return _test_and_search(search)


def _test_and_search(search: Search, thorough: bool = True) -> float:
    """The p-value of a residual without structure; where it is small, the most probable set of terms is accepted.

    Harmonics of one order at several joints, of which none may be significant by itself, spend a tenth of the level.
    """
    p_no_structure = family_wise(search.table(()), LAW_ERROR**2 * search.problem.given)
    if p_no_structure > search.level:
        p_of_harmonics = common_order_p_value(search.problem.conditional_on(()))
        p_no_structure = min(p_no_structure, p_of_harmonics / RARE_PRIOR)
    if p_no_structure <= search.level:
        accept_most_probable_set(search, thorough)
    elif search.accepted:
        search.accepted = ()
        search.solve()
    return p_no_structure


def _significant_random_effect(search: Search) -> RandomEffect | None:
    """The place with a random effect, unless a law or a smooth function explains the residual more significantly."""
    found = find_random_effect(search.problem.conditional_on(), RANDOM_EFFECT_LEVEL)
    if found is None or found.p_value > family_wise(search.table(search.accepted_indices)):
        return None
    return found


def _with_random_effect(search: Search, before: Problem, data, places):
    """Findings on the data and places, with the random effect unless an accepted term already explains it."""
    is_known = is_rounding(search.random_effect.site)
    if is_known or any(
        h.smooth_covariates or explains_movement(search, h) for h in search.accepted
    ):
        return data, places
    place = (place_of(search.random_effect),)
    found = random_effect_finding(search.random_effect, before)
    return (found, *data), places + place if search.accepted else place + places


def _prefer_random_effect(search: Search) -> bool:
    """Whether a random effect, at a place without a smooth alternative, is more probable than all of these."""
    unknown = [h.where for h in search.accepted if h.smooth_covariates]
    laws = tuple(i for i in search.accepted_indices if not search.accepted[i].smooth_covariates)
    bare = search.problem.conditional_on(laws)
    full = search.problem.conditional_on()
    found = find_random_effect(bare, RANDOM_EFFECT_LEVEL) if unknown else None
    if found is None or any(is_neighbour(found.site.where, where) for where in unknown):
        return False
    before, after = (float((p.orthogonalise(p.residual) ** 2).sum()) for p in (bare, full))
    if found.gain < 0.5 * full.degrees * np.log(before / after):
        return False
    search.random_effect = found
    return True


def _search_on_subset(search: Search, samples) -> Found:
    """The search on a part of the poses, which is as valid and faster; the remainder is judged on more of them."""
    bench = search.bench
    before = bench.problem((), samples, hypotheses=False)
    if samples is None:
        used = np.ones(len(bench.pose), bool)
    else:
        used = samples
    _, label = np.unique(before.pose, return_inverse=True)
    search.samples = used.copy()
    search.samples[used] = label % -(-before.n // _MAX_SEARCHED_SAMPLES) == 0
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
    # where functions are accepted, the noise findings are those of the part on which the functions were judged
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
