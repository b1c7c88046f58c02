"""Effects on the noise: a variance model of the residuals, fitted by maximum likelihood.

The mean does not depend on them; they are estimated between fits of the mean by Fisher scoring of a
log-linear variance model. The overall level is the sigma scale of the fit.
Harvey, Econometrica 44 (1976); Aitkin, Applied Statistics 36 (1987).
"""

from dataclasses import replace

import numpy as np

from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters

_ROUNDS = 20
_LONGEST = 1.0


def noise_mask(model: Model, parameters: Parameters) -> np.ndarray:
    """(P,) True for the free parameters that act on the noise."""
    mask = np.zeros(len(parameters), bool)
    for effect, span in zip(model.effects, model.spans):
        mask[span] = effect.port == NOISE
    return mask & parameters.mask


def information(model: Model, parameters: Parameters, weights: np.ndarray) -> np.ndarray:
    """(K, K) Fisher information of the K free noise parameters; weights (n,) of the samples."""
    basis = _basis(model, parameters, weights)
    return 2 * len(model.chain.sigma) * (basis * weights) @ basis.T


def fit_noise(
    model: Model, parameters: Parameters, residual: np.ndarray, weights: np.ndarray
) -> Parameters:
    """The free noise parameters that make residuals (m, n) over their sigma equally spread."""
    mask = noise_mask(model, parameters)
    basis = _basis(model, parameters, weights)
    precision = np.diag(parameters.precision[mask])
    for _ in range(_ROUNDS):
        white = ((residual / model.sigma(parameters)) ** 2).sum(0)
        excess = len(residual) * (white / np.average(white, weights=weights) - 1)
        values = parameters.values[mask]
        pull = (basis * weights) @ excess - precision @ (values - parameters.nulls[mask])
        step = solve_positive(information(model, parameters, weights) + precision, pull)
        step *= min(1.0, _LONGEST / max(np.abs(step).max(), 1e-300))
        changed = parameters.values.copy()
        changed[mask] += step
        parameters = replace(parameters, values=changed)
        if np.abs(step).max() < 1e-6:
            break
    return parameters


def _basis(model, parameters, weights):
    """(K, n) change of log sigma per unit of each free noise parameter, about its weighted mean."""
    rows = [
        effect.basis(model.chain.state)[parameters.mask[span], 0]
        for effect, span in zip(model.effects, model.spans)
        if effect.port == NOISE and parameters.mask[span].any()
    ]
    basis = np.concatenate(rows)
    return basis - np.average(basis, axis=1, weights=weights)[:, None]
