"""Homographies between a plane board and its image (Hartley & Zisserman, Multiple View Geometry, 2nd ed., sec. 2.3)."""

import numpy as np


def project(h: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(2, n) images of points (2, n) under the homography h (3, 3)."""
    u, v, w = h @ np.vstack([points, np.ones(points.shape[1])])
    return np.stack([u, v]) / w


def area_scale(h: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) by how much h (3, 3) enlarges a small area at points (2, n): the determinant of its Jacobian."""
    depth = h[2, :2] @ points + h[2, 2]
    return np.abs(np.linalg.det(h) / depth**3)
