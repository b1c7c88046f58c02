"""Arm poses of a sample: two for a measured length, whose ends were reached separately, else one.

With two, covariates and the rows of places and scans have one column for each arm pose, those of all first ends before
those of all second ends. Columns of hypotheses still have N rows: the contributions of both arm poses add up.
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
        """(n,) mean of values (E n,) over the E arm poses of each sample."""
        if self.count == 1:
            return values
        return values.reshape(self.count, -1).mean(0)

    def joined(self, columns: np.ndarray) -> np.ndarray:
        """(..., N) sum of the contributions (..., E N) of the E arm poses of each sample."""
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
