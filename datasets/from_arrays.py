"""A recording made from arrays in memory, without files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.checks import Context, check_samples
from datasets.formats.table import Table
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml

_CALLED = "Recording.from_arrays"


def from_arrays(
    kind: type,
    robot: str | Mapping,
    joints_deg,
    points_mm,
    sigma_mm: float | None = None,
    quaternions=None,
    **columns,
):
    """A recording of points or poses that an external instrument measured.

    kind: `datasets.recording.Recording`, which this makes. robot: name of a built-in robot, path of
    a robot.toml or URDF, or the keys of a robot.toml.
    joints_deg: (n, J) joint readings, deg (mm for a prismatic joint). points_mm: (n, 3) measured
    points in the frame of the instrument. quaternions: (n, 4) w x y z of the target, where poses
    are measured. sigma_mm: 1 sigma of a coordinate. columns: further columns of samples.csv, such
    as `reflector`, `payload_kg`, `temperature_c` or `time_s`, each (n,).
    Raises InputError where shapes do not agree, a robot file cannot be read, or a value cannot be a
    measurement (nan, a quaternion that is not of length 1); the sentence names row (from 0) and column.
    """
    joints, points = np.asarray(joints_deg, float), np.asarray(points_mm, float)
    keys = _robot_keys(robot)
    n = len(points)
    if joints.ndim != 2 or len(joints) != n or points.shape != (n, 3):
        raise InputError(
            "Recording.from_arrays: expected joints_deg (n, J) and points_mm (n, 3), found "
            f"{joints.shape} and {points.shape}; transpose or select rows"
        )
    made = {"sample": np.arange(1.0, n + 1)}
    made |= dict(zip(_joint_names(keys, joints.shape[1]), joints.T))
    made |= {name: points[:, i] for i, name in enumerate(("x_mm", "y_mm", "z_mm"))}
    if quaternions is not None:
        rotations = np.asarray(quaternions, float)
        if rotations.shape != (n, 4):
            raise InputError(
                f"Recording.from_arrays: expected quaternions (n, 4) with w first, found {rotations.shape}"
            )
        made |= {name: rotations[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    for name, values in columns.items():
        made[name] = _column(name, values, n)
    measures = "external-point" if quaternions is None else "external-pose"
    _check(made, Context(measures, keys, sigma_mm=sigma_mm))
    return kind(measures, made, keys, sigma_mm=sigma_mm, name="arrays")


def _joint_names(keys: Mapping, count: int) -> list[str]:
    """Column names of joint readings: `_mm` where the robot file says that a joint is prismatic."""
    joints = keys.get("joint", keys.get("joints", ()))
    slides = [isinstance(one, Mapping) and one.get("kind") == "prismatic" for one in joints]
    slides += [False] * (count - len(slides))  # a wrong number is refused with the other checks
    return [f"q{k}_{'mm' if slides[k - 1] else 'deg'}" for k in range(1, count + 1)]


def _column(name: str, values, n: int) -> np.ndarray:
    """(n,) float64, or text. Raises InputError for another length."""
    cells = np.asarray(values)
    if cells.shape not in ((), (n,)):
        raise InputError(
            f"{_CALLED}, {name}: expected one number or {n} of them, one for each row, found an array "
            f"{cells.shape}; select rows"
        )
    cells = np.broadcast_to(cells, (n,))
    return cells if cells.dtype.kind in "US" else cells.astype(float)


def _check(columns: Mapping[str, np.ndarray], context: Context) -> None:
    """Raise InputError for the first value that samples.csv could not hold; rows count from 0, samples from 1."""
    rows = np.arange(len(columns["sample"]))
    check_samples(Table(_CALLED, dict(columns), rows), context)


def _robot_keys(robot: str | Mapping) -> Mapping:
    """What `Recording.robot` holds for a built-in name, a file or keys. Raises InputError."""
    if isinstance(robot, Mapping):
        return robot
    path = Path(robot)
    if path.suffix.lower() == ".urdf":
        return {"urdf": str(path)}
    if path.suffix.lower() != ".toml":
        return {"builtin": str(robot)}
    try:
        return read_toml(path)
    except (OSError, ContentError) as error:
        raise InputError(
            f"robot {path}: expected a robot file (TOML), found {error}; correct it"
        ) from error
