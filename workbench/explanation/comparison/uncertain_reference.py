"""Uncertainty of an earlier calibration: its values differ from the truth, and so from those of a later one, by chance.

A parameter of the reference with the covariance C makes residuals J C J' in a recording in which nothing has changed.
They are counted as noise of the comparison (generalised least squares; Seber & Lee, Nonlinear Regression, sec. 2.1.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ValueUncertainty:
    """`keys` (K) of values that were estimated, and their `covariance` (K, K) in their units."""

    keys: tuple[str, ...]
    covariance: np.ndarray

    def factor(self, names: Sequence[str], typical: np.ndarray) -> np.ndarray:
        """(C, K) L with L L' the covariance of parameters by name, each over its `typical` size (C,); 0 for others."""
        rows = [self.keys.index(name) if name in self.keys else -1 for name in names]
        is_known = np.array(rows) >= 0
        chosen = [row for row in rows if row >= 0]
        sizes = np.asarray(typical, float)[is_known]
        scaled = self.covariance[np.ix_(chosen, chosen)] / np.outer(sizes, sizes)
        values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
        factor = np.zeros((len(names), len(chosen)))
        factor[is_known] = vectors * np.sqrt(np.maximum(values, 0.0))
        return factor


def decorrelated(vectors: np.ndarray, common: np.ndarray) -> np.ndarray:
    """(K, N) rows times (I + A'A)^-1/2, with A (R, N) `common`: what uncertain values of the reference add to noise."""
    if not len(common):
        return vectors
    _, sizes, basis = np.linalg.svd(common, full_matrices=False)
    shrinkage = 1 - 1 / np.sqrt(1 + sizes**2)
    return vectors - (vectors @ basis.T * shrinkage) @ basis


def generalised_least_squares(
    columns: np.ndarray, observed: np.ndarray, common: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(C,) coefficients and standard deviations of `columns` (C, N) in `observed` (N,), all in units of the noise.

    common: (R, N) A, the displacements by uncertain values of the reference, 1 sigma each; the covariance of `observed`
    is I + A'A.
    """
    white_columns = decorrelated(columns, common)
    (white,) = decorrelated(observed[None], common)
    covariance = np.linalg.pinv(white_columns @ white_columns.T)
    return covariance @ (white_columns @ white), np.sqrt(np.diag(covariance))
