"""Arm poses of a sample: two of a length between two places, of which each end moves by itself, else one.

Rows of places and scans, and covariates, then have a column an arm pose, all first ends before all second ones.
Columns of hypotheses have N rows as ever: what the E arm poses of a sample contribute to its residual adds up.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ends:
    """`count` E arm poses of each of `n` samples; n is not needed where E is 1."""

    count: int = 1
    n: int = 0

    def numbers(self, sample: np.ndarray) -> np.ndarray:
        """(E N,) number of the arm pose that each column of rows belongs to; sample (N,): that of each coordinate."""
        if self.count == 1:
            return sample
        return np.tile(np.arange(self.count * self.n), len(sample) // self.n)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """(n,) means over the arm poses of values (E n,)."""
        return values if self.count == 1 else values.reshape(self.count, -1).mean(0)

    def joined(self, columns: np.ndarray) -> np.ndarray:
        """(..., N) sums over the arm poses of each sample of what each contributes, (..., E N)."""
        if self.count == 1:
            return columns
        return self._parted(columns).sum(-2).reshape(*columns.shape[:-1], -1)

    def repeated(self, columns: np.ndarray) -> np.ndarray:
        """(E N, ...) columns (N, ...) repeated for each arm pose of a sample."""
        if self.count == 1:
            return columns
        number = np.arange(len(columns)).reshape(-1, 1, self.n)
        return columns[np.repeat(number, self.count, axis=1).ravel()]

    def mapped(self, white: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
        """(k, E N) rows of which `white`, rows (k, N) to (k, N), maps those of each arm pose."""
        if self.count == 1:
            return white(rows)
        parted = np.moveaxis(self._parted(rows), -2, 0)
        mapped = [
            white(np.ascontiguousarray(rows_of_end.reshape(len(rows), -1)))
            for rows_of_end in parted
        ]
        mapped = np.stack([rows_of_end.reshape(parted.shape[1:]) for rows_of_end in mapped])
        return np.moveaxis(mapped, 0, -2).reshape(rows.shape)

    def _parted(self, columns: np.ndarray) -> np.ndarray:
        """(..., m, E, n) of columns (..., E N)."""
        return columns.reshape(*columns.shape[:-1], -1, self.count, self.n)
