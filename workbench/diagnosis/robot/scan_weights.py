"""Weights of the three numbers of a scan, whose errors are those of its points and those of the arm's pose.

The points of a scan determine the ball's place well in some directions and hardly in others; errors of the pose
displace the ball alike in all of them. With M the displacement's factor of `BallScan`, the residual of a scan has the
covariance v (I + t M M'), and t is estimated by maximum likelihood from the residuals of a model. An effect that the
model lacks is in them, too, and makes t too large.
"""

from dataclasses import replace

import numpy as np

from datasets.recording import ROOT, Recording
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_RATIOS = np.append(0.0, np.geomspace(1e-2, 1e6, 60))


def with_roots(scans: Recording, roots: np.ndarray) -> Recording:
    """The recording of scans with other roots (n, 3, 3)."""
    return replace(scans, columns=dict(scans.columns) | dict(zip(ROOT, roots.reshape(-1, 9).T)))


def roots_of(scans: Recording) -> np.ndarray:
    """(n, 3, 3) roots of a recording of scans."""
    return np.stack([scans.columns[name] for name in ROOT], axis=1).reshape(-1, 3, 3)


def roots_next_to(model: Model, parameters: Parameters, roots, weights) -> np.ndarray:
    """(n, 3, 3) roots by which all three numbers have one variance in the residual of a model of scans.

    roots: (n, 3, 3) those of the points alone, G^(1/2); weights (n,): robust ones of the scans.
    """
    measurement = replace(model.chain.measurement, root=roots)
    unweighted = Model(replace(model.chain, measurement=measurement), model.effects)
    residual = unweighted.residual(parameters)
    factor = measurement.place_factor(measurement.measured[1])
    values, vectors = symmetric_eigen(factor @ factor.swapaxes(1, 2))
    along = np.einsum("nij,in->nj", vectors, residual)
    ratio = _likeliest_ratio(values, along, weights)
    scale = np.sqrt((1 + ratio * values).mean() / (1 + ratio * values))
    return (vectors * scale[:, None, :]) @ vectors.swapaxes(1, 2) @ roots


def _likeliest_ratio(values: np.ndarray, along: np.ndarray, weights: np.ndarray) -> float:
    """Ratio t of the variances; values, along (n, 3): eigenvalues of M M' and the residual along its eigenvectors.

    A scan with the weight w counts as w scans.
    """
    growth = 1 + _RATIOS[:, None, None] * values
    count = weights.sum() * values.shape[1]
    variance = (along**2 / growth).sum(2) @ weights / count
    cost = np.log(growth).sum(2) @ weights + count * np.log(variance)
    return float(_RATIOS[np.argmin(cost)])
