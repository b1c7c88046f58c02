"""Point clouds (PLY, PCD, XYZ) through Open3D and profiles (two columns of text), thinned to what a fit can use."""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from workbench.core.text.cloud_headers import pcd_problem, ply_problem

EXTENSIONS = {".ply", ".pcd", ".xyz", ".pts"}
PROFILES = {".csv", ".txt", ".dat", ".asc", ".tsv"}
_FEWEST = 4
_FEWEST_IN_PROFILE, _HEAD_LINES = 20, 60


def is_profile(path: Path) -> bool:
    """Whether a text file holds one profile of a laser profiler: lines of two numbers, x and z, after some titles."""
    with path.open(encoding="utf-8", errors="replace") as file:
        head = [line for _, line in zip(range(_HEAD_LINES), file)]
    numbers = [_numbers(line) for line in head]
    rows = [row for row in numbers if row]
    titles = len(head) - len(rows)
    is_pair = bool(rows) and all(len(row) == 2 for row in rows)
    return is_pair and len(rows) >= _FEWEST_IN_PROFILE and titles < len(rows) / 2


def _numbers(line: str) -> list[float] | None:
    """All cells of a line as numbers; None where one is text."""
    decimal_comma = ";" in line or "\t" in line
    text = line.replace(",", ".") if decimal_comma else line.replace(",", " ")
    try:
        return [float(cell) for cell in text.replace(";", " ").split()]
    except ValueError:
        return None


def read_cloud(path: Path, most: int) -> np.ndarray:
    """(n, 3) points of a file in its own units, at most about `most`, spread evenly over the file.

    A profile has y = 0.

    Raises InputError where the file holds no points.
    """
    if path.suffix.lower() in PROFILES:
        points = _read_profile(path)
    elif path.suffix.lower() in {".xyz", ".pts"}:
        points = _read_xyz(path)
    else:
        _check_header(path)
        import open3d

        with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            try:
                points = np.asarray(open3d.io.read_point_cloud(str(path)).points)
            except (MemoryError, RuntimeError) as problem:
                raise complaint(
                    path.name, "a point cloud", f"a damaged one ({problem})", "export it again"
                ) from None
    points = points[np.isfinite(points).all(1)]
    if len(points) < _FEWEST:
        raise complaint(
            path.name,
            f"a cloud of {_FEWEST} points or more",
            f"{len(points)}",
            "export the cloud again",
        )
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(int)]


def _check_header(path: Path) -> None:
    """Raise InputError for a header that the parsers of Open3D do not survive."""
    problem = (ply_problem if path.suffix.lower() == ".ply" else pcd_problem)(path)
    if problem:
        raise complaint(path.name, "a point cloud", problem, "export the cloud again")


def _read_profile(path: Path) -> np.ndarray:
    """(n, 3) x, 0, z of every line of two numbers."""
    with path.open(encoding="utf-8", errors="replace") as file:
        rows = [row for row in map(_numbers, file) if row is not None and len(row) == 2]
    cells = np.array(rows, float).reshape(-1, 2)
    return np.stack([cells[:, 0], np.zeros(len(cells)), cells[:, 1]], axis=1)


def _read_xyz(path: Path) -> np.ndarray:
    """(n, 3) the first three numbers of every line; other lines are titles."""
    rows = []
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            cells = line.replace(",", " ").replace(";", " ").split()
            try:
                rows.append([float(cell) for cell in cells[:3]])
            except ValueError:
                continue
    return np.array([row for row in rows if len(row) == 3]).reshape(-1, 3)
