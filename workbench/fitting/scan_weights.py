"""Weights of the three numbers of a scan, whose errors are those of its points and those of the arm's pose.

The points of a scan determine the ball's place well in some directions and hardly in others; errors of the pose
displace the ball alike in all of them. With M the displacement's factor of `BallScan`, the residual of a scan has the
covariance v (I + t M M'), and t is estimated by restricted maximum likelihood (Patterson & Thompson, Biometrika 58
(1971) 545) about the fit of a model: few poses leave little more than they are asked for, and a plain likelihood would
take what the parameters absorb for small errors of the poses. An effect that the model lacks makes t too large.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import ROOT, Recording
from robot_model.robot import Robot
from robot_model.system import bind
from workbench.core.effect import Effect
from workbench.core.least_squares.identifiability import OBSERVABLE_SIGMAS
from workbench.core.least_squares.linear_algebra import symmetric_eigen, thin_svd
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.calibration_plans.plans import geometry, stage_mask
from workbench.fitting.noise_scale import noise_scaled

_RATIOS = np.append(0.0, np.geomspace(1e-2, 1e6, 60))
"""Variances of the arm's poses over that of points that are tried: none, and steps of a third over all magnitudes."""
_FITS, _STEPS = 3, 6
"""Fits by which the noise of the geometry's residual settles, and steps of each of them."""


def with_roots(scans: Recording, roots: np.ndarray) -> Recording:
    """The recording of scans with other roots (n, 3, 3)."""
    columns = dict(scans.columns) | dict(zip(ROOT, roots.reshape(-1, 9).T))
    return replace(scans, columns=columns)


def roots_of(scans: Recording) -> np.ndarray:
    """(n, 3, 3) roots of a recording of scans."""
    return np.stack([scans.columns[name] for name in ROOT], axis=1).reshape(-1, 3, 3)


def roots_next_to(model: Model, parameters: Parameters, roots, weights) -> np.ndarray:
    """(n, 3, 3) roots by which all three numbers have one variance in the residual of a model of scans.

    roots: (n, 3, 3) those of the points alone, G^(1/2); weights (n,): robust ones of the scans.
    """
    measurement = replace(model.chain.measurement, root=roots)
    unweighted = Model(replace(model.chain, measurement=measurement), model.effects)
    residual, rows = unweighted.linearise(parameters)
    factor = measurement.place_factor(measurement.measured[1])
    values, vectors = symmetric_eigen(factor @ factor.swapaxes(1, 2))
    coordinates = np.einsum("nij,in->nj", vectors, residual)
    steps = parameters.typical[parameters.mask] / np.sqrt(
        (unweighted.sigma(parameters) ** 2).mean()
    )
    columns = np.einsum("nij,pin->njp", vectors, rows) * steps
    ratio = _likeliest_ratio(_Residual(values, coordinates, columns, weights))
    scale = np.sqrt((1 + ratio * values).mean() / (1 + ratio * values))
    return (vectors * scale[:, None, :]) @ vectors.swapaxes(1, 2) @ roots


@dataclass(frozen=True)
class _Residual:
    """A residual in the eigenvectors of M M'.

    `values`, `coordinates` (n, 3): eigenvalues, and the residual along the eigenvectors; `columns` (n, 3, P): its
    derivative, each by a typical step in sigmas; `weights` (n,): a scan with the weight w counts as w scans.
    """

    values: np.ndarray
    coordinates: np.ndarray
    columns: np.ndarray
    weights: np.ndarray


def _likeliest_ratio(residual: _Residual) -> float:
    """Ratio t of the variances with the largest restricted likelihood; 0 where t is not worth a parameter."""
    flat = residual.columns.reshape(-1, residual.columns.shape[-1])
    left, singular, _ = thin_svd(flat)
    basis = left[:, singular > OBSERVABLE_SIGMAS]
    y = residual.coordinates.ravel()
    weights = np.repeat(residual.weights, residual.values.shape[1])
    degrees = max(weights.sum() - basis.shape[1], 1.0)
    cost = []
    for ratio in _RATIOS:
        growth = 1 + ratio * residual.values.ravel()
        information = weights / growth
        normal = basis.T @ (information[:, None] * basis)
        score = basis.T @ (information * y)
        squares = information @ y**2 - score @ np.linalg.solve(normal, score)
        log_determinants = weights @ np.log(growth) + np.linalg.slogdet(normal)[1]
        cost.append(log_determinants + degrees * np.log(max(squares, 1e-300)))
    best = int(np.argmin(cost))
    return float(_RATIOS[best]) if cost[0] - cost[best] > _cost_of_parameter(degrees) else 0.0


def _cost_of_parameter(degrees: float) -> float:
    """Fall of minus twice the log likelihood that a second parameter of the variances has to gain.

    Akaike's criterion corrected for few degrees of freedom n (Hurvich & Tsai, Biometrika 76 (1989) 297): 2 k n /
    (n - k - 1) for k parameters. Where too few are left, no second one is worth it.
    """
    if degrees <= 3:
        return np.inf
    return 4 * degrees / (degrees - 3) - 2 * degrees / (degrees - 2)


def weighed(robot: Robot, scans: Recording, effects: Sequence[Effect] = ()) -> Recording:
    """The recording of scans with the weights that the residuals of the geometry and of some effects show."""
    chain = bind(robot, scans)
    model = Model(chain, tuple(effects))
    start = model.parameters
    mask = stage_mask(start, geometry(robot), (), chain)
    mask[len(chain.parameters) :] = True
    start = start.only(mask)
    for _ in range(_FITS):
        fit = solve(model, start, "huber", _STEPS)
        model = replace(model, chain=noise_scaled(model.chain, fit))
        start = fit.parameters
    return with_roots(scans, roots_next_to(model, start, roots_of(scans), fit.weights))
