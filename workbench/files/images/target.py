"""Poses of a board or marker that another program measured, and what it is fixed to (kind target-pose)."""

import numpy as np

from datasets.recording import Recording
from workbench.core.errors import InputError
from workbench.core.rigid import transform


def target_poses(recording: Recording) -> np.ndarray:
    """(n, 4, 4) T_sensor_target, mm, of every row."""
    from scipy.spatial.transform import Rotation

    quaternions = np.stack([recording.columns[f"q{axis}"] for axis in "xyzw"], axis=1)
    return transform(Rotation.from_quat(quaternions).as_matrix(), recording.points)


def stated_kind(recording: Recording) -> str:
    """ "to-hand" where the column fixed_to says that the target is on the flange ("tool"), else "in-hand".

    Raises InputError where rows differ.
    """
    fixed = recording.columns.get("fixed_to")
    if fixed is None:
        return "in-hand"
    found = np.unique(fixed)
    if len(found) > 1:
        raise InputError(
            f"{recording.name}, samples.csv, column fixed_to: expected one target, fixed to the base or to the tool, "
            f"found {' and '.join(found)}; split the recording"
        )
    return "to-hand" if found[0] == "tool" else "in-hand"
