"""Starting values of one or two rotations and of translations: regularised least squares from many starts.

Every kind of measurement that knows a base and a tool closes its chain by equations that are linear in
the entries of the unknown rotation matrices and in the unknown translations:

    A_1 vec(X_1) + A_2 vec(X_2) + B t = c,    X_k in SO(3).

A closed form that drops the constraint on X_k (Kronecker form of robot-world/hand-eye calibration: Shah,
J. Mech. Robotics 5 (2013) 031007) degenerates where the flange orientations are nearly equal: noise then
decides the null vector. Here all equations, those of positions and those of orientations, are solved together
on SO(3). The translations are eliminated (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10
(1973) 413), which leaves at most 18 columns however many samples there are, so that descents from many
rotations cost little. A weak prior on the translations keeps what the samples do not determine finite.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from workbench.core import deadline
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.rigid import icosahedral_rotations, nearest_rotation, rotation_matrix

TOOL_PRIOR_MM = 500.0
"""1 sigma of a coordinate of the tool on the flange, before anything is measured."""
ORIGIN_PRIOR_MM = 1e4
"""1 sigma of a coordinate of the base, relative to the centroids of the samples."""
MODEL_ERROR_MM = 1.0
"""Position error of a nominal arm that the rows are scaled by."""
LEAST_LEVER_MM = 100.0
"""Orientation errors weigh at least as much as two points that are this far apart."""

_SCREENED = 48
_KEPT = 8
_ALTERNATIVES = 4
_SHORT = 10
_LONG = 60
_QUICK = 4
_QUICK_STEPS = 8
_ROUNDS = 12
_CENTRED = 2
_SETTLED_RAD = 1e-8
_SETTLED_MM = 1e-7
_SAME_RAD = np.deg2rad(3.0)
_AS_WELL = 9.0
_BARRIER = 100.0
_LEAST_RAD = 1e-12
_FLAT_RAD = 1e-9
_FLAT = 1e-14
"""Relative fall of the cost that rounding hides: a step that should make less, and fails, ends a descent."""
_CONVEX = 1e-6  # of the mean diagonal, that the least eigenvalue of a Hessian exceeds
_LEAST_VARIANCE = 1e-4
_WEAKER = 1e3
_CAUCHY = 6.0  # robust standard deviations at which a sample's weight is one half


@dataclass(frozen=True)
class Start:
    """A local minimum: `rotations` (K, 3, 3), `translations` (F,) mm, and the sum of squares `cost`."""

    rotations: np.ndarray
    translations: np.ndarray
    cost: float

    def is_near(self, other: "Start") -> bool:
        """Whether another round moved neither the rotations nor the translations by what matters to a start."""
        angle = _angle_between(self.rotations, other.rotations)
        shifted = np.abs(self.translations - other.translations).max(initial=0.0)
        return angle < _SETTLED_RAD and shifted < _SETTLED_MM


@dataclass(frozen=True)
class RotationSystem:
    """Whitened equations of n samples with m rows each.

    `rotation_rows` (n, m, 9 K): columns of the row-major entries of K rotations; `translation_rows` (n, m, F);
    `right` (n, m); `prior` (F,) 1 sigma of each translation around 0, mm.
    """

    rotation_rows: np.ndarray
    translation_rows: np.ndarray
    right: np.ndarray
    prior: np.ndarray

    @property
    def count(self) -> int:
        """Number K of rotations."""
        return self.rotation_rows.shape[2] // 9

    def with_orientations(self, rows: np.ndarray) -> "RotationSystem":
        """The system of one rotation with rows (n, k, 18) on it and on a second one; their right side is 0."""
        samples, size, _ = rows.shape
        alone = np.concatenate([self.rotation_rows, np.zeros_like(self.rotation_rows)], 2)
        none = np.zeros((samples, size, len(self.prior)))
        return RotationSystem(
            np.concatenate([alone, rows], 1),
            np.concatenate([self.translation_rows, none], 1),
            np.concatenate([self.right, np.zeros((samples, size))], 1),
            self.prior,
        )

    def starts(self) -> list[Start]:
        """Local minima, best first; never empty, whatever the samples determine.

        After the first round samples that disagree with the best minimum are given less weight, and the prior
        is centred where the translations were found, so that it does not bias what the samples do determine.
        """
        deadline.check()
        weights = np.ones(len(self.right))
        centre = np.zeros(len(self.prior))
        found = None
        for done in range(_ROUNDS):
            reduced = _Reduced(self, weights, centre)
            if found is None:
                begin = reduced.screened()
            else:
                begin = np.stack([s.rotations for s in found])
            before = found
            found = reduced.minima(begin, is_near=found is not None)
            if before is not None and found[0].is_near(before[0]):
                break
            weights = self._robust_weights(found[0])
            centre = found[0].translations if done < _CENTRED else centre
        return found

    def alternatives(self) -> list[Start]:
        """The best minimum, and every other one that fits as well with another base; one alone where there is none.

        As well: the sum of squares grows by less than `_AS_WELL` times the variance of a row. Minima that are
        joined by a valley are one solution that the samples do not determine, and no alternatives.
        """
        found = self.starts()
        best = found[0]
        # the prior is centred at the best one and must not decide against the others
        weak = replace(self, prior=_WEAKER * self.prior)
        reduced = _Reduced(weak, self._robust_weights(best), best.translations)
        degrees = self.right.size - 3 * self.count - len(self.prior)
        lowest = float(reduced.cost(best.rotations[None])[0])
        variance = max(lowest / max(degrees, 1), _LEAST_VARIANCE)
        equal = []
        for other in found[1:]:
            base = _angle_between(best.rotations[:1], other.rotations[:1])
            rise = float(reduced.cost(other.rotations[None])[0]) - lowest
            barrier = (
                float(reduced.cost(_interpolated(best.rotations, other.rotations)).max()) - lowest
            )
            if base > _SAME_RAD and rise < _AS_WELL * variance and barrier > _BARRIER * variance:
                equal.append(other)
        return [best, *equal]

    def quick_distances(self) -> np.ndarray:
        """(n,) distance of each sample, in units of the rows, at the best minimum from a few starts.

        One round without robust weights: enough to compare many hypotheses about the same samples.
        """
        return quick_distances([self])[0]

    def _reduced(self) -> "_Reduced":
        """The equations under equal weights."""
        deadline.check()
        return _Reduced(self, np.ones(len(self.right)), np.zeros(len(self.prior)))

    def _distances_at_best(self, reduced: "_Reduced", rotations: np.ndarray) -> np.ndarray:
        """(n,) distances at the best of S sets of rotations (S, K, 3, 3)."""
        best = rotations[int(np.argmin(reduced.cost(rotations)))]
        return self._distances(best, reduced.translations(best))

    def _distances(self, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
        """(n,) lengths of the residuals of the samples."""
        gap = (
            self.rotation_rows @ rotations.ravel()
            + self.translation_rows @ translations
            - self.right
        )
        return np.linalg.norm(gap, axis=1)

    def _robust_weights(self, start: Start) -> np.ndarray:
        """(n,) Cauchy weights of the samples from their distance at a start."""
        distance = self._distances(start.rotations, start.translations)
        sigma = MEDIAN_TO_SIGMA * np.median(distance)
        return 1 / (1 + (distance / max(_CAUCHY * sigma, 1e-9)) ** 2)


class _Reduced:
    """The equations without their translations: W [vec(X_1), ..., vec(X_K), 1] with few rows, by one QR."""

    def __init__(self, system: RotationSystem, weights: np.ndarray, centre: np.ndarray):
        self.count, free = system.count, len(system.prior)
        rows = np.concatenate(
            [system.translation_rows, system.rotation_rows, -system.right[:, :, None]], 2
        )
        rows = (rows * np.sqrt(weights)[:, None, None]).reshape(-1, rows.shape[2])
        prior = np.zeros((free, rows.shape[1]))
        prior[:, :free] = np.diag(1 / system.prior)
        prior[:, -1] = -centre / system.prior
        triangle = np.linalg.qr(np.concatenate([rows, prior]), mode="r")
        self.rows = triangle[free:, free:]
        self._translation = triangle[:free, :free]
        self._coupling = triangle[:free, free:]

    def translations(self, rotations: np.ndarray) -> np.ndarray:
        """(F,) best translations for rotations (K, 3, 3); the prior keeps the triangle regular."""
        return -np.linalg.solve(
            self._translation, self._coupling @ np.append(rotations.ravel(), 1.0)
        )

    def residual(self, rotations: np.ndarray) -> np.ndarray:
        """(S, r) residuals at S sets of rotations (S, K, 3, 3)."""
        return rotations.reshape(len(rotations), -1) @ self.rows[:, :-1].T + self.rows[:, -1]

    def cost(self, rotations: np.ndarray) -> np.ndarray:
        """(S,) sums of squares."""
        return (self.residual(rotations) ** 2).sum(1)

    def screened(self) -> np.ndarray:
        """(S, K, 3, 3) rotations to descend from: the closed form, then the best of a grid over SO(3)^K."""
        grid = icosahedral_rotations()
        if self.count == 1:
            start_sets = grid[:, None]
        else:
            start_sets = self._best_pairs(grid)
        order = np.argsort(self.cost(start_sets), kind="stable")[:_SCREENED]
        return np.concatenate([self._closed_form()[None], start_sets[order]])

    def _best_pairs(self, grid: np.ndarray) -> np.ndarray:
        """(S, 2, 3, 3): for every rotation of the grid at either place, the best partner from the grid."""
        size = len(grid)
        flat = grid.reshape(size, 9)
        first = flat @ self.rows[:, :9].T + self.rows[:, 18]
        second = flat @ self.rows[:, 9:18].T
        # |a + b|^2 = |a|^2 + |b|^2 + 2 a b for all pairs at once
        cost = (first**2).sum(1)[:, None] + (second**2).sum(1) + 2 * first @ second.T
        partners = np.zeros((size, size), bool)
        partners[np.arange(size), cost.argmin(1)] = True
        partners[cost.argmin(0), np.arange(size)] = True
        return grid[np.argwhere(partners)]

    def _closed_form(self) -> np.ndarray:
        """(K, 3, 3) least squares over matrices without the constraint, then the nearest rotations."""
        free = np.linalg.lstsq(self.rows[:, :-1], -self.rows[:, -1], rcond=1e-9)[0]
        return nearest_rotation(free.reshape(-1, 3, 3))

    def minima(self, begin: np.ndarray, is_near: bool) -> list[Start]:
        """Distinct local minima reached from rotations (S, K, 3, 3), best first.

        is_near: `begin` are minima under slightly other weights.
        """
        rotations = self._distinct(self.descended(begin, _SHORT, by_newton=is_near))
        rotations = self._distinct(self.descended(rotations[:_KEPT], _LONG, by_newton=True))
        return self._starts(rotations[:_ALTERNATIVES])

    def _distinct(self, rotations: np.ndarray) -> np.ndarray:
        """(D, K, 3, 3) those of S sets that differ from every better one, the best first."""
        order = np.argsort(self._rounded_cost(rotations), kind="stable")
        rotations = rotations[order]
        differs = _angle_between(rotations[:, None], rotations) > _SAME_RAD
        is_candidate = np.ones(len(rotations), bool)
        distinct = []
        while is_candidate.any():
            distinct.append(int(np.argmax(is_candidate)))
            is_candidate &= differs[distinct[-1]]
            is_candidate[distinct[-1]] = False
        return rotations[distinct]

    def _rounded_cost(self, rotations: np.ndarray) -> np.ndarray:
        """(S,) costs in which rounding decides no order: of equal minima the first start wins."""
        cost = self.cost(rotations)
        unit = max(1e-6 * cost.min(), 1e-9)
        return np.floor(cost / unit)

    def _starts(self, rotations: np.ndarray) -> list[Start]:
        """Translations and cost of each of S sets of rotations (S, K, 3, 3)."""
        cost = self.cost(rotations)
        return [
            Start(rotation_set, self.translations(rotation_set), float(cost[i]))
            for i, rotation_set in enumerate(rotations)
        ]

    @cached_property
    def _linear(self) -> np.ndarray:
        """(9 K, (3 K + 1) r): maps vec(X) to the derivatives of the residual by left rotations, then to the residual.

        d vec(X) / d omega_j = vec([e_j]x X) is linear in X, too.
        """
        coefficients = np.zeros((self.count, 3, 3, 3 * self.count + 1, len(self.rows)))
        for k in range(self.count):
            sample_rows = self.rows[:, 9 * k : 9 * k + 9].reshape(-1, 3, 3)
            coefficients[k, :, :, 3 * k : 3 * k + 3] = np.einsum(
                "jab,rac->bcjr", _GENERATORS, sample_rows
            )
            coefficients[k, :, :, -1] = sample_rows.transpose(1, 2, 0)
        return coefficients.reshape(9 * self.count, -1)

    def _products(self, rotations: np.ndarray) -> np.ndarray:
        """(S, 3 K + 1, 3 K + 1) inner products of the columns of the Jacobian (rad) and, last, of the residual."""
        right = self.rows[None, None, :, -1]
        return _inner_products(self._linear[None], right, rotations)

    def _second_order(self, rotations: np.ndarray) -> np.ndarray:
        """(S, 3 K, 3 K) second derivatives of the residual, weighted by the residual.

        With P = X G', G the derivative of half the cost by X, each rotation adds sym(P) - tr(P) I.
        """
        slope = (self.residual(rotations) @ self.rows[:, :-1]).reshape(rotations.shape)
        product = rotations @ slope.swapaxes(2, 3)
        trace = np.trace(product, axis1=2, axis2=3)[:, :, None, None]
        second_order = (product + product.swapaxes(2, 3)) / 2 - trace * np.eye(3)
        hessian = np.zeros((len(rotations), 3 * self.count, 3 * self.count))
        for k in range(self.count):
            hessian[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = second_order[:, k]
        return hessian

    def descended(self, rotations: np.ndarray, steps: int, by_newton: bool = False) -> np.ndarray:
        """Levenberg-Marquardt on SO(3)^K from S starts (S, K, 3, 3) at once; those that have converged rest.

        by_newton: with the second derivatives of the residual where they leave the cost convex. Large residuals, as of
        a hypothesis that does not hold, otherwise make the last digits slow.
        """
        found = rotations.copy()
        moving = np.arange(len(rotations))
        state = _Descent(rotations, self._products(rotations), np.full(len(rotations), 1e-3))
        for _ in range(steps):
            second = self._second_order(state.rotations) if by_newton else 0.0
            state, goes_on = state.step(second, self._products)
            found[moving] = state.rotations
            active = np.flatnonzero(goes_on)
            if not len(active):
                break
            state = state.of(active)
            moving = moving[active]
        return nearest_rotation(found)


@dataclass(frozen=True)
class _Descent:
    """S descents: `rotations` (S, K, 3, 3), `products` as of `_Reduced._products`, and `damping` (S,)."""

    rotations: np.ndarray
    products: np.ndarray
    damping: np.ndarray

    def of(self, selected: np.ndarray) -> "_Descent":
        """Some of the descents."""
        return _Descent(self.rotations[selected], self.products[selected], self.damping[selected])

    def step(self, second, products_at) -> tuple["_Descent", np.ndarray]:
        """The descents after one step each, and which of them (S,) go on."""
        move, expected = _damped_move(self.products, self.damping, second)
        vector = move.reshape(len(move), -1, 3)
        moved = rotation_matrix(vector) @ self.rotations
        tried = products_at(moved)
        cost = self.products[:, -1, -1]
        accepted = tried[:, -1, -1] < cost
        damping = np.where(accepted, self.damping / 10, np.minimum(self.damping * 10, 1e6))
        after = _Descent(
            np.where(accepted[:, None, None, None], moved, self.rotations),
            np.where(accepted[:, None, None], tried, self.products),
            damping,
        )
        length = np.abs(move).max(1)
        is_flat = (expected < _FLAT * cost) | (length < _FLAT_RAD)
        return after, (length >= _LEAST_RAD) & (accepted | ~is_flat)


def quick_distances(systems: Sequence[RotationSystem]) -> list[np.ndarray]:
    """For each system what `RotationSystem.quick_distances` finds; those of equal size descend together.

    One step of a few hundred systems takes hardly longer than one of a single system.
    """
    reduced = [system._reduced() for system in systems]
    found: list = [None] * len(systems)
    for sizes in {system.rows.shape for system in reduced}:
        same = [k for k, system in enumerate(reduced) if system.rows.shape == sizes]
        rotations = _descended_together([reduced[k] for k in same])
        for k, system_rotations in zip(same, rotations):
            found[k] = systems[k]._distances_at_best(reduced[k], system_rotations)
    return found


def _descended_together(systems: list[_Reduced]) -> np.ndarray:
    """(H, S, K, 3, 3) where a few steps from the S best starts of each of H systems of equal size lead."""
    linear = np.stack([system._linear for system in systems])
    right = np.stack([system.rows[:, -1] for system in systems])[:, None]

    products_at = partial(_inner_products, linear, right)
    starts = np.stack([system.screened()[:_QUICK] for system in systems])
    rotations = starts.reshape(-1, *starts.shape[2:])
    state = _Descent(rotations, products_at(rotations), np.full(len(rotations), 1e-3))
    moving = np.ones(len(rotations), bool)
    for _ in range(_QUICK_STEPS):
        after, goes_on = state.step(0.0, products_at)
        rotations = np.where(moving[:, None, None, None], after.rotations, rotations)
        state, moving = after, moving & goes_on
        if not moving.any():
            break
    return nearest_rotation(rotations).reshape(starts.shape)


def _inner_products(linear: np.ndarray, right: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """(H S, 3 K + 1, 3 K + 1) of S sets of rotations of each of H systems, rotations (H S, K, 3, 3).

    linear (H, 9 K, C) and right (H, 1, R): the columns of the Jacobian, and the residual as the last, are linear in the
    rotations, with the right-hand side added to the residual.
    """
    products = rotations.reshape(len(linear), -1, linear.shape[1]) @ linear
    products = products.reshape(*products.shape[:2], -1, right.shape[-1])
    products[:, :, -1] += right
    columns = products.reshape(-1, *products.shape[2:])
    return columns @ columns.swapaxes(1, 2)


def _damped_move(
    products: np.ndarray, damping: np.ndarray, second
) -> tuple[np.ndarray, np.ndarray]:
    """Moves (S, 3 K) rad of Levenberg-Marquardt, and by how much each lowers the cost of a linear problem at most.

    second (S, 3 K, 3 K), or 0: added to the normal matrix where the sum is positive definite.
    """
    normal = products[:, :-1, :-1]
    gradient = products[:, :-1, -1]
    size = gradient.shape[1]
    scale = np.maximum(np.trace(normal, axis1=1, axis2=2), 1e-12) / size
    if np.ndim(second):
        convex = np.linalg.eigvalsh(normal + second)[:, 0] > _CONVEX * scale
        normal = normal + np.where(convex[:, None, None], second, 0.0)
    regular = normal + (scale * np.maximum(damping, 1e-10))[:, None, None] * np.eye(size)
    move = -np.linalg.solve(regular, gradient[:, :, None])[:, :, 0]
    expected = -2 * (gradient * move).sum(1)
    return move, expected


_GENERATORS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    float,
)


def _interpolated(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(S, K, 3, 3) rotations on the shortest way between two sets (K, 3, 3), the ends left out."""
    from scipy.spatial.transform import Rotation

    way = Rotation.from_matrix(second @ first.transpose(0, 2, 1)).as_rotvec()
    shares = np.linspace(0, 1, 9)[1:-1, None, None]
    return rotation_matrix(shares * way) @ first


def _angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(...,) largest angle (rad) between corresponding rotations of two sets (..., K, 3, 3)."""
    chord = np.sqrt(((first - second) ** 2).sum((-2, -1)) / 8)
    return 2 * np.arcsin(np.minimum(chord, 1)).max(-1)


def lever_arm(points: np.ndarray) -> float:
    """Distance (mm) by which an orientation error is worth a position error: the spread of points (3, n).

    Errors of a nominal arm grow with the distance over which it moves.
    """
    spread = np.sqrt(((points - points.mean(1, keepdims=True)) ** 2).sum(0).mean())
    return float(max(spread, LEAST_LEVER_MM))
