"""A ball whose points share errors: those of a step's light plane are estimated with it, under their covariance."""

from dataclasses import dataclass

import numpy as np

from sensors.ball.solve import Linear, Loss, Problem, Solved, linearise, memory, spread

# Steps in all, and those in which spread and memory still change: they jump, and the fit would follow them for ever.
_STEPS, _SETTLE = 40, 8


@dataclass(frozen=True)
class Shared:
    """Errors that all points of a group share, as those of the light plane of a step.

    `labels` (n,) int from 0 to G - 1; `derivative` (k, d, n) mm by which a point moves for one unit
    of each of the k errors of its group; `covariance` (k G, k G), group after group, singular
    where groups err together (the planes of one mirror).
    """

    labels: np.ndarray
    derivative: np.ndarray
    covariance: np.ndarray

    def some(self, chosen: np.ndarray) -> "Shared":
        """Of the chosen points, and of their groups alone."""
        k = len(self.derivative)
        groups, labels = np.unique(np.asarray(self.labels)[chosen], return_inverse=True)
        rows = (groups[:, None] * k + np.arange(k)).ravel()
        return Shared(labels, self.derivative[..., chosen], np.asarray(self.covariance)[np.ix_(rows, rows)])


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the ball and of the groups' errors, data only: (p, p), (p, kG), (kG, kG), (p,), (kG,)."""

    ball: np.ndarray
    between: np.ndarray
    groups: np.ndarray
    pull: np.ndarray
    pull_groups: np.ndarray


def solve_shared(problem: Problem, solved: Solved, loss: Loss, shared: Shared,
                 ordered: bool = False) -> tuple[Solved, np.ndarray]:  # fmt: skip
    """The fit with the groups' errors, and the covariance (size, size) of what was fitted.

    Generalised least squares: the errors are parameters with their covariance as prior (Henderson,
    Biometrics 31, 1975), so that no stripe counts for more than its plane is known. The spread and
    the robust weights are those of the points' own errors. ordered: points follow one another along
    stripes, and their own errors, grains of speckle, last for several: they count for fewer.
    """
    values, at, errors = solved.values, solved.at, np.zeros(len(shared.covariance))
    by_error, keep = _by_error(at, shared), solved.keep
    k = len(by_error)
    for turn in range(_STEPS):
        own = at.residual / at.sigma - _shift(by_error, errors, shared.labels)
        if turn < _SETTLE:
            keep = solved.keep & np.isfinite(own)
            scale = max(spread(own[keep], problem.size), 1e-12 * values[-1])
        weight = loss(own / scale)[0]
        if turn < _SETTLE:
            # at first the groups' errors are still in the residuals, and last as long as a stripe
            lasting = memory(own[keep & (weight > 0)]) if ordered and turn > 0 else 1.0
        weight = keep * weight / (scale**2 * lasting)
        normal = _normal(at, problem.size, by_error, weight, shared.labels, k)
        move, errors = _move(normal, shared.covariance)
        values = values.copy()
        values[: problem.size] += move
        at = linearise(problem, values)
        keep = keep & np.isfinite(at.residual)
        step = float(np.sqrt(move @ normal.ball @ move))
        if step < 3e-3 and turn > 1:
            break
    own = at.residual / at.sigma - _shift(by_error, errors, shared.labels)
    made = Solved(values, scale, keep, at, own, step)
    return made, _covariance(problem, made, by_error, loss, shared, lasting)


def _by_error(at: Linear, shared: Shared) -> np.ndarray:
    """(k, n) change of the whitened residuals for one unit of each error of their group."""
    d = shared.derivative.shape[1]
    return np.einsum("dn,kdn->kn", at.rows[:d], shared.derivative) / at.sigma


def _shift(by_error, errors, labels):
    return (by_error * errors.reshape(-1, len(by_error))[labels].T).sum(0)


def _normal(at, size, by_error, weight, labels, k) -> _Normal:
    rows = at.rows[:size] / at.sigma
    residual = np.where(weight > 0, at.residual / at.sigma, 0)
    count = labels.max() + 1

    def sums(each):  # (len(each), kG): over each group, times how its errors move the residuals
        made = np.array([[np.bincount(labels, one * error, count) for error in by_error] for one in each])
        return made.transpose(0, 2, 1).reshape(len(each), -1)

    blocks = sums(by_error * weight).reshape(k, count, k)
    groups = np.zeros((count, k, count, k))
    groups[np.arange(count), :, np.arange(count)] = blocks.transpose(1, 0, 2)
    return _Normal((rows * weight) @ rows.T, sums(rows * weight), groups.reshape(count * k, -1),
                   rows @ (weight * residual), sums((weight * residual)[None])[0])  # fmt: skip


def _inner(normal, covariance):
    """(kG, kG) inverse of the groups' normal matrix with their prior; no inverse of the covariance is needed."""
    return covariance @ np.linalg.inv(np.eye(len(covariance)) + normal.groups @ covariance)


def _move(normal, covariance):
    """Step (p,) of the ball, and errors (kG,) of the groups."""
    inner = _inner(normal, covariance)
    schur = normal.ball - normal.between @ inner @ normal.between.T
    pull = normal.pull - normal.between @ inner @ normal.pull_groups
    move = np.linalg.lstsq(schur, pull, rcond=1e-14)[0]
    return move, inner @ (normal.pull_groups - normal.between.T @ move)


def _covariance(problem, solved, by_error, loss, shared, lasting):
    """(size, size), from the spread that the points' own errors show, over the degrees of freedom left to them."""
    weight, slope = loss(solved.white / solved.spread)
    used = solved.keep & (weight > 0)
    variance = lasting * np.square(weight[used] * solved.white[used]).mean() / slope[used].mean() ** 2

    def normal(variance):
        return _normal(solved.at, problem.size, by_error, used / variance, shared.labels, len(by_error))

    first = normal(variance)
    spent = np.trace(_inner(first, shared.covariance) @ first.groups)
    independent = used.sum() / lasting
    last = normal(variance * independent / max(independent - problem.size - spent, 1))
    schur = last.ball - last.between @ _inner(last, shared.covariance) @ last.between.T
    return np.linalg.pinv(schur, hermitian=True)
