"""The instant at which a step begins, and how well it is known: its posterior over all instants that were tried."""

from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import LEAST_LOG_ODDS, LISTED_PROBABILITY, MAJORITY, ROUNDING
from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.linear.estimates import Instant
from workbench.diagnosis.linear.evidence import Projected, scan_moments
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.noise.outliers import robust_loss


def instant_of(search, i: int, own: Hypothesis) -> Instant | None:
    """Instant of an accepted hypothesis, `own` as it is judged next to the others; None where it begins at none.

    The uncertainty is the RMS distance of all instants, by their posterior, and the gap between the two samples about
    the one that is stated, anywhere in which the step may be.
    """
    if not _is_step(own):
        return None
    scan, value = own.source, own.value
    here, weights = _posterior(search, i, scan)
    spread = float(weights @ (here.options - value) ** 2)
    std = float(np.sqrt(spread + _gap(here, value) ** 2 / 12))
    is_timed = "time_s" in search.bench.chain.state.covariates
    # samples are counted from 1, rows from 0
    return Instant(value, std, "s") if is_timed else Instant(value + 1, std, "sample")


def refine_instants(search) -> None:
    """Give accepted steps the instants at which the robust loss of all samples is least, and solve with them.

    A sample on the wrong side of an instant lies far off, and hardly counts in the solution with it. The evidence about
    that solution therefore does not distinguish the instants on either side of the sample, which then seems an outlier.
    """
    refined = list(search.accepted)
    for i in search.accepted_indices:
        one = _refined(search, i)
        # two steps of one effect never come to begin at one instant: they would be the same step
        others = {step for k in search.other_indices(i) for step in _steps(refined[k])}
        if others.isdisjoint(_steps(one)):
            refined[i] = one
    if any(one is not held for one, held in zip(refined, search.accepted)):
        search.accepted = tuple(refined)
        search.solve_feasible()


def _refined(search, i: int) -> Hypothesis:
    """An accepted hypothesis, with another instant where that has a clearly smaller loss."""
    own, problem = search.accepted[i], search.problem
    if not _is_step(own) or len(problem.residual) % problem.n:
        return own
    scan, value = own.source, own.value
    here, weights = _posterior(search, i, scan)
    plausible = here.options[(weights > LISTED_PROBABILITY) | (here.options == value)]
    between = (here.x > plausible.min()) & (here.x <= plausible.max())
    weights = np.tile(problem.weights, problem.ends.count)
    if not (weights[between] < MAJORITY).any():
        return own  # all of these samples count, in the evidence too
    conditional = problem.conditional_on(search.other_indices(i))
    losses = [_loss(conditional, here, option) for option in plausible]
    if min(losses) > _loss(conditional, here, value) - LEAST_LOG_ODDS:
        return own
    best = float(plausible[int(np.argmin(losses))])
    label, effects = here.word.format(best), here.make(best)
    return replace(own, label=label, effects=effects, source=here, value=best)


def _loss(problem: Problem, scan: Scan, option: float) -> float:
    """Robust loss of the residual with a step at an option, without the weights that the solution gave the samples."""
    columns = problem.orthogonalise(scan.columns_at(problem, option))
    left = problem.orthogonalise(problem.residual)
    left = left - columns @ least_squares(columns, left, ROUNDING)
    return robust_loss((left / problem.root_weights).reshape(-1, problem.n))


def _steps(h: Hypothesis) -> set[tuple]:
    """Effect, place and instant of each step of a hypothesis."""
    return {
        (effect.effect, effect.where, effect.after)
        for effect in h.effects
        if getattr(effect, "after", None) is not None
    }


def _is_step(h: Hypothesis) -> bool:
    return bool(h.effects) and getattr(h.effects[0], "after", None) is not None


def _posterior(search, i: int, scan: Scan) -> tuple[Scan, np.ndarray]:
    """The scan at the present solution, and the posterior (V,) of its options conditional on all others accepted."""
    here = search.problem.sources.get(scan.key, scan)
    projected = Projected(search.problem.conditional_on(search.other_indices(i)))
    evidence = projected.score_hypotheses(scan_moments(projected, here)).evidence
    logs = evidence + np.log(np.maximum(here.prior_weight, 1e-300))
    return here, np.exp(logs - logsumexp(logs))


def _gap(scan: Scan, value: float) -> float:
    """Distance between the samples before and after an instant."""
    return float(scan.x[scan.x > value].min() - scan.x[scan.x <= value].max())
