"""Whether the residual of a calibration depends on joint angles or on the order of the samples.

Noise depends on neither. A dependence is therefore evidence of an unmodelled effect, and what is left without it is
an upper limit of the noise that needs no model of the effect.
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.adjustment_tests import (
    change_test,
    neighbour_test,
    regression_test,
)
from workbench.core.model import Model
from workbench.core.parameters import Parameters

ORDER, JOINTS = "the order of the samples", "the joint angles"
_LEVEL = 0.001
_MOST_SAMPLES = 1500
_LEAST_POSES = 12


@dataclass(frozen=True)
class Structure:
    """Tests of the residual's structure.

    `p_value` of the smallest of the five p-values, times their number (Bonferroni). `share` of the residual variance
    that is certainly no noise. `depends_on` names in words what the residual depends on; empty where nothing was
    found.
    """

    p_value: float
    share: float
    depends_on: tuple[str, ...]

    @property
    def found(self) -> bool:
        return bool(self.depends_on)


@dataclass(frozen=True)
class Samples:
    """Labels (n,) of the samples' poses and their order in time (n,)."""

    pose: np.ndarray
    time: np.ndarray


def structure(
    model: Model, parameters: Parameters, residual: np.ndarray, samples: Samples
) -> Structure:
    """Tests for a model on its n fitted samples; residual (m, n) of the fit, mm and rad.

    Five tests: von Neumann's ratio of poses that follow one another (in the robot's frame and in that of the
    measurement, because a sensor that slips moves with the arm), a change at an instant or a slow drift of base, tool,
    joint or load (CUSUM), von Neumann's ratio of poses that are neighbours in joint space,
    and a regression on periodic errors of every joint. All but the last need no model; the last has power where poses
    are scattered widely.
    """
    chain = model.chain
    _, arrows = in_root(model, parameters, residual[:3])
    means, joints, order = _by_pose(arrows, chain.variables[:, : residual.shape[1]], samples)
    measured, _, _ = _by_pose(residual[:3], chain.variables[:0, : residual.shape[1]], samples)
    tests = [
        (ORDER, *_of_order(means, order)),
        (ORDER, *_of_order(measured, order)),
        (ORDER, *_of_change(model, parameters, residual, arrows, samples)),
        (JOINTS, *_of_neighbours(means, joints)),
        (JOINTS, *_of_joint_errors(model, parameters, residual)),
    ]
    significant = [(name, share) for name, p, share in tests if p * len(tests) < _LEVEL]
    smallest = min(p for _, p, _ in tests) * len(tests)
    names = tuple(dict.fromkeys(name for name, _ in significant))
    share = max((share for _, share in significant), default=0.0)
    return Structure(float(min(smallest, 1.0)), float(share), names)


def in_root(
    model: Model, parameters: Parameters, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measured points and residuals (3, n) mm, both in the robot's root frame."""
    chain_values = parameters.values[: len(model.chain.parameters)]
    return model.chain.to_root(chain_values, model.chain.evaluate(chain_values, {}), residual)


def _by_pose(arrows, joints, samples):
    """Mean residual (3, P) and joint variables (J, P) of every pose, and the poses in order of time (P,)."""
    labels, group = np.unique(samples.pose, return_inverse=True)
    counts = np.bincount(group)
    means = np.stack([np.bincount(group, row) for row in arrows]) / counts
    places = np.array([np.bincount(group, row) / counts for row in joints])
    times = np.bincount(group, samples.time) / counts
    return means, places, np.argsort(times, kind="stable")


def _of_order(means, order):
    """p-value and share of the variance for poses that follow one another."""
    if len(order) < _LEAST_POSES:
        return 1.0, 0.0
    values = means[:, order]
    previous = np.maximum(np.arange(len(order)) - 1, 0)
    previous[0] = 1
    test = neighbour_test(values, previous)
    return test.p_value, max(1 - test.ratio, 0.0)


def _of_change(model: Model, parameters: Parameters, residual, arrows, samples):
    """p-value and share for a change in the course of the recording: of base, tool, any joint or load.

    The mean residual of each pose, along the axes of the root and of the flange, and its scores by the joints and by
    their deflection under a load on the flange.
    """
    chain, series = model.chain, [arrows]
    if chain.poses_per_sample == 1:
        series.append(np.einsum("cin,in->cn", chain.state.frames.link[-1], arrows))
        chain_values = parameters.values[: len(chain.parameters)]
        rows = chain.evaluate(chain_values, {}).rows("joint", np.arange(len(chain.variables)))
        weighted = residual / model.sigma(parameters) ** 2
        scores = np.einsum("kmn,mn->kn", rows, weighted)
        series += [scores, scores * chain.state.unit_load_torque]
    means, _, order = _by_pose(np.concatenate(series), chain.variables[:0], samples)
    if len(order) < _LEAST_POSES:
        return 1.0, 0.0
    test = change_test(means[:, order])
    return test.p_value, test.share


def _of_neighbours(means, joints):
    """The same for poses next to one another in joint space."""
    from scipy.spatial import cKDTree

    if joints.shape[1] < _LEAST_POSES:
        return 1.0, 0.0
    spread = joints.std(1)
    scaled = joints[spread > 1e-9] / spread[spread > 1e-9, None]
    if not len(scaled):
        return 1.0, 0.0
    nearest = cKDTree(scaled.T).query(scaled.T, k=2)[1]
    index = np.arange(len(nearest))
    neighbour = np.where(nearest[:, 0] == index, nearest[:, 1], nearest[:, 0])
    test = neighbour_test(means, neighbour)
    return test.p_value, max(1 - test.ratio, 0.0)


def _of_joint_errors(model: Model, parameters: Parameters, residual: np.ndarray):
    """p-value and share for periodic errors of the joints, beyond what the fitted parameters absorb."""
    n = residual.shape[1]
    chosen = np.unique(np.linspace(0, n - 1, min(n, _MOST_SAMPLES)).astype(int))
    part = model.at(chosen)
    _, rows = part.linearise(parameters)
    degrees = residual[:, chosen].size - len(rows)
    columns = _joint_error_columns(part, parameters, degrees)
    if columns is None:
        return 1.0, 0.0
    root = 1 / part.sigma(parameters)
    white = (residual[:, chosen] * root).ravel()
    baseline = (rows * root).reshape(len(rows), white.size).T
    test = regression_test(white, baseline, (columns * root).reshape(len(columns), white.size).T)
    return test.p_value, test.share


def _joint_error_columns(model: Model, parameters: Parameters, degrees: int) -> np.ndarray | None:
    """(P, m, n) derivative for joint errors that are periodic in any joint angle; None where degrees do not suffice."""
    chain = model.chain
    joints = len(chain.variables)
    evaluation = chain.evaluate(parameters.values[: len(chain.parameters)], {})
    rows = evaluation.rows("joint", np.arange(joints))
    waves = _waves(chain)
    if 2 * joints * joints * 2 <= degrees / 4:
        pairs = [(k, wave) for k in range(joints) for wave in waves.reshape(-1, waves.shape[-1])]
    elif 4 * joints <= degrees / 4:
        pairs = [(k, wave) for k in range(joints) for wave in waves[k]]
    else:
        return None
    columns = np.stack([rows[k] * wave for k, wave in pairs])
    poses = chain.poses_per_sample
    if poses == 1:
        return columns
    return columns.reshape(*columns.shape[:-1], poses, -1).sum(-2)


def _waves(chain) -> np.ndarray:
    """(J, 4, n) sine and cosine of every joint, once and twice per revolution; the travel of a slide is half a turn."""
    angles = chain.variables.copy()
    for k in np.flatnonzero(chain.robot.prismatic):
        low = angles[k].min()
        high = angles[k].max()
        angles[k] = np.pi * (angles[k] - low) / max(high - low, 1e-9)
    return np.stack([np.sin(angles), np.cos(angles), np.sin(2 * angles), np.cos(2 * angles)], 1)
