"""The instant at which a step begins, and how well it is known: its posterior over all instants that were tried."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from robot_model.effects.steps import RepeatedStep
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import LEAST_LOG_ODDS, LISTED_PROBABILITY, MAJORITY, ROUNDING
from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.linear.estimates import Instant
from workbench.diagnosis.linear.evidence import Projected, scan_moments
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.noise.outliers import robust_loss


def instant_of(search, i: int, tested: Hypothesis) -> Instant | None:
    """Instant of an accepted hypothesis, `tested` as it is next to the others; None where it begins at none.

    The uncertainty is the RMS distance of all instants, by their posterior, and the gap between the two samples about
    the one that is stated, anywhere in which the step may be.
    """
    if not _is_step(tested):
        return None
    scan, value = tested.source, tested.value
    present, weights = _posterior(search, i, scan)
    spread = float(weights @ (present.options - value) ** 2)
    std = float(np.sqrt(spread + _gap(present, value) ** 2 / 12))
    is_timed = "time_s" in search.bench.chain.state.covariates
    # samples are counted from 1, rows from 0
    if is_timed:
        return Instant(value, std, "s")
    return Instant(value + 1, std, "sample")


def refine_instants(search) -> None:
    """Give accepted steps the instants at which the robust loss of all samples is least, and solve with them.

    A sample on the wrong side of an instant lies far off, and hardly counts in the solution with it. The evidence about
    that solution therefore does not distinguish the instants on either side of the sample, which then seems an outlier.
    """
    refined = list(search.accepted)
    for i in search.accepted_indices:
        term = _refined(search, i)
        # two steps of one effect never come to begin at one instant: they would be the same step
        others = {step for k in search.other_indices(i) for step in _steps(refined[k])}
        if others.isdisjoint(_steps(term)):
            refined[i] = term
    if any(term is not accepted for term, accepted in zip(refined, search.accepted)):
        search.accepted = tuple(refined)
        search.solve_feasible()


def with_numbered_steps(accepted: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Accepted hypotheses in which the steps of one effect at one place have different numbers, and so parameters."""
    taken, out = set(), []
    for h in accepted:
        effects = tuple(_numbered(effect, taken) for effect in h.effects)
        is_same = all(new is old for new, old in zip(effects, h.effects))
        out.append(h if is_same else replace(h, effects=effects))
    return tuple(out)


def _numbered(effect: Effect, taken: set[tuple]) -> Effect:
    """The effect, where its number is taken with the next one that is free; taken: of the effects before it."""
    if not isinstance(effect, RepeatedStep):
        return effect
    number = _free_number(effect, taken)
    taken.add((effect.effect, effect.where, number))
    if number == (effect.occurrence or 1):
        return effect
    return type(effect)(effect.where, effect.after, occurrence=number)


def _free_number(effect: Effect, taken: set[tuple]) -> int:
    """The number of a step, or the first one after it that is not taken."""
    number = effect.occurrence or 1
    while (effect.effect, effect.where, number) in taken:
        number += 1
    return number


def _refined(search, i: int) -> Hypothesis:
    """An accepted hypothesis, with another instant where that has a clearly smaller loss."""
    accepted = search.accepted[i]
    problem = search.problem
    if not _is_step(accepted) or len(problem.residual) % problem.n:
        return accepted
    scan, value = accepted.source, accepted.value
    present, weights = _posterior(search, i, scan)
    plausible = present.options[(weights > LISTED_PROBABILITY) | (present.options == value)]
    is_plausible_row = (present.x > plausible.min()) & (present.x <= plausible.max())
    weights = np.tile(problem.weights, problem.ends.count)
    if not (weights[is_plausible_row] < MAJORITY).any():
        return accepted  # all of these samples count, in the evidence too
    conditional = problem.conditional_on(search.other_indices(i))
    losses = [_loss(conditional, present, option) for option in plausible]
    if min(losses) > _loss(conditional, present, value) - LEAST_LOG_ODDS:
        return accepted
    best = float(plausible[int(np.argmin(losses))])
    label = present.word.format(best)
    effects = present.make(best)
    return replace(accepted, label=label, effects=effects, source=present, value=best)


def _loss(problem: Problem, scan: Scan, option: float) -> float:
    """Robust loss of the residual with a step at an option, without the weights that the solution gave the samples."""
    columns = problem.orthogonalise(scan.columns_at(problem, option))
    residual = problem.orthogonalise(problem.residual)
    residual = residual - columns @ least_squares(columns, residual, ROUNDING)
    return robust_loss((residual / problem.root_weights).reshape(-1, problem.n))


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
    present = search.problem.sources.get(scan.key, scan)
    projected = Projected(search.problem.conditional_on(search.other_indices(i)))
    evidence = projected.score_hypotheses(scan_moments(projected, present)).evidence
    logs = evidence + np.log(np.maximum(present.prior_weight, 1e-300))
    return present, np.exp(logs - logsumexp(logs))


def _gap(scan: Scan, value: float) -> float:
    """Distance between the samples before and after an instant, of those that the step may move: of one target, say."""
    x = scan.x[(scan.rows != 0).reshape(-1, len(scan.x)).any(0)]
    return float(x[x > value].min() - x[x <= value].max())
