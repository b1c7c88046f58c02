"""A fit whose sigmas agree with its own residual, and whose priors agree with its data."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.system import RobotChain
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage
from workbench.fitting.noise_scale import NOISE_ROUNDS, is_settled, noise_scaled
from workbench.fitting.priors.linear_posterior import LinearFit, Posterior
from workbench.fitting.priors.wider_priors import widened

_LEAST_DEGREES = 0.25
"""Share of the residuals that a fit must leave as degrees of freedom, so that its residual shows the noise.

A fit that nearly interpolates has a small residual. Taken for the noise, it frees more parameters from their priors,
and the next residual is smaller still, until nothing is left. Its noise is the one of the largest evidence instead.
"""
_SAME_FIT = 1.02  # ratio of costs: what small terms that are left out may change


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
        is_open = trial.degrees < _LEAST_DEGREES * trial.residual.size
        stated = part.chain
        estimate = _with_probable_noise if is_open and is_same_prior else _with_noise
        chain, part = estimate(chain, part, trial, fitted)
        trial = trial.with_sigma(stated.sigma, part.chain.sigma)
        if is_same_prior and is_settled(stated, part.chain):
            break
    return trial, part, chain


def solve_independent(
    model: Model, trial: Fit, free: Parameters, stage: Stage, root: Sequence[str] = ()
) -> Fit:
    """Fit of an independent set of parameters, `free`, after a trial fit of all; where it differs, a fit of all.

    Parameters that are left out return to their earlier values, and those of the set make up for it. Of few poses
    some columns are dependent only because there are so few rows, and the values of parameters that are left out
    would then not be arbitrary: the priors say which combination is probable. Where columns are nearly dependent the
    model bends on the way (axes that are parallel within a hundredth of a degree). In both cases all parameters stay
    free but `root`, the keys that place the root frame.
    """
    fit = solve(model, free, stage.loss, stage.steps, trial)
    all_parameters = trial.parameters
    if _cost(model, fit, all_parameters.mask) <= _SAME_FIT * _cost(
        model, trial, all_parameters.mask
    ):
        return fit
    without_root = all_parameters.fix(*root) if root else all_parameters
    values = np.where(without_root.mask, all_parameters.values, free.values)
    return solve(model, replace(without_root, values=values), stage.loss, stage.steps, trial)


def _cost(model: Model, fit: Fit, asked: np.ndarray) -> float:
    """Weighted sum of squared residuals over their sigma, and of the deviations of parameters, asked (P,) bool."""
    parameters = fit.parameters
    residuals = float((fit.weights * (fit.residual / model.sigma(parameters)) ** 2).sum())
    deviations = (parameters.values - parameters.nulls)[asked]
    return residuals + float(parameters.precision[asked] @ deviations**2)


def _with_noise(
    chain: RobotChain, part: Model, trial: Fit, fitted: np.ndarray
) -> tuple[RobotChain, Model]:
    """The chain of all samples and the model of the fitted samples, with the noise of a fit."""
    chain = noise_scaled(chain, trial, fitted, may_shrink=False)
    chain_with_noise = replace(part.chain, sigma=chain.sigma[:, fitted])
    return chain, part.with_chain(chain_with_noise)


def _with_probable_noise(
    chain: RobotChain, part: Model, trial: Fit, fitted: np.ndarray
) -> tuple[RobotChain, Model]:
    """As `_with_noise`, with the noise under which the data are most probable, whatever the parameters are."""
    linear = LinearFit.of(trial)
    factor = np.sqrt(Posterior(linear, linear.precision).most_probable_noise())
    stated = 0.0 if chain.sigma_unknown else chain.stated_sigma
    sigma = np.maximum(factor * chain.sigma, stated)
    chain = replace(chain, sigma=sigma)
    model = part.with_chain(replace(part.chain, sigma=chain.sigma[:, fitted]))
    return chain, model


__all__ = ["fit_with_noise", "solve_independent"]
