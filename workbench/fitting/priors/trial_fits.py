"""A fit whose sigmas agree with its own residual, and whose priors agree with its data."""

from dataclasses import replace

import numpy as np

from robot_model.system import RobotChain
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage
from workbench.fitting.noise_scale import NOISE_ROUNDS, is_settled, noise_scaled
from workbench.fitting.priors.wider_priors import widened

_LEAST_DEGREES = 0.25
"""Share of the residuals that a fit must leave as degrees of freedom, so that its noise is known.

A fit that nearly interpolates has a small residual. Taken for the noise, it frees more parameters from their priors,
and the next residual is smaller still, until nothing is left.
"""
_SAME_FIT = 1.02  # ratio of sums of squares: what small terms that are left out may change


def fit_with_noise(
    model: Model, fitted: np.ndarray, before: Fit, start: Parameters, stage: Stage
) -> tuple[Fit, Model, RobotChain]:
    """Fit of all that a stage frees, repeated until the noise is that of its own residual.

    fitted (n,) bool: samples of the fit; before: fit of the previous stage, which gives the first noise; start: where
    the fit starts, and what is free. Returns the fit, the model of the fitted samples and the chain of all samples,
    both with the noise of the fit.
    """
    chain, part = _with_noise(model.chain, model.part(fitted), before, fitted)
    trial = None
    for _ in range(NOISE_ROUNDS):
        trial = solve(part, start, stage.loss, stage.steps, trial)
        start = widened(part, trial)
        is_same_prior = start is trial.parameters
        if trial.degrees < _LEAST_DEGREES * trial.residual.size and is_same_prior:
            break
        stated = part.chain
        chain, part = _with_noise(chain, part, trial, fitted)
        trial = trial.with_sigma(stated.sigma, part.chain.sigma)
        if is_same_prior and is_settled(stated, part.chain):
            break
    return trial, part, chain


def solve_independent(model: Model, trial: Fit, free: Parameters, stage: Stage) -> Fit:
    """Fit of an independent set of parameters, `free`, after a trial fit of all, which it equals.

    Parameters that are left out return to their earlier values, and those of the set make up for it. Where columns are
    nearly dependent this moves them so far that the model bends, and the solver would end on the way (axes that are
    parallel within a hundredth of a degree). There, parameters that are left out keep the values of the trial.
    """
    fit = solve(model, free, stage.loss, stage.steps, trial)
    if _squares(model, fit) <= _SAME_FIT * _squares(model, trial):
        return fit
    fallback = replace(free, values=trial.parameters.values)
    return solve(model, fallback, stage.loss, stage.steps, trial)


def _squares(model: Model, fit: Fit) -> float:
    """Weighted sum of squared residuals over their sigma."""
    return float((fit.weights * (fit.residual / model.sigma(fit.parameters)) ** 2).sum())


def _with_noise(
    chain: RobotChain, part: Model, trial: Fit, fitted: np.ndarray
) -> tuple[RobotChain, Model]:
    """The chain of all samples and the model of the fitted samples, with the noise of a fit."""
    chain = noise_scaled(chain, trial, fitted, may_shrink=False)
    chain_with_noise = replace(part.chain, sigma=chain.sigma[:, fitted])
    return chain, part.with_chain(chain_with_noise)


__all__ = ["fit_with_noise"]
