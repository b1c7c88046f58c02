"""Rigid transforms as six parameters: translation (mm) and rotation vector (rad)."""

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.parameters import Parameter

_WORDS = {
    "x": ("mm", 100.0, "translation along x"),
    "y": ("mm", 100.0, "translation along y"),
    "z": ("mm", 100.0, "translation along z"),
    "rx": ("rad", 0.1, "rotation about x"),
    "ry": ("rad", 0.1, "rotation about y"),
    "rz": ("rad", 0.1, "rotation about z"),
}


def pose_parameters(where: str, what: str) -> list[Parameter]:
    """The six parameters of the transform at `where`, called `what` in sentences."""
    return [
        Parameter(f"{where}.{name}", unit, 0.0, size, f"{what} {words}") for name, (unit, size, words) in _WORDS.items()
    ]


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a rotation vector (3,) in rad."""
    return Rotation.from_rotvec(vector).as_matrix()


def left_jacobian(vector: np.ndarray) -> np.ndarray:
    """(3, 3) J with Exp(v + dv) = Exp(J dv) Exp(v).

    Barfoot, State Estimation for Robotics (2017), eq. 7.77.
    """
    angle = np.linalg.norm(vector)
    skew = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    if angle < 1e-4:
        return np.eye(3) + skew / 2 + skew @ skew / 6
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) + first * skew + second * skew @ skew


def pose_values(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(6,) parameters of a rotation matrix (3, 3) and a translation (3,) in mm."""
    return np.concatenate([translation, Rotation.from_matrix(rotation).as_rotvec()])


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """(3, 3) rotation nearest to `matrix` in the Frobenius norm (Kabsch, by SVD)."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
