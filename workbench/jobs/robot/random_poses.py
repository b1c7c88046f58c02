"""A recording at random poses: it shows which parameters no choice of poses determines."""

from dataclasses import replace

import numpy as np

from datasets.recording import OTHER, Recording
from datasets.samples.columns import joint_columns
from robot_model.robot import Robot

_ROWS = 400  # several times the parameters of an arm with all effects of the default plan
_TURN_DEG = 180.0  # either way, of a joint whose limits are not stated
_TRAVEL_MM = 100.0  # either way of its readings, of a slide whose limits are not stated


def at_random_poses(recording: Recording, robot: Robot) -> Recording:
    """Random rows of a recording (reflectors, loads, other columns) with random joint readings between the limits.

    The measured values stay those of the row: only derivatives of predictions are of use. The draw is always the
    same (seed 0).
    """
    generator = np.random.default_rng(0)
    rows = generator.integers(0, recording.n, max(_ROWS, recording.n))
    drawn = recording.select(rows)
    columns = dict(drawn.columns)
    for k, name in enumerate(joint_columns(recording.columns)):
        low, high = _range_of(recording.columns[name], name, robot.limits[k])
        for column in (name, OTHER + name):  # a length has readings at both ends
            if column in columns:
                columns[column] = generator.uniform(low, high, drawn.n)
    return replace(drawn, columns=columns)


def _range_of(readings: np.ndarray, name: str, limits: np.ndarray) -> tuple[float, float]:
    """Lowest and highest reading in the column's unit: the stated limits (rad, mm), else a turn or some travel."""
    is_slide = name.endswith("_mm")
    if np.isfinite(limits).all():
        stated = limits if is_slide else np.degrees(limits)
        return float(stated[0]), float(stated[1])
    if is_slide:
        return float(readings.min() - _TRAVEL_MM), float(readings.max() + _TRAVEL_MM)
    return -_TURN_DEG, _TURN_DEG
