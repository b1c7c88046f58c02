"""A recording made from arrays in memory, without files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml


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
    Raises InputError where shapes do not agree or the robot is not known.
    """
    joints, points = np.asarray(joints_deg, float), np.asarray(points_mm, float)
    keys = _robot_keys(robot)
    n = len(points)
    if joints.ndim != 2 or len(joints) != n or points.shape != (n, 3):
        raise InputError(
            "Recording.from_arrays: expected joints_deg (n, J) and points_mm (n, 3), found "
            f"{joints.shape} and {points.shape}; transpose or select rows"
        )
    made = {f"q{k + 1}_deg": joints[:, k] for k in range(joints.shape[1])}
    made |= {name: points[:, i] for i, name in enumerate(("x_mm", "y_mm", "z_mm"))}
    if quaternions is not None:
        rotations = np.asarray(quaternions, float)
        if rotations.shape != (n, 4):
            raise InputError(
                f"Recording.from_arrays: expected quaternions (n, 4) with w first, found {rotations.shape}"
            )
        made |= {name: rotations[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    for name, values in columns.items():
        made[name] = np.broadcast_to(np.asarray(values), (n,))
    measures = "external-point" if quaternions is None else "external-pose"
    return kind(measures, made, keys, sigma_mm=sigma_mm, name="arrays")


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
