"""Held-out predictions of a sensor as independent errors, with what their own uncertainty costs.

Predictions of one board pose or ball share what is uncertain in them: camera, light and effects of the other folds, of
covariance C, and a pose that comes from the corners of its own. Their covariance is V = S^2 + J C J' + A P A', with S
the noise of single samples, J the derivative by the shared unknowns once the pose is refitted, A that of the stripes by
the pose, and P the pose's covariance from its corners. A sum of squares counts a shared error once for every sample, so
that one place to which the other folds extrapolate outweighs all the others.

The logarithmic score (Gneiting & Raftery, J. Am. Stat. Assoc. 102 (2007) 359) of a normal prediction counts it once:
e' V^-1 e + log det(V / S^2), minus twice the log density. What is uncertain costs by its log determinant, so that a
larger model is not preferred for predicting less precisely.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.linear_algebra import inverse_positive


@dataclass(frozen=True)
class Predicted:
    """n predicted samples of one kind, m coordinates each, with the pose or the centre of each group as fitted.

    `residual` and `sigma` (m, n) px; `by_shared` (D, m, n) and `by_own` (L, m, n) px per unit of the shared unknowns
    and of the group's own; `group` (n,).
    """

    residual: np.ndarray
    sigma: np.ndarray
    by_shared: np.ndarray
    by_own: np.ndarray
    group: np.ndarray

    def whitened(self, group: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual (k,), and its derivatives (k, D), (k, L) of one group in units of the noise."""
        of_group = self.group == group
        sigma = self.sigma[:, of_group].ravel()
        by_shared, by_own = (
            rows[..., of_group].reshape(len(rows), -1) / sigma
            for rows in (self.by_shared, self.by_own)
        )
        residual = self.residual[:, of_group].ravel() / sigma
        return residual, by_shared.T, by_own.T


def scored_errors(kinds: Sequence[Predicted], covariance: np.ndarray) -> list[np.ndarray]:
    """(m, n) px of each kind: errors whose squares over the noise's add up to the logarithmic score of each group.

    The first kind determines each group's own unknowns; covariance (D, D) of the shared ones.
    """
    root = _root(covariance)
    scored = [np.zeros_like(kind.residual) for kind in kinds]
    for group in np.unique(kinds[0].group):
        whitened = [kind.whitened(group) for kind in kinds]
        residual_and_factor = _errors_and_factor(whitened, root)
        white, log_determinant = independent_errors(*residual_and_factor)
        # in equal parts, so that a sum over samples is the score of their group
        size = np.sqrt(white**2 + log_determinant / max(len(white), 1))
        counts = [len(residual) for residual, _, _ in whitened]
        edges = np.cumsum(counts)[:-1]
        for kind, errors, part in zip(kinds, scored, np.split(size, edges)):
            of_group = kind.group == group
            by_component = part.reshape(len(errors), -1)
            errors[:, of_group] = by_component * kind.sigma[:, of_group]
    return scored


def independent_errors(white: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, float]:
    """V^-1/2 e and log det V of errors (k,) in units of their noise with V = 1 + F F', F (k, q)."""
    sides, spread, _ = np.linalg.svd(factor, full_matrices=False)
    lost = 1 - 1 / np.sqrt(1 + spread**2)
    log_determinant = float(np.log1p(spread**2).sum())
    decorrelated = white - sides @ (lost * (sides.T @ white))
    return decorrelated, log_determinant


def _errors_and_factor(kinds, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors (k,) of one group's samples in units of the noise, and the factor (k, q) of what they share.

    The pose's covariance is scaled by the variance factor of the samples that determine it where that is above 1: their
    errors are not only noise of the image.
    """
    residual, by_shared, by_own = kinds[0]
    inverse = inverse_positive(by_own.T @ by_own)
    response = inverse @ by_own.T @ by_shared  # of the pose to the shared unknowns
    degrees = max(len(residual) - by_own.shape[1], 1)
    scale = float(residual @ residual) / degrees
    pose = _root(inverse * max(scale, 1.0))
    factors = [
        np.hstack([(by_shared - by_own @ response) @ root, np.zeros((len(residual), len(pose)))])
    ]
    for _, shared, of_pose in kinds[1:]:
        of_shared = (shared - of_pose @ response) @ root
        factors.append(np.hstack([of_shared, of_pose @ pose]))
    all_errors = np.concatenate([errors for errors, _, _ in kinds])
    return all_errors, np.concatenate(factors)


def _root(covariance: np.ndarray) -> np.ndarray:
    """(D, D) R with R R' = covariance."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0, size, 1.0)
    correlation = covariance / np.outer(unit, unit)
    values, directions = np.linalg.eigh(correlation)
    root_values = np.sqrt(np.maximum(values, 0.0))
    return unit[:, None] * directions * root_values
