"""Point clouds of a ball (PLY, PCD, XYZ) through Open3D, thinned to what a ball fit can use."""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from workbench.core.text.cloud_headers import pcd_problem, ply_problem

EXTENSIONS = {".ply", ".pcd", ".xyz", ".pts"}
_FEWEST = 4


def read_cloud(path: Path, most: int) -> np.ndarray:
    """(n, 3) points of a file in its own units, at most about `most`, spread evenly over the file.

    Raises InputError where the file holds no points.
    """
    if path.suffix.lower() in {".xyz", ".pts"}:
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
