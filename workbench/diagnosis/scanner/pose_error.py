"""Held-out errors of stripes without what the error of their board's pose moves in common.

A held-out board pose comes from its corners, whose noise leaves it an error of covariance C. That moves all stripes of
the board pose together, V = S^2 + J C J' with S the noise of single centres and J the stripes' derivative by the pose.
A sum of squares counts it once for every point, so that a few board poses with ill-determined poses outweigh all
others. S V^-1/2 e is as independent as single centres are (Mahalanobis); an error that is larger than C explains stays.
"""

import numpy as np

from workbench.core.least_squares.linear_algebra import inverse_positive


def independent_errors(
    error: np.ndarray, by_pose: np.ndarray, sigma: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """(n,) px: errors (n,) px of the stripes of one board pose, made independent.

    by_pose (6, n) px per unit of the pose; sigma (n,) px of single centres; covariance (6, 6) of the pose.
    """
    values, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(values, 0.0))
    sides, spread, _ = np.linalg.svd((by_pose / sigma).T @ root, full_matrices=False)
    lost = 1 - 1 / np.sqrt(1 + spread**2)
    white = error / sigma
    return sigma * (white - sides @ (lost * (sides.T @ white)))


def pose_covariance(residual: np.ndarray, by_pose: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """(6, 6) of a pose from its corners: residual (m, n) px, by_pose (6, m, n) px per unit, sigma (m, n) px.

    Scaled by the variance factor of the corners where that is above 1: their errors are not only noise of the image.
    """
    rows = (by_pose / sigma).reshape(len(by_pose), -1)
    white = (residual / sigma).ravel()
    factor = float(white @ white) / max(white.size - len(rows), 1)
    return inverse_positive(rows @ rows.T) * max(factor, 1.0)


def without_pose_error(chains, corners, stripes) -> np.ndarray:
    """(1, n) px: residual of stripes on boards, board pose by board pose as of `independent_errors`.

    `chains` with the board poses that their corners alone determine; `corners`, `stripes`: their evaluations there.
    """
    made = stripes.residual.copy()
    pose = chains.board_stripes.labels["placement"]
    seen = chains.corners.labels["placement"]
    by_stripe, by_corner = (one.family_rows("placement") for one in (stripes, corners))
    sigma = np.broadcast_to(chains.board_stripes.sigma, made.shape)
    noise = np.broadcast_to(chains.corners.sigma, corners.residual.shape)
    for k in np.unique(pose):
        mine, own = pose == k, seen == k
        covariance = pose_covariance(corners.residual[:, own], by_corner[..., own], noise[:, own])
        rows = by_stripe[:, 0, mine]
        made[0, mine] = independent_errors(made[0, mine], rows, sigma[0, mine], covariance)
    return made
