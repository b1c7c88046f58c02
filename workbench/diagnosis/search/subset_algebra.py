"""Moments of all hypotheses conditional on a set of them, and on this set less one member, by Schur complements.

With A = G_ss + s^-2 I the set's own inner products for disturbances of size s, what is left of the others' is
G_cc - G_cs A^-1 G_sc. One eigenvalue decomposition of G_ss serves all sizes. Without the member i all of it grows by
what the block i of A^-1 says, U' ((A^-1)_ii)^-1 U with U = (A^-1 G)_i: the set is not solved again for each member
that it might lose (block inversion: Golub & Van Loan, Matrix Computations, 4th ed., sec. 2.1).

Determinant, gain and coefficients of a set alone follow from Cholesky factors of A, at a third of the time of the
eigenvectors; a set with one member more extends the factors of the set (ibid., sec. 4.2).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtrs

from workbench.core.least_squares.linear_algebra import symmetric_eigen


@dataclass(frozen=True)
class Table:
    """Inner products `gram` (T, T) and `score` (T,) of all columns, `shrink` (S,) the inverse squares of the sizes.

    `columns`: of each group of hypotheses with equally many, their column numbers (C, w).
    """

    gram: np.ndarray
    score: np.ndarray
    shrink: np.ndarray
    columns: tuple[np.ndarray, ...]

    @cached_property
    def blocks(self) -> tuple[np.ndarray, ...]:
        """(C, w, w) of each group: the inner products of each hypothesis."""
        return tuple(self.gram[c[:, :, None], c[:, None, :]] for c in self.columns)


@dataclass(frozen=True)
class Left:
    """`spent` (S,) log determinant of a set and `gained` (S,) its gain, `left` (S, T) the scores conditional on it,
    `blocks` (S, C, w, w) of each group what is left of their inner products."""

    spent: np.ndarray
    gained: np.ndarray
    left: np.ndarray
    blocks: tuple[np.ndarray, ...]


class FactoredSet:
    """Columns `held` (h,) of a table, A = L L' for each size: L (S, h, h), L^-1 score (S, h).

    Raises numpy's LinAlgError where rounding exceeds what is left.
    """

    def __init__(self, table: Table, held: np.ndarray):
        self.table, self.held = table, held
        within = np.broadcast_to(
            table.gram[np.ix_(held, held)], (len(table.shrink), *[len(held)] * 2)
        )
        self.lower = _factors(within, table.shrink)
        self.along = _solve_each(self.lower, table.score[held][:, None])[:, :, 0]
        self.spent = _log_determinants(self.lower) - len(held) * np.log(table.shrink)
        self.gained = (self.along**2).sum(1)


class ExtendedSet:
    """The set of a `FactoredSet` with columns `more` (w,) after its own; `spent` and `gained` as of `Left`.

    Raises numpy's LinAlgError where rounding exceeds what is left.
    """

    def __init__(self, base: FactoredSet, more: np.ndarray):
        table = base.table
        self._base = base
        self._cross = _solve_each(base.lower, table.gram[np.ix_(base.held, more)])  # (S, h, w)
        remaining = table.gram[np.ix_(more, more)] - self._cross.swapaxes(1, 2) @ self._cross
        self._lower = _factors(remaining, table.shrink)
        score = table.score[more] - np.einsum("shw,sh->sw", self._cross, base.along)
        self._along = _solve_each(self._lower, score[:, :, None])[:, :, 0]
        volume = _log_determinants(self._lower) - len(more) * np.log(table.shrink)
        self.spent = base.spent + volume
        self.gained = base.gained + (self._along**2).sum(1)

    def coefficients(self, size: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,) of some columns and their standard errors (k,) in sigmas, for one of the sizes.

        rows (k,): places among the columns of the whole set.
        """
        count = len(self._base.held)
        units = (rows[:, None] == np.arange(count + len(self._along[size]))).astype(float).T
        # L X = unit vectors, in blocks: values are X' L^-1 score, variances the squared lengths of X's columns
        first = _forward(self._base.lower[size], units[:count])
        second = _forward(self._lower[size], units[count:] - self._cross[size].T @ first)
        values = first.T @ self._base.along[size] + second.T @ self._along[size]
        return values, np.sqrt((first**2).sum(0) + (second**2).sum(0))


def _factors(matrices: np.ndarray, shrink: np.ndarray) -> np.ndarray:
    """(S, h, h) lower Cholesky factors of matrices (S, h, h) with `shrink` (S,) on the diagonal."""
    if not matrices.shape[1]:
        return matrices
    return np.linalg.cholesky(matrices + shrink[:, None, None] * np.eye(matrices.shape[1]))


def _log_determinants(lower: np.ndarray) -> np.ndarray:
    """(S,) of the matrices with Cholesky factors lower (S, h, h)."""
    return 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1)


def _solve_each(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(S, h, w) L^-1 right for lower (S, h, h), right (h, w) or (S, h, w)."""
    right = np.broadcast_to(right, (len(lower), *right.shape[-2:]))
    return np.stack([_forward(factor, own) for factor, own in zip(lower, right)])


def _forward(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(h, w) L^-1 right by forward substitution, lower (h, h), right (h, w)."""
    if not right.size:
        return right
    return dtrtrs(lower.T, right, lower=0, trans=1)[0]  # its transpose lies as LAPACK reads it


class ConditionalSolution:
    """A set of columns `held` (h,) of a table, solved once: moments conditional on it, or on it less a member."""

    def __init__(self, table: Table, held: np.ndarray):
        self.table = table
        values, self._vectors = symmetric_eigen(table.gram[np.ix_(held, held)])
        self._within = 1 / (
            np.maximum(values, 0.0) + table.shrink[:, None]
        )  # (S, h): of A^-1, along the vectors
        self._held = held
        self._score = self._vectors.T @ table.score[held]
        self._solution = self._within * self._score

    @cached_property
    def _along(self) -> np.ndarray:
        """(h, T) of the set's inner products with all columns, along the vectors."""
        return self._vectors.T @ self.table.gram[self._held]

    @cached_property
    def whole(self) -> Left:
        """Conditional on the whole set."""
        table = self.table
        left = table.score - self._solution @ self._along
        blocks = tuple(self._complement(c, own) for c, own in zip(table.columns, table.blocks))
        return Left(self.spent, self.gained, left, blocks)

    @cached_property
    def spent(self) -> np.ndarray:
        """(S,) log determinant of the set."""
        return -np.log(self._within).sum(1) - len(self._score) * np.log(self.table.shrink)

    @cached_property
    def gained(self) -> np.ndarray:
        """(S,) gain of the set."""
        return self._solution @ self._score

    def coefficients(self, size: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As of an `ExtendedSet`."""
        within, vectors = self._within[size], self._vectors[rows]
        return vectors @ self._solution[size], np.sqrt((vectors**2 * within).sum(1))

    def _complement(self, columns, own) -> np.ndarray:
        """(S, C, w, w)."""
        if not len(self._score):
            return np.broadcast_to(own, (len(self._within), *own.shape))
        made = self._along.T[columns]  # (C, w, h)
        return own - (made * self._within[:, None, None]) @ made.swapaxes(1, 2)

    def without(self, member: slice) -> Left:
        """Conditional on the set less the held columns of a slice."""
        whole, mine = self.whole, self._vectors[member]
        kept = mine * self._within[:, None]  # (S, w, h)
        lower = np.linalg.inv(np.linalg.cholesky(kept @ mine.T))
        more = lower @ (kept @ self._along)  # (S, w, T)
        part = (lower @ (mine @ self._solution.T).T[:, :, None])[:, :, 0]
        volume = -2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1) + len(mine) * np.log(
            self.table.shrink
        )
        left = whole.left + np.einsum("swt,sw->st", more, part)
        blocks = tuple(
            own + _squares(more[:, :, c]) for c, own in zip(self.table.columns, whole.blocks)
        )
        return Left(whole.spent + volume, whole.gained - (part**2).sum(1), left, blocks)


def _squares(made: np.ndarray) -> np.ndarray:
    """(S, C, v, v) from (S, w, C, v)."""
    made = made.transpose(0, 2, 1, 3)
    return made.swapaxes(2, 3) @ made


__all__ = ["ConditionalSolution", "ExtendedSet", "FactoredSet", "Left", "Table"]
