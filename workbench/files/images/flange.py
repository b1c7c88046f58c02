"""Flange poses of images: as the controller reports them, or from joint readings."""

from collections.abc import Sequence

import numpy as np

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.core.rigid import transform


def flange_poses(recording: Recording) -> np.ndarray:
    """(n, 4, 4) T_base_flange, mm, of every row of samples.csv.

    As recorded where that is there, else forward kinematics of the nominal robot. Raises InputError
    where there is neither.
    """
    if recording.flange is not None:
        return recording.flange
    if not recording.n or not recording.robot or not recording.joints.shape[1]:
        raise InputError(
            f"{recording.name}, samples.csv: expected flange poses (flange_x_mm … flange_qz) or joint readings "
            "and a robot, found neither; add the columns, and the column sample to images.csv"
        )
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    if recording.joints.shape[1] != robot.mixing.shape[1]:
        raise InputError(
            f"{recording.name}, samples.csv: expected {robot.mixing.shape[1]} joint readings for "
            f"'{robot.name}', found {recording.joints.shape[1]}; correct samples.csv or the robot"
        )
    frames = forward(robot, robot.mixing @ recording.joints.T)
    rotation = np.stack(frames.end, -1).transpose(1, 0, 2)
    return transform(rotation, frames.end_origin.T)


def rows_of_samples(recording: Recording, samples: Sequence[float]) -> np.ndarray:
    """(k,) row of samples.csv of each sample number (k,). Raises InputError for one that is not there."""
    sample_numbers = np.asarray(samples).astype(int)
    known_ids = recording.sample_ids
    missing = sample_numbers[~np.isin(sample_numbers, known_ids)]
    if missing.size:
        raise InputError(
            f"{recording.name}, images.csv, column sample: expected a row of samples.csv, found "
            f"{missing[0]}, which it does not have; correct the number"
        )
    order = np.argsort(known_ids)
    return order[np.searchsorted(known_ids, sample_numbers, sorter=order)]
