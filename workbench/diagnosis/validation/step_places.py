"""The place of a step, compared by evidence with correlated noise.

The search assumes independent noise. If further effects are missing, the six parameters of a part that moved fit these,
too, and seem to prove its place. With the correlation of the noise estimated for every place, only the structure beyond
it distinguishes the places, and every additional parameter is penalised.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.effects.steps import Shift, TargetShift
from robot_model.effects.transmission import ZeroShift
from workbench.core.effect import Effect
from workbench.diagnosis.levels import LEAST_LOG_ODDS, LISTED_PROBABILITY, UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Alternative, Bench, Finding, Problem, likeness_text
from workbench.diagnosis.noise.random_effects import known_rounding, whitened_by
from workbench.diagnosis.noise.serial_correlation import log_evidence
from workbench.diagnosis.validation.folds import tested_samples
from workbench.diagnosis.validation.stability import effects_of
from workbench.diagnosis.validation.terms import Term

_STEPS = (Shift, TargetShift, ZeroShift)


def with_step_places(bench: Bench, terms: Sequence[Term]) -> list[Term]:
    """The terms, each step at the place that is clearly most probable, with the other places as alternatives."""
    compared = list(terms)
    for i, term in enumerate(terms):
        effects = term.finding.effects
        if bench.chain is not None and len(effects) == 1 and isinstance(effects[0], _STEPS):
            findings = [other.finding for k, other in enumerate(compared) if k != i]
            others = effects_of(findings)
            compared[i] = replace(term, finding=_among_places(bench, term.finding, others))
    return compared


def _among_places(bench: Bench, finding: Finding, others: Sequence[Effect]) -> Finding:
    """A step's finding, conditional on other effects: its place, probability and alternatives."""
    steps = _steps_at_its_instant(bench.chain, finding.effects[0], others)
    full_problem = bench.problem((*others, *steps), tested_samples(bench), hypotheses=False)
    rounding = known_rounding(full_problem.conditional_on(), UNMODELLED_LEVEL)
    if rounding is not None:
        full_problem = whitened_by(full_problem, rounding)
    kept = list(range(len(others)))
    base = full_problem.conditional_on(kept)
    models = [full_problem.conditional_on([*kept, len(kept) + k]) for k in range(len(steps))]
    logs = np.array([log_evidence(base, model) for model in models])
    if not np.isfinite(logs).all():
        return finding
    best = int(np.argmax(logs))
    if logs[best] - logs[0] > LEAST_LOG_ODDS:
        chosen = best
    else:
        chosen = 0
    explained = np.array([_squares(base) - _squares(model) for model in models])
    likeness = np.clip(explained / max(explained[chosen], 1e-300), 0.0, 1.0)
    names = [(step.effect, step.where) for step in steps]
    unchanged = [a for a in finding.alternatives if (a.effect, a.where) not in names]
    shares = np.exp(logs - logs[best])
    shares *= (1 - sum(a.probability for a in unchanged)) / shares.sum()
    listed = [
        Alternative(
            *names[k],
            finding.label,
            float(shares[k]),
            float(likeness[k]),
            likeness_text(likeness[k]),
        )
        for k in np.argsort(-shares)
        if k != chosen and shares[k] >= LISTED_PROBABILITY
    ]
    effect, where = names[chosen]
    return replace(
        finding,
        effect=effect,
        where=where,
        effects=(steps[chosen],),
        probability=float(shares[chosen]),
        alternatives=(*listed, *unchanged),
    )


def _steps_at_its_instant(chain, chosen: Effect, others: Sequence[Effect]) -> list[Effect]:
    """The step, and those of all places at its instant that the others do not hold."""
    known = {(effect.effect, effect.where) for effect in (chosen, *others)}
    grids = [grid for kind in _STEPS for grid in kind.grids(chain)]
    steps = [grid.effect(grid.where, chosen.after) for grid in grids]
    unlisted = (step for step in steps if (step.effect, step.where) not in known)
    return [chosen, *unlisted]


def _squares(problem: Problem) -> float:
    remaining = problem.orthogonalise(problem.residual)
    return float(remaining @ remaining)
