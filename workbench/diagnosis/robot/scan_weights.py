"""Weights of the three numbers of a scan, whose errors are those of its points and those of the arm's pose.

The points of a scan determine the ball's place well in some directions and hardly in others; errors of the pose
displace the ball alike in all of them. With M the displacement's factor of `BallScan`, the residual of a scan has the
covariance v (I + t M M'), and t is estimated by maximum likelihood from the residuals of the geometry.
"""

from dataclasses import replace

import numpy as np

from datasets.recording import ROOT, Recording
from robot_model.robot import Robot
from robot_model.system import bind
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.fitting.calibration_plans.plans import geometry, stage_mask

_STEPS = 15
_RATIOS = np.append(0.0, np.geomspace(1e-2, 1e6, 60))


def with_errors_of_poses(robot: Robot, scans: Recording) -> Recording:
    """The recording of scans with roots by which all three numbers have one variance."""
    model = Model(bind(robot, scans))
    measurement = model.chain.measurement
    start = model.parameters
    free = start.only(stage_mask(start, geometry(robot), (), model.chain))
    residual = solve(model, free, "huber", _STEPS).residual
    factor = measurement.place_factor(measurement.measured[1])
    values, vectors = symmetric_eigen(factor @ factor.swapaxes(1, 2))
    along = np.einsum("nij,in->nj", vectors, residual)
    ratio = _likeliest_ratio(values, along)
    scale = np.sqrt((1 + ratio * values).mean() / (1 + ratio * values))
    root = (vectors * scale[:, None, :]) @ vectors.swapaxes(1, 2) @ measurement.root
    columns = dict(scans.columns) | dict(zip(ROOT, root.reshape(-1, 9).T))
    return replace(scans, columns=columns)


def _likeliest_ratio(values: np.ndarray, along: np.ndarray) -> float:
    """Ratio t of the variances; values, along (n, 3): eigenvalues of M M' and the residual along its eigenvectors."""
    growth = 1 + _RATIOS[:, None, None] * values
    variance = (along**2 / growth).mean((1, 2))
    cost = np.log(growth).sum((1, 2)) + along.size * np.log(variance)
    return float(_RATIOS[np.argmin(cost)])
