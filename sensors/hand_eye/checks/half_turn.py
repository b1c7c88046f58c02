"""Rows in which a program read a symmetric board rotated by 180 deg: it counted the corners from the other end.

A chessboard with an even sum of inner corners in rows and columns looks the same after half a revolution. The relative
rotations show such rows, because flange and camera rotate by the same angle between two poses (Chen, CVPR 1991).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensors.hand_eye.checks.pose_data import PoseData
from sensors.hand_eye.checks.pose_fit import possible_labels
from workbench.core.rigid import rotation_vector

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
_EXPLAINS = 0.3
_AGREES_DEG = 2.0
_NAMED = 8


def half_turned_rows(data: PoseData) -> np.ndarray | None:
    """(P,) True for the minority of poses whose target is rotated by 180 deg; None where that explains nothing.

    data: with one labelling of the target.
    """
    with_rotated = replace(data, seen=np.concatenate([data.seen[:1], data.seen[:1] @ _HALF_TURN]))
    labels = min(possible_labels(with_rotated), key=lambda chosen: _gap_deg(with_rotated, chosen))
    before, after = (
        _gap_deg(with_rotated, np.zeros(data.count, int)),
        _gap_deg(with_rotated, labels),
    )
    if after > min(_EXPLAINS * before, _AGREES_DEG):
        return None
    rotated = labels == 1
    return ~rotated if rotated.sum() > data.count / 2 else rotated


def half_turn_sentence(rows: np.ndarray, names: Sequence[str]) -> str:
    """State which poses are rotated, and what to do; rows (P,) bool of the poses `names`."""
    chosen = [name for name, is_rotated in zip(names, rows) if is_rotated]
    remainder = f" and {len(chosen) - _NAMED} more" if len(chosen) > _NAMED else ""
    return (
        f"the target looks rotated by 180 deg about its normal in {', '.join(chosen[:_NAMED])}{remainder}: the program "
        "counted the corners of a symmetric board from the other end, which also moves the origin of the target; "
        "remove these rows, or measure with a board that has no such symmetry"
    )


def _gap_deg(data: PoseData, labels: np.ndarray) -> float:
    """Mean difference between the angles by which flange and camera rotate between two poses."""
    seen = data.seen[labels, np.arange(data.count)]
    i, j = np.triu_indices(data.count, 1)
    moved = data.moved[:, :3, :3].swapaxes(1, 2)
    angles = [_angles(turns[i], turns[j]) for turns in (moved, seen[:, :3, :3])]
    return float(np.degrees(np.abs(angles[0] - angles[1]).mean()))


def _angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(K,) rad, of the rotations R_i R_j' of first and second (K, 3, 3)."""
    return np.linalg.norm(rotation_vector(first @ second.swapaxes(1, 2)), axis=1)
