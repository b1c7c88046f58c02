"""Rotation conventions of foreign files: quaternions, rotation vectors, matrices and all Euler conventions.

An Euler convention is "intrinsic XYZ" or "extrinsic XYZ" (any of the twelve sequences), for angles in the order of
the letters: intrinsic XYZ of (a, b, c) is Rx(a) Ry(b) Rz(c), extrinsic XYZ is Rz(c) Ry(b) Rx(a).
Diebel, Representing Attitude: Euler Angles, Unit Quaternions, and Rotation Vectors, Stanford (2006).
"""

from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.importers.units import degrees_of

TAIT_BRYAN = tuple("".join(p) for p in permutations("XYZ"))
PROPER = tuple(a + b + a for a, b in product("XYZ", repeat=2) if a != b)
SEQUENCES = TAIT_BRYAN + PROPER
EULER = tuple(
    f"{frame} {sequence}" for frame in ("intrinsic", "extrinsic") for sequence in SEQUENCES
)
QUATERNIONS = ("quaternion wxyz", "quaternion xyzw")
VECTOR, MATRIX = "rotation vector", "matrix"
CONVENTIONS = (*QUATERNIONS, VECTOR, MATRIX, *EULER)
SIZES = {"quaternion wxyz": 4, "quaternion xyzw": 4, VECTOR: 3, MATRIX: 9} | dict.fromkeys(EULER, 3)
"""Convention -> number of columns."""

_UNIT_LENGTH = 0.02
_ORTHOGONAL = 0.02


def has_unit(convention: str) -> bool:
    """Whether the columns of a convention are angles."""
    return SIZES[convention] == 3


def rotation_matrices(
    values: np.ndarray, convention: str, unit: str | None, inverse: bool = False
) -> np.ndarray:
    """(n, 3, 3) rotations of columns (n, k) in a convention.

    unit: of angles (`datasets.importers.units.ANGLE_NAMES`). inverse: the columns hold the transposed rotation.
    Raises ValueError where quaternions have no length 1 or matrices are not orthogonal, with the first such row.
    """
    if convention in QUATERNIONS:
        rotations = _of_quaternions(values, convention)
    elif convention == MATRIX:
        rotations = _of_matrices(values)
    else:
        angles = np.deg2rad(degrees_of(values, unit or "deg"))
        if convention == VECTOR:
            rotations = Rotation.from_rotvec(angles)
        else:
            frame, sequence = convention.split()
            letters = sequence if frame == "intrinsic" else sequence.lower()
            rotations = Rotation.from_euler(letters, angles)
    matrices = rotations.as_matrix()
    return matrices.transpose(0, 2, 1) if inverse else matrices


def _of_quaternions(values: np.ndarray, convention: str) -> Rotation:
    lengths = np.linalg.norm(values, axis=1)
    wrong = np.abs(lengths - 1) > _UNIT_LENGTH
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ValueError(
            f"a quaternion of length 1, found {lengths[row]:.4g} in data row {row + 1}"
        )
    return Rotation.from_quat(
        np.roll(values, -1, axis=1) if convention == "quaternion wxyz" else values
    )


def _of_matrices(values: np.ndarray) -> Rotation:
    matrices = values.reshape(-1, 3, 3)
    product_ = matrices @ matrices.transpose(0, 2, 1)
    wrong = (np.abs(product_ - np.eye(3)).max((1, 2)) > _ORTHOGONAL) | (np.linalg.det(matrices) < 0)
    if wrong.any():
        raise ValueError(
            f"orthogonal matrices of determinant 1, found another in data row {int(np.argmax(wrong)) + 1}"
        )
    return Rotation.from_matrix(matrices)


def quaternion_columns(rotations: np.ndarray, prefix: str = "") -> dict[str, np.ndarray]:
    """Columns qw, qx, qy, qz with qw >= 0 of rotations (n, 3, 3), a prefix in front of their names."""
    quaternions = Rotation.from_matrix(rotations).as_quat(canonical=True)
    return {
        f"{prefix}q{axis}": quaternions[:, k]
        for axis, k in (("w", 3), ("x", 0), ("y", 1), ("z", 2))
    }
