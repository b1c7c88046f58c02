"""Noise that is correlated from pose to pose, as that of an instrument whose air or temperature changes slowly.

A test that takes samples for independent calls such noise structure: a slow function gains (1 + r) / (1 - r) times as
much from noise of first-order autocorrelation r as from independent noise (Bayley & Hammersley, Suppl. J. R. Stat. Soc.
8 (1946) 184). The correlation is estimated next to slow polynomials in time, so that a drift does not count as noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from workbench.core.distributions import norm
from workbench.diagnosis.levels import DATA_FAULT_LEVEL, LEAST_NUMBER, NEGLIGIBLE_SHARE
from workbench.diagnosis.linear.problem import Problem

_DEGREE = 4  # of polynomials in time, in every coordinate, that are no noise
_MOST_POSES = 600  # of more, as many one after another
_LARGEST = (
    0.9  # beyond which correlated noise is a random walk and not distinguishable from a drift
)
_REWEIGHTED = 4  # estimates of the variances of means and of deviations from them
_GRID = (*np.linspace(0.0, _LARGEST, 10), 0.95, 0.98, 0.99)
"""Correlations that are compared with a term: up to that of a random walk, which is no step either."""


@dataclass(frozen=True)
class SerialCorrelation:
    """First-order autocorrelation of the noise from pose to pose: `value`, its standard deviation and p-value of 0."""

    value: float
    std: float
    p_value: float

    @property
    def design_effect(self) -> float:
        """Design effect of serially correlated poses for slow functions: correlated poses per independent one."""
        return (1 + self.value) / (1 - self.value)


def serial_correlation(problem: Problem) -> SerialCorrelation | None:
    """The significant positive correlation of what a problem leaves; None where there is none or too few poses.

    Poses in the order in which they were measured, repeats by their mean. Restricted maximum likelihood next to the
    baseline and the polynomials, which take slow noise out of the residual (Patterson & Thompson, Biometrika 58 (1971)
    545); the p-value is that of the likelihood ratio.
    """
    residual = problem.orthogonalise(problem.residual)
    if len(residual) % problem.n:
        return None
    y = _by_pose(problem, residual[:, None])
    basis = _by_pose(problem, problem.full_basis)
    likelihood = _Restricted.of(y[:_MOST_POSES], basis[:_MOST_POSES])
    if len(y) < LEAST_NUMBER or likelihood.degrees < LEAST_NUMBER:
        return None
    best = minimize_scalar(
        lambda value: -likelihood.log(value),
        bounds=(0.0, _LARGEST),
        method="bounded",
        options={"xatol": 1e-3},
    )
    value = float(best.x)
    ratio = 2 * (likelihood.log(value) - likelihood.log(0.0))
    p = float(norm.sf(np.sqrt(max(ratio, 0.0))))
    if p > DATA_FAULT_LEVEL:
        return None
    return SerialCorrelation(value, float(np.sqrt((1 - value**2) / likelihood.degrees)), p)


def prefers_term(base: Problem, with_term: Problem) -> bool:
    """Whether a model with a term and correlated noise is more probable than one with correlated noise alone.

    An unexplained step makes the residual correlated; the correlation is therefore estimated in both models. The
    instant of the term counts as one more parameter. Both problems have the same samples; the term is in the residual
    of the first and in the basis of the second.
    """
    gain = log_evidence(base, with_term) - log_evidence(base, base)
    pose_count = len(np.unique(base.pose))
    poses = min(pose_count, _MOST_POSES)
    coordinates = len(base.residual) // base.n
    return gain > 0.5 * np.log(poses * coordinates)


def log_evidence(base: Problem, model: Problem) -> float:
    """Log evidence of a model under noise with a correlation of its own, but for a constant of all models.

    Maximum likelihood of a first-order autoregression, a random walk at most, and the Bayesian information criterion
    (Schwarz, Ann. Stat. 6 (1978) 461). Differences between the samples of one pose have a variance of their own: only
    they show which of several reflectors moved (of up to 600 samples). base: the problem of the same samples whose
    residual all models explain; nan where its coordinates are not the same of all samples.
    """
    residual = base.orthogonalise(base.residual)
    if len(residual) % base.n:
        return float("nan")
    y = _by_pose(base, residual[:, None])[:_MOST_POSES]
    basis = _by_pose(model, model.full_basis)[:_MOST_POSES]
    if len(np.unique(base.pose)) < base.n <= _MOST_POSES:
        return _log_evidence_with_repeats(base, model, y, basis)
    fit = _Restricted.of(y, basis, degree=None)
    highest = max(fit.profile_log(value) for value in _GRID)
    return highest + 0.5 * fit.degrees * np.log(y.size)


def _log_evidence_with_repeats(base: Problem, model: Problem, y, basis) -> float:
    """`log_evidence` of means of poses, y (poses, coordinates), and of what samples deviate from these."""
    deviation = _from_pose_means(base, base.orthogonalise(base.residual)[:, None])[:, 0]
    deviation_basis = _from_pose_means(base, model.full_basis)
    counts = y.size, len(deviation) - y.size
    highest = -np.inf
    for value in _GRID:
        means, columns = (_Restricted.innovations(rows, value) for rows in (y, basis))
        flat = columns.reshape(y.size, -1)
        squares = _weighted_squares(means.ravel(), flat, deviation, deviation_basis, counts)
        log = -0.5 * sum(n * np.log(max(q, 1e-300)) for n, q in zip(counts, squares))
        highest = max(highest, log + 0.5 * y.shape[1] * np.log(1 - value**2))
    return highest - 0.5 * basis.shape[2] * np.log(len(deviation))


def _weighted_squares(y, columns, deviation, deviation_columns, counts) -> np.ndarray:
    """Sums of squares (2,) that the same coefficients leave of y and of deviations, each weighted by its variance."""
    squares = np.ones(2)
    for _ in range(_REWEIGHTED):
        root = np.sqrt(np.array(counts) / np.maximum(squares, 1e-300))
        rows = np.vstack([root[0] * columns, root[1] * deviation_columns])
        right = np.concatenate([root[0] * y, root[1] * deviation])
        coefficients = np.linalg.lstsq(rows, right, rcond=None)[0]
        remaining = y - columns @ coefficients, deviation - deviation_columns @ coefficients
        squares = np.array([(part**2).sum() for part in remaining])
    return squares


def _from_pose_means(problem: Problem, columns: np.ndarray) -> np.ndarray:
    """(N, K) columns less the mean over the samples of each pose, coordinate by coordinate."""
    _, label = np.unique(problem.pose, return_inverse=True)
    rows = columns.reshape(-1, problem.n, columns.shape[1]).transpose(1, 0, 2)
    means = np.zeros((label.max() + 1, *rows.shape[1:]))
    np.add.at(means, label, rows)
    means /= np.bincount(label)[:, None, None]
    return (rows - means[label]).transpose(1, 0, 2).reshape(columns.shape)


@dataclass(frozen=True)
class _Restricted:
    """Likelihood of a correlation for y (poses, coordinates) next to columns X (poses, coordinates, K)."""

    y: np.ndarray
    columns: np.ndarray

    @classmethod
    def of(cls, y: np.ndarray, basis: np.ndarray, degree: int | None = _DEGREE) -> "_Restricted":
        """Next to a basis and polynomials of every coordinate up to a degree, without those that the basis makes."""
        poses, coordinates = y.shape[:2]
        slow = np.ones((poses, 0))
        if degree is not None:
            time = np.linspace(-1, 1, poses)
            slow = np.polynomial.legendre.legvander(time, degree)
        by_coordinate = np.einsum("pd,ce->pcde", slow, np.eye(coordinates))
        trends = by_coordinate.reshape(y.size, -1)
        flat = basis.reshape(y.size, -1)
        vectors, sizes, _ = np.linalg.svd(flat, full_matrices=False)
        least_size = NEGLIGIBLE_SHARE * sizes.max(initial=0.0)
        known = vectors[:, sizes > least_size]
        trends = trends / np.linalg.norm(trends, axis=0)
        remaining = trends - known @ (known.T @ trends)
        vectors, sizes, _ = np.linalg.svd(remaining, full_matrices=False)
        known = np.hstack([known, vectors[:, sizes > NEGLIGIBLE_SHARE]])
        return cls(y[..., 0], known.reshape(poses, coordinates, -1))

    @property
    def degrees(self) -> int:
        return self.y.size - self.columns.shape[2]

    def log(self, value: float) -> float:
        """Restricted log likelihood, the variance at its best; first-order autoregression, stationary at the start."""
        squares, triangle = self._left(value)
        spread = self.degrees * np.log(squares)
        diagonal = np.abs(np.diag(triangle))
        mixing = 2 * np.log(diagonal).sum()
        scale = self._log_scale(value)
        return -0.5 * (spread + mixing - scale)

    def _log_scale(self, value: float) -> float:
        """Log determinant of the innovations: the first pose of each coordinate varies more than they do."""
        return self.y.shape[1] * np.log(1 - value**2)

    def profile_log(self, value: float) -> float:
        """Log likelihood, columns and variance at their best: unlike the restricted one, comparable between columns."""
        squares, _ = self._left(value)
        spread = self.y.size * np.log(squares)
        scale = self._log_scale(value)
        return -0.5 * (spread - scale)

    def _left(self, value: float) -> tuple[float, np.ndarray]:
        """Sum of squares of the innovations that the columns leave, and the triangle R of the columns' innovations."""
        y, columns = (self.innovations(rows, value) for rows in (self.y, self.columns))
        flat = columns.reshape(y.size, -1)
        orthonormal, triangle = np.linalg.qr(flat)
        coefficients = orthonormal.T @ y.ravel()
        residual = y.ravel() - orthonormal @ coefficients
        return float(residual @ residual), triangle

    @staticmethod
    def innovations(rows: np.ndarray, value: float) -> np.ndarray:
        """Rows (poses, ...) less `value` times those of the pose before; the first in units of their variance."""
        innovations = rows.copy()
        innovations[0] *= np.sqrt(1 - value**2)
        innovations[1:] -= value * rows[:-1]
        return innovations


def _by_pose(problem: Problem, columns: np.ndarray) -> np.ndarray:
    """(poses, coordinates, K) mean over the samples of each pose, in order of time, of columns (N, K)."""
    poses, first, label = np.unique(problem.pose, return_index=True, return_inverse=True)
    count = np.bincount(label)
    coordinates = len(columns) // problem.n
    rows = columns.reshape(coordinates, problem.n, -1)
    sums = np.zeros((len(poses), coordinates, rows.shape[2]))
    np.add.at(sums, label, rows.transpose(1, 0, 2))
    means = sums / np.sqrt(count)[:, None, None]
    in_time = np.argsort(problem.order[first], kind="stable")
    return means[in_time]
