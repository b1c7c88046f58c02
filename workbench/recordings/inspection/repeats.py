"""Repeated measurements of one pose and target: how many there are and what noise they show.

The pooled variance of the groups is the noise alone, whatever the model of the robot leaves out (pure error; Draper &
Smith, Applied Regression Analysis, 3rd ed., section 2.1). Exact copies of a row are counted once.
"""

from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from workbench.core.rigid import nearest_rotation

_TARGETS = ("reflector", "ball", "point", "plane", "pair", "sphere", "payload_kg")
_POSITION = ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class Repeats:
    """`groups` of two rows or more and their `rows`; noise (1 sigma of a coordinate, of a rotation about an axis).

    `deviations` (3, k) mm of the repeated points from the mean of their group. nan where nothing is repeated.
    """

    groups: int
    rows: int
    noise_mm: float
    noise_deg: float
    deviations: np.ndarray

    def as_json(self) -> dict:
        """`repeats` of the answer."""
        return {"groups": self.groups, "rows": self.rows, "noise_deg": self.noise_deg}


def repeats_of(recording: Recording) -> Repeats:
    """Repeats of the rows that move with the tool."""
    moving = recording.select(recording.moving)
    none = Repeats(0, 0, np.nan, np.nan, np.empty((3, 0)))
    if moving.measures == "ball-surface" or not moving.n:
        return none
    moving = moving.without_duplicates()
    keys = [moving.poses, *(moving.columns[name] for name in _TARGETS if name in moving.columns)]
    _, group, counts = np.unique(np.stack(keys), axis=1, return_inverse=True, return_counts=True)
    group = group.ravel()
    members = [np.flatnonzero(group == number) for number in np.flatnonzero(counts > 1)]
    if not members:
        return none
    rows = sum(map(len, members))
    degrees = rows - len(members)
    if not all(name in moving.columns for name in _POSITION):
        return Repeats(len(members), rows, np.nan, np.nan, np.empty((3, 0)))
    deviations = np.concatenate([_centred(moving.points[group_rows]) for group_rows in members])
    noise_mm = float(np.sqrt((deviations**2).sum() / (3 * degrees)))
    return Repeats(
        len(members), rows, noise_mm, _rotation_noise(moving, members, degrees), deviations.T
    )


def _centred(points: np.ndarray) -> np.ndarray:
    return points - points.mean(0)


def _rotation_noise(moving: Recording, members, degrees: int) -> float:
    """1 sigma (deg) of the rotation about one axis; nan where rotations are not measured."""
    if "qw" not in moving.columns:
        return np.nan
    from scipy.spatial.transform import Rotation

    quaternions = np.stack([moving.columns[f"q{c}"] for c in "xyzw"], axis=1)
    rotations = Rotation.from_quat(quaternions).as_matrix()
    total = 0.0
    for group_rows in members:
        mean = nearest_rotation(rotations[group_rows].mean(0))
        total += float(
            (Rotation.from_matrix(mean.T @ rotations[group_rows]).magnitude() ** 2).sum()
        )
    return float(np.rad2deg(np.sqrt(total / (3 * degrees))))
