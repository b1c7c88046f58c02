"""Moments of all hypotheses conditional on a set of them, and on this set less one member, by Schur complements.

With A = G_ss + s^-2 I the set's own inner products for disturbances of size s, what is left of the others' is
G_cc - G_cs A^-1 G_sc. One eigenvalue decomposition of G_ss serves all sizes. Without the member i all of it grows by
what the block i of A^-1 says, U' ((A^-1)_ii)^-1 U with U = (A^-1 G)_i: the set is not solved again for each member
that it might lose (block inversion: Golub & Van Loan, Matrix Computations, 4th ed., sec. 2.1).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

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
        """Values (k,) of some held columns and their standard errors (k,) in sigmas, for one of the sizes."""
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


__all__ = ["ConditionalSolution", "Left", "Table"]
