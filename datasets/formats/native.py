"""Common parts of the readers of real sets: checked files, column names, and the finished recording."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from datasets import registry
from datasets.errors import complaint
from datasets.recording import Recording
from datasets.samples.columns import FLANGE

POINT = ("x_mm", "y_mm", "z_mm")
NOMINAL = "nominal values given with the measurements"


def checked(folder: Path, *names: str) -> list[Path]:
    """Paths of files of the set in `folder`, compared with their published checksums.

    Raises InputError.
    """
    paths = [folder / name for name in names]
    for path in paths:
        registry.check_file(folder.name, path, folder)
    return paths


def digest(paths: Sequence[Path]) -> str:
    """One sha256 of several files, in this order."""
    total = hashlib.sha256()
    for path in paths:
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def load_matrix(path: Path, variable: str) -> np.ndarray:
    """A 2-D array of a MATLAB file. Raises InputError where it cannot be read."""
    from scipy.io import loadmat

    try:
        return np.asarray(loadmat(path)[variable], float)
    except (KeyError, ValueError, TypeError, OSError, NotImplementedError) as problem:
        raise complaint(
            f"{path.parent.name}/{path.name}, variable {variable}",
            "a matrix",
            str(problem)[:60],
            "fetch the file again",
        ) from None


def recording(
    robot: Mapping,
    joints_deg: np.ndarray,
    points_mm: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    paths: Sequence[Path],
    title: str,
    sigma_mm: float | None,
) -> Recording:
    """An external-point recording, rows in order of acquisition and numbered from 1.

    joints_deg (n, J) degrees; points_mm (n, 3); `covariates` further columns (n,).
    """
    n = len(points_mm)
    if not len(joints_deg) == n or any(len(v) != n for v in covariates.values()):
        raise complaint(
            paths[0].parent.name,
            "as many joint readings as points",
            f"{len(joints_deg)} and {n}",
            "fetch the set again",
        )
    columns = {"sample": np.arange(1.0, n + 1)}
    columns |= {f"q{k + 1}_deg": joints_deg[:, k] for k in range(joints_deg.shape[1])}
    columns |= dict(zip(POINT, points_mm.T))
    columns |= {k: v if v.dtype.kind == "U" else v.astype(float) for k, v in covariates.items()}
    return Recording(
        "external-point", columns, robot, title=title, sigma_mm=sigma_mm, sha256=digest(paths)
    )


def image_recording(
    measures: str,
    rows: Sequence[Mapping],
    board: Mapping,
    paths: Sequence[Path],
    title: str,
    columns: Mapping[str, np.ndarray] | None = None,
    guess: Mapping | None = None,
) -> Recording:
    """A recording of images that stay where they lie.

    rows: as in images.csv; columns: of samples, where there are any; guess: as in recording.toml.
    """
    return Recording(
        measures,
        dict(columns or {}),
        {},
        title=title,
        images=tuple(rows),
        board=dict(board),
        guess=dict(guess or {}),
        sha256=digest(paths),
    )


def flange_columns(places_mm: np.ndarray, rotations_deg: np.ndarray) -> dict[str, np.ndarray]:
    """flange_x_mm … flange_qz from places (n, 3) and angles (n, 3) about the fixed axes x, then y, then z."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_euler("xyz", rotations_deg, degrees=True).as_quat(canonical=True).T
    return dict(zip(FLANGE, (*places_mm.T, w, x, y, z)))


def dh_robot(name: str, source: str, rows: Sequence[tuple], **joint_keys: Sequence) -> dict:
    """Keys of a robot.toml from distal rows (theta_deg, d_mm, a_mm, alpha_deg).

    A joint is marked `hayati` where its alpha is 0 or 180 and another joint follows: the next axis
    is parallel. `joint_keys` are further joint keys, one value a joint, None where a joint has none.
    """
    joints = []
    for k, (theta, d, a, alpha) in enumerate(rows):
        row = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        row["hayati"] = alpha % 180 == 0 and k + 1 < len(rows)
        joints.append(
            row | {key: values[k] for key, values in joint_keys.items() if values[k] is not None}
        )
    return {
        "name": name,
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": source,
        "joint": joints,
    }


IRB120 = {"builtin": "abb_irb120"}
"""Nominal arm of both IRB 120 sets, with the masses that gravity torques need."""
