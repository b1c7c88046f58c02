"""Whether the residual of a calibration depends on joint angles, on the side from which a joint came, or on the order
of the samples.

Noise depends on none of them. A dependence is therefore evidence of an unmodelled effect, and what is left without it
is an upper limit of the noise that needs no model of the effect.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workbench.core.covariates import clock, last_side, reversals
from workbench.core.distributions import chi2
from workbench.core.least_squares.adjustment_tests import (
    change_test,
    neighbour_test,
    regression_test,
)
from workbench.core.least_squares.linear_algebra import least_squares, thin_svd
from workbench.core.model import Model
from workbench.core.parameters import Parameters

ORDER, JOINTS = "the order of the samples", "the joint angles"
SIDE = "the side from which {} came"
_LEVEL = 0.001
_MOST_SAMPLES = 1500
_LEAST_POSES = 12
_CONFOUNDED = 0.9
"""Share of the F statistic of the best joint from which on another joint is named next to it."""
_ROUNDING = 1e-8  # share of the largest singular value below which a direction is rounding
_TRIALS = 100  # permutations of the sides
_LEAST_REVERSALS = 4
"""Of a joint, from which on its side is no step in the course of the recording."""


@dataclass(frozen=True)
class Structure:
    """Tests of the residual's structure.

    `p_value` of the smallest of the six p-values, times their number (Bonferroni). `share` of the residual variance
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

    Six tests: von Neumann's ratio of poses that follow one another (in the robot's frame and in that of the
    measurement, because a sensor that slips moves with the arm), a change at an instant or a slow drift of base, tool,
    joint or load (CUSUM), von Neumann's ratio of poses that are neighbours in joint space,
    a regression on periodic errors of every joint, and one on a gap of every joint, by the side from which it came.
    The first four need no model; the others have power where poses are scattered widely.
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
        _of_sides(model, parameters, residual, samples),
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
    regression = _Regression.of(model, parameters, residual)
    degrees = regression.residual.size - len(regression.rows)
    columns = _joint_error_columns(regression.model, parameters, degrees)
    if columns is None:
        return 1.0, 0.0
    test = regression.test(columns)
    return test.p_value, test.share


def _of_sides(model: Model, parameters: Parameters, residual: np.ndarray, samples: Samples):
    """Words, p-value and share for gaps of the joints, by the sides from which they came.

    Conditional on periodic errors of the joints. Sides are those that are recorded, else those of the last moves
    between samples. Lengths between two poses have none.
    """
    chain = model.chain
    nothing = (SIDE, 1.0, 0.0)
    if chain.poses_per_sample > 1:
        return nothing
    regression = _Regression.of(model, parameters, residual)
    moved = _joint_rows(regression.model, parameters)
    sides = _sides(regression.model.chain.state)
    columns = moved * sides[:, None]
    numbers = np.flatnonzero(np.abs(columns).max((1, 2)) > 0)
    degrees = regression.residual.size - len(regression.rows)
    if not len(numbers) or 4 * len(numbers) > degrees:
        return nothing
    # poses in the order of a grid come from one side where an angle is small: periodic errors are no gap
    waves = _joint_error_columns(regression.model, parameters, degrees)
    if waves is not None:
        regression = replace(regression, rows=np.concatenate([regression.rows, waves]))
    test = regression.test(columns[numbers])
    names = _joints_of_sides(regression, columns, numbers)
    p = test.p_value
    if p < _LEVEL:
        p = max(
            p,
            _p_of_permuted(
                regression, moved[numbers], sides[numbers], samples.pose[regression.chosen]
            ),
        )
    return SIDE.format(names), p, test.share


def _p_of_permuted(regression: "_Regression", moved, sides, pose) -> float:
    """p-value of what sides (J, n) explain, from sides that are permuted over the poses; moved (J, m, n).

    Targets of one pose err together, and an error of a pose has a direction, so that residuals are no independent
    numbers. By a gamma distribution with the mean and variance of the permuted gains.
    """
    _, first, label = np.unique(pose, return_index=True, return_inverse=True)
    by_pose = sides[:, first]
    rng = np.random.default_rng(0)
    gains = []
    for _ in range(_TRIALS):
        order = rng.permutation(len(first))
        permuted = by_pose[:, order]
        of_rows = permuted[:, label]
        gains.append(regression.gain(moved * of_rows[:, None]))
    found = regression.gain(moved * sides[:, None])
    mean = max(np.mean(gains), 1e-300)
    scale = max(np.var(gains) / mean, 1e-300)
    degrees = 2 * mean / scale
    return float(chi2.sf(2 * found / scale, degrees))


def _joints_of_sides(regression: "_Regression", columns: np.ndarray, numbers: np.ndarray) -> str:
    """The joint whose side alone explains most, and those whose sides explain nearly as much.

    Joints with parallel axes that move together come from their sides together.
    """
    ratios = np.array([regression.test(columns[[number]]).f for number in numbers])
    is_likely = ratios >= _CONFOUNDED * ratios.max()
    likely = numbers[is_likely]
    best_first = likely[np.argsort(-ratios[is_likely])]
    words = [f"joint {number + 1}" for number in best_first]
    return " or ".join(words)


def _sides(state) -> np.ndarray:
    """(J, n) -1, 0 or 1: side from which each joint came; 0 where it hardly changes."""
    sides = []
    for joint in range(1, state.robot.joints + 1):
        names = (f"approach{joint}", last_side(joint))
        known = [state.covariates[name] for name in names if name in state.covariates]
        side = known[0] if known else np.zeros(state.n)
        if reversals(side, clock(state)) < _LEAST_REVERSALS:
            side = np.zeros(state.n)
        sides.append(side)
    return np.array(sides)


def _joint_rows(model: Model, parameters: Parameters) -> np.ndarray:
    """(J, m, n) derivative of the residual by the joint variables."""
    chain = model.chain
    evaluation = chain.evaluate(parameters.values[: len(chain.parameters)], {})
    return evaluation.rows("joint", np.arange(len(chain.variables)))


@dataclass(frozen=True)
class _Regression:
    """Residual (m, n) and rows (P, m, n) of the fitted parameters, of the samples `chosen` (n,) of a model."""

    model: Model
    residual: np.ndarray
    rows: np.ndarray
    root: np.ndarray
    chosen: np.ndarray

    @classmethod
    def of(cls, model: Model, parameters: Parameters, residual: np.ndarray) -> "_Regression":
        """Of at most `_MOST_SAMPLES` samples."""
        n = residual.shape[1]
        chosen = np.unique(np.linspace(0, n - 1, min(n, _MOST_SAMPLES)).astype(int))
        part = model.at(chosen)
        _, rows = part.linearise(parameters)
        return cls(part, residual[:, chosen], rows, 1 / part.sigma(parameters), chosen)

    @cached_property
    def _orthogonal(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal basis (N, R) of the fitted parameters, and the residual (N,) orthogonal to it."""
        white = (self.residual * self.root).ravel()
        baseline = (self.rows * self.root).reshape(len(self.rows), white.size).T
        vectors, values, _ = thin_svd(baseline)
        limit = _ROUNDING * values.max(initial=0.0)
        basis = vectors[:, values > limit]
        fitted = basis @ (basis.T @ white)
        return basis, white - fitted

    def gain(self, columns: np.ndarray) -> float:
        """Fall of the sum of squares by columns (C, m, n) next to the fitted parameters."""
        basis, left = self._orthogonal
        tested = (columns * self.root).reshape(len(columns), left.size).T
        absorbed = basis @ (basis.T @ tested)
        tested = tested - absorbed
        coefficients = least_squares(tested, left)
        return float(left @ tested @ coefficients)

    def test(self, columns: np.ndarray):
        """Test of columns (C, m, n) conditional on the fitted parameters."""
        white = (self.residual * self.root).ravel()
        baseline = (self.rows * self.root).reshape(len(self.rows), white.size).T
        tested = (columns * self.root).reshape(len(columns), white.size).T
        return regression_test(white, baseline, tested)


def _joint_error_columns(model: Model, parameters: Parameters, degrees: int) -> np.ndarray | None:
    """(P, m, n) derivative for joint errors that are periodic in any joint angle; None where degrees do not suffice."""
    chain = model.chain
    joints = len(chain.variables)
    rows = _joint_rows(model, parameters)
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
