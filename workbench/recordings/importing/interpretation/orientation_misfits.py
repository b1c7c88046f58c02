"""Misfit of measured orientations to those of the flange, without a fit of base and tool."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from robot_model.chain import forward
from robot_model.robot import Robot

_SCREENED = 40
_PAIRS = 400
_SCREEN_FACTOR, _SCREEN_RAD = 3.0, np.deg2rad(1.0)


def flange_rotations(robot: Robot, recording: Recording) -> np.ndarray:
    """(n, 3, 3) rotations of the nominal flange."""
    frames = forward(robot, robot.mixing @ recording.joints.T)
    return np.stack(frames.end, -1).transpose(1, 0, 2)


def measured_rotations(recording: Recording) -> np.ndarray:
    """(n, 3, 3) rotations of a recording of poses."""
    quaternions = np.stack([recording.columns[f"q{axis}"] for axis in "xyzw"], axis=1)
    return Rotation.from_quat(quaternions).as_matrix()


def screened_rotations(
    flange: np.ndarray, candidates: Sequence[np.ndarray], max_count: int = _SCREENED
) -> list[int]:
    """Indices of the candidates whose angles between pairs of rows agree with those of the flange.

    flange (n, 3, 3); candidates (n, 3, 3) each. The angle of R_i^T R_j depends neither on the base nor on the tool,
    so that no fit is needed.
    """
    return least_misfits(rotation_misfits(flange, candidates), max_count)


def least_misfits(misfits: np.ndarray, max_count: int) -> list[int]:
    """Indices of the at most `max_count` smallest of the misfits (k,) rad not clearly larger than the least."""
    limit = _SCREEN_FACTOR * misfits.min() + _SCREEN_RAD
    order = np.argsort(misfits, kind="stable")
    return [int(k) for k in order[:max_count] if misfits[k] <= limit]


def rotation_misfits(flange: np.ndarray, candidates: Sequence[np.ndarray]) -> np.ndarray:
    """(k,) rad: RMS difference of the angles between pairs of rows, of each candidate (n, 3, 3) to the flange."""
    count = len(flange)
    rng = np.random.default_rng(0)
    first = rng.integers(0, count, _PAIRS)
    second = rng.integers(0, count, _PAIRS)
    wanted = _angles(flange[first], flange[second])
    return np.array(
        [np.sqrt(np.mean((_angles(c[first], c[second]) - wanted) ** 2)) for c in candidates]
    )


def _angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(m,) rad between rotations (m, 3, 3)."""
    chord = np.linalg.norm(first - second, axis=(1, 2)) / np.sqrt(8)
    return 2 * np.arcsin(np.minimum(chord, 1))
