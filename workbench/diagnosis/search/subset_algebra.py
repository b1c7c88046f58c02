"""Moments of all hypotheses conditional on a set of them, by Schur complements.

With A = G_ss + s^-2 I the set's own inner products for disturbances of size s, what is left of the others' is
G_cc - G_cs A^-1 G_sc. One eigenvalue decomposition of G_ss serves all sizes.
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


class ConditionalSolution:
    """A set of columns `columns` (h,) of a table, solved once: moments conditional on it."""

    def __init__(self, table: Table, columns: np.ndarray):
        self.table = table
        values, self._vectors = symmetric_eigen(table.gram[np.ix_(columns, columns)])
        self._inverse_eigenvalues = 1 / (
            np.maximum(values, 0.0) + table.shrink[:, None]
        )  # (S, h): of A^-1, along the vectors
        self._columns = columns
        self._score = self._vectors.T @ table.score[columns]
        self._solution = self._inverse_eigenvalues * self._score

    @cached_property
    def _projected_gram(self) -> np.ndarray:
        """(h, T) of the set's inner products with all columns, along the vectors."""
        return self._vectors.T @ self.table.gram[self._columns]

    @cached_property
    def scores(self) -> np.ndarray:
        """(S, T) the scores conditional on the set."""
        return self.table.score - self._solution @ self._projected_gram

    @property
    def blocks(self) -> tuple[np.ndarray, ...]:
        """(S, C, w, w) of each group what is left of their inner products."""
        return tuple(map(self._complement, self.table.columns, self.table.blocks))

    @cached_property
    def log_determinant(self) -> np.ndarray:
        """(S,) log determinant of the set."""
        return -np.log(self._inverse_eigenvalues).sum(1) - len(self._score) * np.log(
            self.table.shrink
        )

    @cached_property
    def gain(self) -> np.ndarray:
        """(S,) gain of the set."""
        return self._solution @ self._score

    def coefficients(self, size: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,) of some columns and their standard errors (k,) in sigmas, for one of the sizes.

        rows (k,): places among the columns of the set.
        """
        within, vectors = self._inverse_eigenvalues[size], self._vectors[rows]
        return vectors @ self._solution[size], np.sqrt((vectors**2 * within).sum(1))

    def _complement(self, columns, own) -> np.ndarray:
        """(S, C, w, w)."""
        if not len(self._score):
            return np.broadcast_to(own, (len(self._inverse_eigenvalues), *own.shape))
        made = self._projected_gram.T[columns]  # (C, w, h)
        return own - (made * self._inverse_eigenvalues[:, None, None]) @ made.swapaxes(1, 2)
