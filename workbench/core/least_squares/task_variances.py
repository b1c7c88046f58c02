"""Variance of a task with each of many candidates added to a set, by low-rank updates as the set changes."""

import numpy as np

from workbench.core.least_squares.linear_algebra import inverse_positive, symmetric_eigen

_REFRESH = 50  # updates after which the inverse is made again: each adds some rounding
_SINGULAR = 1e-6
"""Smallest eigenvalue, of what a removal leaves of a candidate's own rows, that an update is accurate for."""
_NEGLIGIBLE = 1e-12
"""Of the largest eigenvalue of the tasks' weight: directions below it are rounding."""


class TaskVariances:
    """For candidates with rows (N, m, F), prior information `known` (F, F) and a weight (F, F) of the tasks.

    The covariance of a set and its products with all candidates' rows follow from those of the last set by Woodbury's
    identity (Golub & Van Loan, Matrix Computations, 4th ed., section 2.1.4).
    """

    def __init__(self, rows: np.ndarray, known: np.ndarray, weight: np.ndarray):
        values, vectors = symmetric_eigen(weight)
        is_retained = values > _NEGLIGIBLE * max(values[-1], 0.0)
        self._tasks = vectors[:, is_retained] * np.sqrt(values[is_retained])
        self._rows, self._known = rows, known
        self._restart(np.zeros(len(rows), int))

    def with_each(self, members: np.ndarray) -> np.ndarray:
        """(N,) trace of weight times covariance of a set, numbers (k,), with each of the candidates in addition."""
        self._move(np.bincount(members, minlength=len(self._rows)))
        inner = self._products @ np.swapaxes(self._rows, 1, 2) + np.eye(self._rows.shape[1])
        projected = self._products @ self._tasks
        square = projected @ np.swapaxes(projected, 1, 2)
        gains = (np.linalg.inv(inner) * square).sum(axis=(1, 2))
        return ((self._covariance @ self._tasks) * self._tasks).sum() - gains

    def _move(self, counts: np.ndarray) -> None:
        """To the set that holds each candidate so many times (N,)."""
        change = counts - self._counts
        if self._updates + np.abs(change).sum() > _REFRESH:
            self._restart(counts)
            return
        for k in np.flatnonzero(change):
            for _ in range(abs(change[k])):
                sign = int(np.sign(change[k]))
                if not self._update(k, sign):
                    self._restart(counts)
                    return
        self._counts = counts

    def _update(self, k: int, sign: int) -> bool:
        """Add (1) or remove (-1) a candidate; False where its rows alone determine a direction."""
        row = self._rows[k]
        product = self._products[k].copy()
        inner = np.eye(len(row)) + sign * row @ product.T
        if np.linalg.eigvalsh((inner + inner.T) / 2)[0] < _SINGULAR:
            return False
        solved = sign * np.linalg.solve(inner, product)
        self._covariance = self._covariance - product.T @ solved
        self._products = self._products - (self._products @ row.T) @ solved
        self._updates += 1
        return True

    def _restart(self, counts: np.ndarray) -> None:
        owner = np.repeat(np.arange(len(counts)), counts)
        flat = self._rows[owner].reshape(-1, self._rows.shape[2])
        matrix = flat.T @ flat + self._known
        self._covariance = inverse_positive(matrix)
        self._products = self._rows @ self._covariance
        self._counts, self._updates = counts, 0


__all__ = ["TaskVariances"]
