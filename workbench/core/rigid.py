"""Rotations and rigid transforms as arrays: one, or many at a time."""

import numpy as np
from scipy.spatial.transform import Rotation


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation of rotation vectors (..., 3) in rad: Rodrigues' formula, exact at 0.

    In numpy alone, since exported modules contain it.
    """
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    turn = skew(vector)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * turn + half**2 / 2 * (turn @ turn)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """(..., 3) rad, rotation vectors of rotations (..., 3, 3)."""
    flat = np.reshape(matrix, (-1, 3, 3))
    return Rotation.from_matrix(flat).as_rotvec().reshape(*np.shape(matrix)[:-2], 3)


def skew(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrix of `vector x`."""
    vector = np.asarray(vector, float)
    matrix = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    matrix[..., 2, 1], matrix[..., 1, 2] = x, -x
    matrix[..., 0, 2], matrix[..., 2, 0] = y, -y
    matrix[..., 1, 0], matrix[..., 0, 1] = z, -z
    return matrix


def left_jacobian(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) J with Exp(v + dv) = Exp(J dv) Exp(v) for rotation vectors (..., 3).

    Barfoot, State Estimation for Robotics (2017), eq. 7.77.
    """
    vector = np.asarray(vector, float)
    angle, turn = np.linalg.norm(vector, axis=-1)[..., None, None], skew(vector)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * turn + second * (turn @ turn)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations nearest to `matrix` in the Frobenius norm (Kabsch, by SVD)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(..., 4, 4) homogeneous transform T_a_b of a rotation (..., 3, 3) and a translation (..., 3)."""
    made = np.zeros((*np.shape(translation)[:-1], 4, 4))
    made[..., :3, :3], made[..., :3, 3], made[..., 3, 3] = rotation, translation, 1
    return made


def inverse(matrix: np.ndarray) -> np.ndarray:
    """(..., 4, 4) T_b_a of T_a_b."""
    turn = np.swapaxes(matrix[..., :3, :3], -1, -2)
    return transform(turn, -(turn @ matrix[..., :3, 3, None])[..., 0])
