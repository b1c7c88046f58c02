"""Universal Robots UR10 with a Leica laser tracker and T-Mac: poses of a grid, with the ambient temperature.

Series A of Landgraf et al., "A Hybrid Neural Network Approach for Increasing the Absolute Accuracy of
Industrial Robots", IEEE CASE 2021. One CSV file, semicolons and decimal commas.
"""

import io
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.formats.native import checked, dh_robot, recording
from datasets.recording import Recording

FAR_MM = 4000.0
"""A point farther than this from the median point is a lost target."""
_JOINTS = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)


def read(folder: Path, variant: str) -> Recording:
    """One row a pose in order of time; rows without a measurement or of a lost target are left out.

    `sample` is the row of the file below its header. The source states no uncertainty.
    """
    paths = checked(folder, "measurements_grid.csv")
    table = _table(paths[0])
    points = np.stack([table[f"measurement_{axis}"] for axis in "xyz"], axis=1)
    angles = np.stack([table[f"measurement_r{axis}"] for axis in "xyz"], axis=1)
    joints = np.rad2deg(np.stack([table[name] for name in _JOINTS], axis=1))
    is_finite = np.isfinite(
        np.column_stack([points, angles, joints, table["measurement_temperature"]])
    ).all(axis=1)
    distance = np.linalg.norm(points - np.median(points[is_finite], axis=0), axis=1)
    good = is_finite & (distance < FAR_MM)
    seconds = _seconds(table["Timestamp"])
    rows = np.flatnonzero(good)
    rows = rows[np.argsort(seconds[rows], kind="stable")]  # ten rows of the file stand out of order
    covariates = _orientation(angles[rows])
    covariates |= {"time_s": seconds[rows], "temperature_c": table["measurement_temperature"][rows]}
    title = "Universal Robots UR10, Leica T-Mac poses, grid"
    made = recording(_robot(), joints[rows], points[rows], covariates, paths, title, None)
    columns = made.columns | {
        "sample": rows + 1.0
    }  # the row of the file, so that rows left out show as gaps
    return replace(made, measures="external-pose", columns=columns)


def _table(path: Path) -> np.ndarray:
    """Columns by name. Raises InputError where the file is no such table."""
    text = path.read_text(encoding="utf-8").replace(",", ".")
    table = np.genfromtxt(
        io.StringIO(text), delimiter=";", names=True, deletechars="", replace_space=" "
    )
    wanted = {*_JOINTS, "Timestamp", "measurement_temperature"}
    missing = sorted(wanted - set(table.dtype.names or ()))
    if missing:
        raise complaint(
            f"{path.parent.name}/{path.name}",
            "its columns by name",
            f"none called {missing[0]}",
            "fetch the file again",
        )
    return table


def _orientation(angles_deg: np.ndarray) -> dict[str, np.ndarray]:
    """Columns qw qx qy qz from intrinsic Euler angles X, Y, Z (n, 3) in degrees."""
    x, y, z, w = Rotation.from_euler("XYZ", angles_deg, degrees=True).as_quat(canonical=True).T
    return {"qw": w, "qx": x, "qy": y, "qz": z}


def _seconds(stamps: np.ndarray) -> np.ndarray:
    """(n,) s since the first row, from numbers YYYYMMDDhhmmss."""
    moments = [datetime.strptime(f"{stamp:.0f}", "%Y%m%d%H%M%S") for stamp in stamps]
    return np.array([(moment - moments[0]).total_seconds() for moment in moments])


def _robot() -> dict:
    """Nominal kinematics without masses, which the source does not state."""
    rows = (
        (0.0, 127.3, 0.0, 90.0),
        (0.0, 0.0, -612.0, 0.0),
        (0.0, 0.0, -572.3, 0.0),
        (0.0, 163.941, 0.0, 90.0),
        (0.0, 115.7, 0.0, -90.0),
        (0.0, 92.2, 0.0, 0.0),
    )
    return dh_robot(
        "Universal Robots UR10", "Denavit-Hartenberg parameters published by Universal Robots", rows
    )
