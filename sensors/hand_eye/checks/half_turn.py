"""Rows in which a program read a target rotated by half or a quarter of a revolution about its normal.

A chessboard with an even sum of inner corners in rows and columns looks the same after half a revolution, and the
corners of a square marker may begin at any of the four. The relative rotations show such rows, because flange and
camera rotate by the same angle between two poses (Chen, CVPR 1991).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensors.hand_eye.checks.pose_data import PoseData
from sensors.hand_eye.checks.pose_fit import possible_labels
from workbench.core.rigid import rotation_vector

_HALF_TURNS, _QUARTER_TURNS = (0, 180), (0, 90, 180, 270)
_EXPLAINS = 0.3
_AGREES_DEG = 2.0
_NAMED = 8


def target_rotations_deg(data: PoseData) -> np.ndarray | None:
    """(P,) deg by which the target is rotated in the minority of poses, 0 in the others; None if that explains nothing.

    Multiples of 90 are tried where 180 explains nothing. data: with one labelling of the target.
    """
    for angles in (_HALF_TURNS, _QUARTER_TURNS):
        rotated = _rotated_rows(data, angles)
        if rotated is not None:
            return rotated
    return None


def _rotated_rows(data: PoseData, angles: Sequence[int]) -> np.ndarray | None:
    """The same for rotations by some angles in deg, the first of them 0."""
    seen = np.concatenate([data.seen[:1] @ _about_normal(angle) for angle in angles])
    with_rotated = replace(data, seen=seen)
    labels = min(possible_labels(with_rotated), key=lambda chosen: _gap_deg(with_rotated, chosen))
    before, after = (
        _gap_deg(with_rotated, np.zeros(data.count, int)),
        _gap_deg(with_rotated, labels),
    )
    if after > min(_EXPLAINS * before, _AGREES_DEG):
        return None
    # a label is the rotation that undoes the mistake, up to one rotation of all rows
    usual = np.bincount(labels, minlength=len(angles)).argmax()
    return (np.array(angles)[usual] - np.array(angles)[labels]) % 360


def _about_normal(angle_deg: int) -> np.ndarray:
    """(4, 4) rotation about the third axis by a multiple of 90 deg."""
    quarter_turns = angle_deg // 90 % 4
    cosine = (1, 0, -1, 0)[quarter_turns]
    sine = (0, 1, 0, -1)[quarter_turns]
    rotation = np.eye(4)
    rotation[:2, :2] = [[cosine, -sine], [sine, cosine]]
    return rotation


def rotated_target_sentence(angles_deg: np.ndarray, names: Sequence[str]) -> str:
    """State which poses are rotated, and what to do; angles_deg (P,) of the poses `names`: `target_rotations_deg`."""
    if set(angles_deg) <= set(_HALF_TURNS):
        chosen = [name for name, angle in zip(names, angles_deg) if angle]
        angle_words = "180 deg"
        why = "the program counted the corners of a symmetric board from the other end"
    else:
        chosen = [f"{name} ({angle} deg)" for name, angle in zip(names, angles_deg) if angle]
        angle_words = "multiples of 90 deg"
        why = "the program began the corners of a square target at another one"
    remainder = f" and {len(chosen) - _NAMED} more" if len(chosen) > _NAMED else ""
    return (
        f"the target looks rotated by {angle_words} about its normal in {', '.join(chosen[:_NAMED])}{remainder}: {why}"
        ", which also moves its origin if that is a corner; remove these rows, or measure with a target that has no "
        "such symmetry"
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
