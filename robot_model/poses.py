"""Rigid transforms as six parameters: translation (mm) and rotation vector (rad)."""

import numpy as np

from workbench.core.parameters import Parameter
from workbench.core.rigid import rotation_vector

_WORDS = {
    "x": ("mm", 100.0, "translation along x"),
    "y": ("mm", 100.0, "translation along y"),
    "z": ("mm", 100.0, "translation along z"),
    "rx": ("rad", 0.1, "rotation about x"),
    "ry": ("rad", 0.1, "rotation about y"),
    "rz": ("rad", 0.1, "rotation about z"),
}


def pose_parameters(where: str, subject: str) -> list[Parameter]:
    """The six parameters of the transform at `where`, called `subject` in sentences."""
    return [
        Parameter(f"{where}.{name}", unit, 0.0, size, f"{subject} {words}")
        for name, (unit, size, words) in _WORDS.items()
    ]


def pose_values(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(6,) parameters of a rotation matrix (3, 3) and a translation (3,) in mm."""
    return np.concatenate([translation, rotation_vector(rotation)])
