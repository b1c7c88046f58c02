"""Profiles of one ball by a laser-line profiler on an arm: 15 with R = 40 mm, 10 with R = 12.7 mm.

`scan_line` of each YAML file: x, 0, z in mm again and again, .Nan where nothing came back. Poses: X Y Z in
mm, W P R in degrees, the flange's rotation Rz(R) Ry(P) Rx(W). There are no joint angles. Rows are all
that came back, including points on the table.
"""

import json
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.formats.native import checked, digest, flange_columns
from datasets.recording import Recording

VARIANTS = {
    "r40": (40.0, "r40_session/RobPoses.rob", "r40_session/p{}.yml", 15),
    "r12": (12.7, "r12_session/robpose.txt", "r12_session/{}_3C_line.yml", 10),
}


def read(folder: Path, variant: str) -> Recording:
    """One row a point of the surface; `pose` is the profile, counted from 1. The ball is artefact 1 at the origin."""
    radius, poses, profile, count = VARIANTS[variant]
    paths = checked(folder, poses, *(profile.format(k) for k in range(1, count + 1)))
    profiles = [_profile(path) for path in paths[1:]]
    pose = np.repeat(np.arange(count), [len(p) for p in profiles])
    points, flange = np.concatenate(profiles), _poses(paths[0], count)[pose]
    columns = {
        "sample": np.arange(1.0, len(points) + 1),
        "pose": pose + 1.0,
        "ball": np.ones(len(points)),
        **dict(zip(("x_mm", "y_mm", "z_mm"), points.T)),
        **flange_columns(flange[:, :3], flange[:, 3:]),
    }
    return Recording(
        "ball-surface",
        columns,
        {},
        title=f"Profiles of a ball of R {radius:g} mm, flange poses",
        balls={1: (0.0, 0.0, 0.0, radius)},
        sha256=digest(paths),
    )


def _profile(path: Path) -> np.ndarray:
    """(n, 3) mm in the sensor's frame."""
    text = path.read_text(encoding="utf-8")
    try:
        cells = text[text.index("[") + 1 : text.rindex("]")].replace(".Nan", "nan").split(",")
        points = np.array([float(cell) for cell in cells]).reshape(-1, 3)
    except ValueError as problem:
        raise complaint(
            f"{path.parent.name}/{path.name}",
            "x, y and z in a scan_line",
            str(problem)[:60],
            "fetch it again",
        ) from None
    return points[np.isfinite(points).all(1)]


def _poses(path: Path, count: int) -> np.ndarray:
    """(count, 6) X Y Z W P R."""
    text = path.read_text(encoding="utf-8")
    as_json = path.suffix == ".rob"
    found = np.array(
        json.loads(text)["RobPoses"] if as_json else [line.split() for line in text.splitlines()],
        float,
    )
    if found.shape != (count, 6):
        raise complaint(
            f"{path.parent.name}/{path.name}",
            f"{count} poses of 6 numbers",
            str(found.shape),
            "fetch it again",
        )
    return found
