"""Terms and structure that noise makes alone where it is correlated from pose to pose."""

from collections.abc import Sequence
from dataclasses import replace

from workbench.core.effect import Effect
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.hypotheses import family_wise, ranked_hypotheses
from workbench.diagnosis.linear.problem import Bench, Found, Problem
from workbench.diagnosis.noise.serial_correlation import (
    SerialCorrelation,
    prefers_term,
    serial_correlation,
)
from workbench.diagnosis.validation.controls import of_order
from workbench.diagnosis.validation.folds import tested_samples
from workbench.diagnosis.validation.terms import Term


def reject_explained_by_correlated_noise(
    bench: Bench, terms: Sequence[Term]
) -> tuple[list[Term], list[Term]]:
    """The terms, and refused those that read the time and that correlated noise explains as well.

    Whether anything is missing without such a term, with the correlation of what is left there next to slow
    polynomials: a drift is none, and what varies with the poses is not judged here. A term that explains most of this
    correlation stays, see `prefers_term`.
    """
    retained, refused = list(terms), []
    if bench.chain is None:
        return retained, refused
    for term in terms:
        if not term.finding.effects or not of_order(bench, term.finding.effects):
            continue
        effects = [e for other in retained for e in other.finding.effects]
        effects_of_term = {id(e) for e in term.finding.effects}
        others = [i for i, e in enumerate(effects) if id(e) not in effects_of_term]
        full_problem = bench.problem(effects, tested_samples(bench))
        problem = full_problem.conditional_on(others)
        noise = serial_correlation(problem)
        if noise is None or prefers_term(problem, full_problem.conditional_on()):
            continue
        if _chance(problem, noise) >= UNMODELLED_LEVEL:
            reason = f"noise that is correlated from pose to pose ({noise.value:.2f}) explains it as well"
            refused.append(replace(term, kept=False, reason=reason))
            retained = [other for other in retained if other is not term]
    return retained, refused


def with_correlated_noise(
    bench: Bench, found: Found, effects: Sequence[Effect], after: Problem
) -> tuple[Found, SerialCorrelation | None]:
    """Findings with p-values for correlated noise where this explains the residual; and its correlation.

    effects: those retained; after: the problem with them. Where structure remains that the correlation of what is left
    does not explain, this is no noise, and the second is None.
    """
    noise = None if bench.chain is None else serial_correlation(after)
    if noise is None:
        return found, None
    problem = bench.problem(effects, tested_samples(bench)).conditional_on()
    p = _chance(problem, noise)
    if p < UNMODELLED_LEVEL:
        return found, None
    first = found.p_first if effects else max(found.p_first, p)
    return replace(found, p_first=first, p_remainder=max(found.p_remainder, p)), noise


def _chance(problem: Problem, noise: SerialCorrelation) -> float:
    """Family-wise p-value that a problem lacks anything, under correlated noise."""
    return family_wise(ranked_hypotheses(replace(problem, serial_effect=noise.design_effect)))
