"""Residuals as the findings join the model one after another: simulation, baseline, each term."""

from collections.abc import Callable, Sequence

import numpy as np

from robot_model.measurements import samples_of
from workbench.core.least_squares.solver import solve
from workbench.explanation.comparison.reference import Reference, bound
from workbench.explanation.result import Step, Term
from workbench.fitting.calibration_plans.plans import frames_of

_MAX_SINGLE_STEPS = 12  # terms that join one at a time; the rest of a longer list joins at once


def steps_of_terms(
    bench, terms: Sequence[Term], residuals: Callable[[object], np.ndarray], before, after
) -> tuple[Step, ...]:
    """The baseline, then the model with one more term each, in the order of the findings.

    before, after: the problems of baseline and final model, which are solved already; residuals: from a problem its
    residual (m, n).
    """
    steps = [Step("baseline", residuals(before)[:3])]
    moving = [term for term in terms if term.finding.effects]
    effects: list = []
    for number, term in enumerate(moving, 1):
        effects += term.finding.effects
        if number == len(moving):
            steps.append(Step(f"+ {term.title}", residuals(after)[:3]))
        elif number < _MAX_SINGLE_STEPS:
            problem = bench.problem(list(effects), hypotheses=False)
            steps.append(Step(f"+ {term.title}", residuals(problem)[:3]))
    return tuple(steps)


def step_of_simulation(reference: Reference, recording) -> Step:
    """The reference as it stands, with base and tool placed by least squares: residual (3, n) of the moving rows."""
    model, start = bound(reference, samples_of(recording))
    placed = solve(model, start.only(start.matching(*frames_of(start))))
    return Step(f"{reference.name}, base and tool fitted", placed.residual[:3])


__all__ = ["step_of_simulation", "steps_of_terms"]
