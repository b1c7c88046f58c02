"""A ball whose points share errors: those of a step's light plane are estimated with it, under their covariance.

What the points of a stripe share beyond that (grains of speckle longer than a row, uneven light) is of
unknown size: its variance is estimated from the ball itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from sensors.ball.solve import Linear, Loss, Problem, Solved, linearise, memory, spread
from sensors.variance_components import estimate_components
from workbench.core.least_squares.linear_algebra import inverse_positive, solve_positive

# Steps in all, and those in which spread and memory still change: they jump, and the fit would follow them for ever.
_STEPS, _SETTLE = 40, 8
# rounds of the variances, and by which part of them they may still change
_ROUNDS, _CONVERGED = 6, 0.05
_LEAST_LEFT = 0.5
"""Share of the points with a weight that keep one in a step of the fit; a longer step is halved."""
_HALVINGS = 12
_CONVERGED_STEP = 3e-3
"""Standard deviations, of a step below which the fit ends."""


@dataclass(frozen=True)
class Common:
    """Errors that all points share, whatever their group, as those of the camera's values.

    `derivative` (m, 3, n) mm by which a point moves for one unit of each of m errors; `covariance` (m, m); `by_group`
    (m, G, k) their covariance with the first k errors of each group of a `Shared`. They are too few and act too evenly
    for one ball to tell them, so they are not estimated with it: its covariance includes them.
    """

    derivative: np.ndarray
    covariance: np.ndarray
    by_group: np.ndarray

    def subset(self, chosen: np.ndarray, groups: np.ndarray) -> "Common":
        """Of the chosen points and groups."""
        return Common(self.derivative[..., chosen], self.covariance, self.by_group[:, groups])


@dataclass(frozen=True)
class Shared:
    """Errors that all points of a group share, as those of the light plane of a step.

    `labels` (n,) int from 0 to G - 1; `derivative` (k, 3, n) mm by which a point moves for one unit
    of each of the k errors of its group; `covariance` (k G, k G), group after group, singular
    where groups err together (the planes of one mirror). `unknown` (m, 3, n), as `derivative`, of
    errors that each group has of its own, each kind of one variance, which is not known. `common`: errors that all
    groups share.
    """

    labels: np.ndarray
    derivative: np.ndarray
    covariance: np.ndarray
    unknown: np.ndarray | None = None
    common: Common | None = None

    def subset(self, chosen: np.ndarray) -> "Shared":
        """Of the chosen points, and of their groups alone."""
        k = len(self.derivative)
        groups, labels = np.unique(np.asarray(self.labels)[chosen], return_inverse=True)
        rows = (groups[:, None] * k + np.arange(k)).ravel()
        return Shared(
            labels,
            self.derivative[..., chosen],
            np.asarray(self.covariance)[np.ix_(rows, rows)],
            None if self.unknown is None else self.unknown[..., chosen],
            None if self.common is None else self.common.subset(chosen, groups),
        )

    def with_errors(self, derivative: np.ndarray, variance: np.ndarray) -> "Shared":
        """The same with m more errors of known variance (m,), independent from group to group; derivative (m, 3, n)."""
        k = len(self.derivative)
        m = len(variance)
        groups = len(self.covariance) // k
        full = np.zeros((groups, k + m, groups, k + m))
        full[:, :k, :, :k] = np.reshape(self.covariance, (groups, k, groups, k))
        group_index = np.arange(groups)
        for kind in range(m):
            full[group_index, k + kind, group_index, k + kind] = variance[kind]
        return replace(
            self,
            derivative=np.concatenate([self.derivative, derivative]),
            covariance=full.reshape(groups * (k + m), -1),
        )

    def with_common(self, derivative: np.ndarray, covariance: np.ndarray) -> "Shared":
        """The same with m more errors of known covariance (m, m) that all groups share; derivative (m, 3, n)."""
        k = len(self.derivative)
        m = len(covariance)
        if self.common is None:
            independent = np.zeros((m, len(self.covariance) // k, k))
            return replace(self, common=Common(derivative, covariance, independent))
        before = self.common
        independent = np.zeros((m, *before.by_group.shape[1:]))
        return replace(
            self,
            common=Common(
                np.concatenate([before.derivative, derivative]),
                block_diag(before.covariance, covariance),
                np.concatenate([before.by_group, independent]),
            ),
        )

    def with_variances(self, variance: np.ndarray) -> "Shared":
        """The same with the variances (m,) of the unknown ones."""
        k = len(self.derivative)
        m = len(variance)
        groups = int(self.labels.max()) + 1
        full = np.zeros((groups, k + m, groups, k + m))
        full[:, :k, :, :k] = self.covariance.reshape(groups, k, groups, k)
        for kind in range(m):
            full[np.arange(groups), k + kind, np.arange(groups), k + kind] = variance[kind]
        return Shared(
            self.labels,
            np.concatenate([self.derivative, self.unknown]),
            full.reshape(groups * (k + m), -1),
            common=self.common,
        )


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the ball and of the groups' errors, data only: (p, p), (p, kG), (kG, kG), (p,), (kG,)."""

    ball: np.ndarray
    ball_by_groups: np.ndarray
    groups: np.ndarray
    pull: np.ndarray
    pull_groups: np.ndarray


def solve_shared(
    problem: Problem, solved: Solved, loss: Loss, shared: Shared, ordered: bool = False
) -> tuple[Solved, np.ndarray]:
    """The fit with the groups' errors, and the covariance (size, size) of what was fitted.

    Generalised least squares: the errors are parameters with their covariance as prior (Henderson,
    Biometrics 31, 1975), so that no stripe counts for more than its plane is known. The spread and
    the robust weights are those of the points' own errors. ordered: points follow one another along
    stripes, and their own errors, grains of speckle, last for several: they count for fewer.
    """
    fit = _solve(problem, solved, loss, shared, ordered)
    if shared.unknown is None:
        return fit[:2]
    variance = np.zeros(len(shared.unknown))
    for _ in range(_ROUNDS):
        before = variance
        variance = _variances(problem, fit[0], shared, fit[2])
        if (np.abs(variance - before) <= _CONVERGED * (variance + before)).all():
            break
        start = replace(solved, values=fit[0].values, linear=fit[0].linear)
        fit = _solve(problem, start, loss, shared.with_variances(variance), ordered)
    return fit[:2]


def _variances(problem, solved, shared, weight):
    """(m,) variances of the unknown errors to count on, by restricted maximum likelihood (`estimate_components`).

    R and g are those of the points' weights W, less what ball and known errors, with derivatives A and
    covariance K, take: Z'W Z - Z'W A K A'W Z and Z'W r - Z'W A K A'W r.
    """
    known = _by_error(solved.linear, shared)
    unknown = _by_error(solved.linear, replace(shared, derivative=shared.unknown))
    k = len(known)
    m = len(unknown)
    groups = int(shared.labels.max()) + 1
    normal = _normal(
        solved.linear, problem.size, np.concatenate([known, unknown]), weight, shared.labels, k + m
    )
    kind = np.tile(np.arange(k + m), groups)
    old = kind < k
    new = kind >= k
    part = _Normal(
        normal.ball,
        normal.ball_by_groups[:, old],
        normal.groups[np.ix_(old, old)],
        normal.pull,
        normal.pull_groups[old],
    )
    absorbed = np.concatenate([normal.ball_by_groups[:, new], normal.groups[np.ix_(old, new)]])
    correction = absorbed.T @ _posterior(part, shared.covariance)
    new_block = normal.groups[np.ix_(new, new)] - correction @ absorbed
    pull = normal.pull_groups[new] - correction @ np.concatenate([part.pull, part.pull_groups])
    return estimate_components(new_block, pull, kind[new] - k).expected


def _posterior(normal, covariance):
    """(p + kG, p + kG) covariance of ball and known errors."""
    inner = _inner(normal, covariance)
    mixed = normal.ball_by_groups @ inner
    ball = inverse_positive(normal.ball - mixed @ normal.ball_by_groups.T)
    return np.block([[ball, -ball @ mixed], [-mixed.T @ ball, inner + mixed.T @ ball @ mixed]])


def _solve(problem, solved, loss, shared, ordered):
    """The fit, its covariance, and the points' weights, with errors of known covariance alone."""
    values = solved.values
    linear = solved.linear
    errors = np.zeros(len(shared.covariance))
    by_error = _by_error(linear, shared)
    keep = solved.keep
    k = len(by_error)
    for iteration in range(_STEPS):
        whitened = linear.residual / linear.sigma - _shift(by_error, errors, shared.labels)
        if iteration < _SETTLE:
            keep = solved.keep & np.isfinite(whitened)
            scale = max(spread(whitened[keep], problem.size), 1e-12 * values[-1])
        weight = loss(whitened / scale)[0]
        if iteration < _SETTLE:
            # at first the groups' errors are still in the residuals, and last as long as a stripe
            lasting = memory(whitened[keep & (weight > 0)]) if ordered and iteration > 0 else 1.0
        weight = keep * weight / (scale**2 * lasting)
        normal = _normal(linear, problem.size, by_error, weight, shared.labels, k)
        move = _move(normal, shared.covariance)
        step = float(np.sqrt(move @ normal.ball @ move))
        for _ in range(_HALVINGS):
            moved = _moved(problem, values, move)
            errors = _errors(normal, shared.covariance, move)
            if _counts_on(moved, by_error, errors, shared.labels, loss, scale, weight):
                break
            move = move / 2
        values, linear = moved
        keep = keep & np.isfinite(linear.residual)
        if step < _CONVERGED_STEP and iteration > 1:
            break
    whitened = linear.residual / linear.sigma - _shift(by_error, errors, shared.labels)
    with_errors = Solved(values, scale, keep, linear, whitened, step)
    return with_errors, _covariance(problem, with_errors, by_error, loss, shared, lasting), weight


def _by_error(linear: Linear, shared: Shared) -> np.ndarray:
    """(k, n) change of the whitened residuals for one unit of each error of their group."""
    d = shared.derivative.shape[1]
    return np.einsum("dn,kdn->kn", linear.rows[:d], shared.derivative) / linear.sigma


def _shift(by_error, errors, labels):
    return (by_error * errors.reshape(-1, len(by_error))[labels].T).sum(0)


def _normal(linear, size, by_error, weight, labels, k) -> _Normal:
    rows = linear.rows[:size] / linear.sigma
    residual = np.where(weight > 0, linear.residual / linear.sigma, 0)
    count = labels.max() + 1

    def sums(
        weighted_rows,
    ):  # (len(each), kG): over each group, times how its errors move the residuals
        sums = np.array(
            [
                [np.bincount(labels, row * error, count) for error in by_error]
                for row in weighted_rows
            ]
        )
        return sums.transpose(0, 2, 1).reshape(len(weighted_rows), -1)

    blocks = sums(by_error * weight).reshape(k, count, k)
    groups = np.zeros((count, k, count, k))
    groups[np.arange(count), :, np.arange(count)] = blocks.transpose(1, 0, 2)
    return _Normal(
        (rows * weight) @ rows.T,
        sums(rows * weight),
        groups.reshape(count * k, -1),
        rows @ (weight * residual),
        sums((weight * residual)[None])[0],
    )


def _inner(normal, covariance):
    """(kG, kG) inverse of the groups' normal matrix with their prior; no inverse of the covariance is needed."""
    return covariance @ np.linalg.inv(np.eye(len(covariance)) + normal.groups @ covariance)


def _move(normal, covariance):
    """Step (p,) of the ball."""
    inner = _inner(normal, covariance)
    schur = normal.ball - normal.ball_by_groups @ inner @ normal.ball_by_groups.T
    pull = normal.pull - normal.ball_by_groups @ inner @ normal.pull_groups
    return solve_positive(schur, pull)


def _errors(normal, covariance, move):
    """Errors (kG,) of the groups after a step (p,) of the ball."""
    return _inner(normal, covariance) @ (normal.pull_groups - normal.ball_by_groups.T @ move)


def _moved(problem, values, move) -> tuple[np.ndarray, Linear]:
    """Centre and radius after a step (p,), and the residuals there."""
    values = values.copy()
    values[: problem.size] += move
    return values, linearise(problem, values)


def _counts_on(moved, by_error, errors, labels, loss: Loss, scale: float, weight) -> bool:
    """Whether after a step most of the points still have a weight that had one before it.

    A step along a direction that few stripes hardly determine may be longer than the linearisation is valid, and a
    redescending loss does not bring back the points that it leaves.
    """
    linear = moved[1]
    whitened = linear.residual / linear.sigma - _shift(by_error, errors, labels)
    counted = np.isfinite(whitened) & (loss(whitened / scale)[0] > 0)
    return counted[weight > 0].sum() >= _LEAST_LEFT * (weight > 0).sum()


def _covariance(problem, solved, by_error, loss, shared, lasting):
    """(size, size), from the spread that the points' own errors show, over the degrees of freedom left to them."""
    weight, slope = loss(solved.white / solved.spread)
    used = solved.keep & (weight > 0)
    variance = (
        lasting * np.square(weight[used] * solved.white[used]).mean() / slope[used].mean() ** 2
    )

    def normal(variance):
        return _normal(
            solved.linear, problem.size, by_error, used / variance, shared.labels, len(by_error)
        )

    first = normal(variance)
    degrees_used = np.trace(_inner(first, shared.covariance) @ first.groups)
    independent = used.sum() / lasting
    variance = variance * independent / max(independent - problem.size - degrees_used, 1)
    last = normal(variance)
    mixed = last.ball_by_groups @ _inner(last, shared.covariance)
    ball_covariance = inverse_positive(last.ball - mixed @ last.ball_by_groups.T)
    if shared.common is None:
        return ball_covariance
    by_group = ball_covariance @ (last.ball_by_groups - mixed @ last.groups)
    by_common = ball_covariance @ _pull_of_common(
        problem, solved.linear, by_error, used / variance, shared, mixed
    )
    return ball_covariance + _by_common(shared.common, by_common, by_group)


def _pull_of_common(problem, linear: Linear, by_error, weight, shared: Shared, mixed) -> np.ndarray:
    """(size, m) right-hand side of the ball's normal equations for one unit of each common error."""
    common = _by_error(linear, replace(shared, derivative=shared.common.derivative)) * weight
    rows = linear.rows[: problem.size] / linear.sigma
    count = int(shared.labels.max()) + 1
    pull = np.empty((count, len(by_error), len(common)))
    for kind, error in enumerate(by_error):
        for m, row in enumerate(common):
            pull[:, kind, m] = np.bincount(shared.labels, error * row, count)
    return rows @ common.T - mixed @ pull.reshape(-1, len(common))


def _by_common(common: Common, moves: np.ndarray, by_group: np.ndarray) -> np.ndarray:
    """(size, size) that common errors add to a covariance which holds those of the groups.

    moves (size, m) and by_group (size, k G): how what was fitted moves with either.
    """
    m, groups, known = common.by_group.shape
    ball_rows = by_group.reshape(len(by_group), groups, -1)[..., :known].reshape(len(by_group), -1)
    mixed = moves @ common.by_group.reshape(m, -1) @ ball_rows.T
    return moves @ common.covariance @ moves.T + mixed + mixed.T
