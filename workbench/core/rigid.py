"""Rotations and rigid transforms as arrays: one, or many at a time."""

from collections.abc import Sequence
from functools import cache

import numpy as np


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation of rotation vectors (..., 3) in rad: Rodrigues' formula, exact at 0.

    In numpy alone, since exported modules contain it.
    """
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross_matrix = skew(vector)
    half = np.sinc(angle / (2 * np.pi))
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * cross_matrix
        + half**2 / 2 * (cross_matrix @ cross_matrix)
    )


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """(..., 3) rad, rotation vectors of rotations (..., 3, 3), of angles up to pi.

    By the unit quaternion, whose largest component is computed first: Shepperd, J. Guidance and Control 1 (1978) 223.
    In numpy alone, since every command needs it and scipy.spatial takes long to load.
    """
    quaternion = unit_quaternion(matrix)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1)
    angle = 2 * np.arctan2(sine, quaternion[..., 0])
    # the ratio of angle and sine, 2 where both vanish
    ratio = np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 2.0)
    return ratio[..., None] * quaternion[..., 1:]


def unit_quaternion(matrix: np.ndarray) -> np.ndarray:
    """(..., 4) w, x, y, z of rotations (..., 3, 3), w not negative."""
    matrix = np.asarray(matrix, float)
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    # four times the products of components: each row of the table is 4 q_k q
    table = np.empty((*trace.shape, 4, 4))
    table[..., 0, 0] = 1 + trace
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        table[..., i + 1, i + 1] = 1 + 2 * diagonal[..., i] - trace
        antisymmetric = matrix[..., k, j] - matrix[..., j, k]
        symmetric = matrix[..., k, j] + matrix[..., j, k]
        table[..., 0, i + 1] = table[..., i + 1, 0] = antisymmetric
        table[..., j + 1, k + 1] = table[..., k + 1, j + 1] = symmetric
    largest = np.diagonal(table, axis1=-2, axis2=-1).argmax(-1)
    row = np.take_along_axis(table, largest[..., None, None], -2)[..., 0, :]
    row = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(row[..., :1] < 0, -row, row)


@cache
def icosahedral_rotations() -> np.ndarray:
    """(60, 3, 3) rotations of the icosahedron: evenly spread over all rotations, none farther than 45 deg from one."""
    golden = (1 + np.sqrt(5)) / 2
    corner = np.array([0, 1, golden])
    face = np.ones(3)
    vector = 2 * np.pi / 5 * corner / np.linalg.norm(corner)
    fifth = rotation_matrix(vector)
    third = rotation_matrix(2 * np.pi / 3 * face / np.linalg.norm(face))
    found = [np.eye(3)]
    for rotation in found:
        for candidate in (fifth @ rotation, third @ rotation):
            if all(np.abs(candidate - other).max() > 0.1 for other in found):
                found.append(candidate)
    return np.array(found)


def skew(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrix of `vector x`."""
    vector = np.asarray(vector, float)
    matrix = np.zeros((*vector.shape, 3))
    x = vector[..., 0]
    y = vector[..., 1]
    z = vector[..., 2]
    matrix[..., 2, 1], matrix[..., 1, 2] = x, -x
    matrix[..., 0, 2], matrix[..., 2, 0] = y, -y
    matrix[..., 1, 0], matrix[..., 0, 1] = z, -z
    return matrix


def left_jacobian(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) J with Exp(v + dv) = Exp(J dv) Exp(v) for rotation vectors (..., 3).

    Barfoot, State Estimation for Robotics (2017), eq. 7.77.
    """
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross_matrix = skew(vector)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * cross_matrix + second * (cross_matrix @ cross_matrix)


def rotation_vector_std(vector: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(3,) rad, 1 sigma of the components of a rotation vector (3,) whose rotation is uncertain.

    covariance (3, 3): of a small rotation about the axes of the frame that is rotated to, left-multiplied, rad^2; where
    it is not finite, its own roots are returned. The components of the vector change by the inverse of `left_jacobian`.
    """
    if not np.isfinite(covariance).all():
        return np.sqrt(np.diag(covariance))
    inverse = np.linalg.inv(left_jacobian(vector))
    return np.sqrt(np.diag(inverse @ covariance @ inverse.T))


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations nearest to `matrix` in the Frobenius norm (Kabsch, by SVD)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(..., 4, 4) homogeneous transform T_a_b of a rotation (..., 3, 3) and a translation (..., 3)."""
    matrix = np.zeros((*np.shape(translation)[:-1], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = rotation, translation, 1
    return matrix


def placement(xyz: Sequence[float], rpy_deg: Sequence[float]) -> np.ndarray:
    """(4, 4) from a translation (3,) and roll, pitch and yaw (3,), deg, about the fixed axes x, y and z, as in URDF."""
    from scipy.spatial.transform import Rotation  # takes a tenth of a second that few files need

    return transform(Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix(), xyz)


def inverse(matrix: np.ndarray) -> np.ndarray:
    """(..., 4, 4) T_b_a of T_a_b."""
    transposed = np.swapaxes(matrix[..., :3, :3], -1, -2)
    translation = -(transposed @ matrix[..., :3, 3, None])[..., 0]
    return transform(transposed, translation)
