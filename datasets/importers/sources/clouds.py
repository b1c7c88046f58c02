"""Point clouds and profiles (two columns of text, or a FileStorage) without invalid points, thinned for a fit.

PLY and PCD are read through Open3D; XYZ, PTS and ASC are text, and NPY arrays (n, 3) or (rows, columns, 3).
"""

from itertools import chain, islice
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.sources import stored_profiles
from workbench.core.text.cloud_headers import pcd_problem, ply_problem

EXTENSIONS = {".ply", ".pcd", ".xyz", ".pts"}
_TEXT_CLOUD = ".asc"
PROFILES = {".csv", ".txt", ".dat", ".asc", ".tsv", *stored_profiles.EXTENSIONS}
_FEWEST = 4
_FARTHEST = 1e12
"""Of any unit of length: larger coordinates, such as the largest float, mark invalid points."""
_FEWEST_IN_PROFILE, _HEAD_LINES = 20, 400
_REPEATED, _REPEATED_SHARE, _TIMES_AS_OFTEN = 5, 0.02, 5.0
"""How often a value occurs that marks invalid points: in all, as a share, and over the second most frequent one."""


def is_profile(path: Path) -> bool:
    """Whether a file holds one profile of a laser profiler: lines of x and z after some titles, or a FileStorage."""
    if path.suffix.lower() in stored_profiles.EXTENSIONS:
        return stored_profiles.is_stored_profile(path)
    with path.open(encoding="utf-8", errors="replace") as file:
        head = [_numbers(line) for line in islice(file, _HEAD_LINES)]
        rows = [row for row in head if row]
        titles = len(head) - len(rows)
        # the depth of an invalid point may be an empty cell, of most points where the object is narrow
        if titles >= len(head) / 3 or any(len(row) > 2 for row in rows):
            return False
        all_rows = chain(rows, filter(None, map(_numbers, file)))
        pairs = (row for row in all_rows if len(row) == 2)
        return len(list(islice(pairs, _FEWEST_IN_PROFILE))) == _FEWEST_IN_PROFILE


def _numbers(line: str) -> list[float] | None:
    """All cells of a line as numbers; None where one is text."""
    decimal_comma = ";" in line or "\t" in line
    text = line.replace(",", ".") if decimal_comma else line.replace(",", " ")
    try:
        return [float(cell) for cell in text.replace(";", " ").split()]
    except ValueError:
        return None


def read_cloud(path: Path, max_points: int) -> np.ndarray:
    """(n, 3) points of a file in its own units, at most about `max_points`, spread evenly over the file.

    A profile has y = 0.

    Raises InputError where the file holds no points.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        points = np.load(path, allow_pickle=False).reshape(-1, 3).astype(float)
    elif suffix in {".xyz", ".pts"} or is_text_cloud(path):
        points = _read_xyz(path)
    elif suffix in stored_profiles.EXTENSIONS:
        points = stored_profiles.read_stored_profile(path)
    elif suffix in PROFILES:
        points = _read_profile(path)
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
    points = without_markers(points[(np.abs(points) < _FARTHEST).all(1)])
    if len(points) < _FEWEST:
        raise complaint(
            path.name,
            f"a cloud of {_FEWEST} points or more",
            f"{len(points)}",
            "export the cloud again",
        )
    if len(points) <= max_points:
        return points
    return points[np.linspace(0, len(points) - 1, max_points).astype(int)]


def is_text_cloud(path: Path) -> bool:
    """Whether an .asc file holds points: lines of three numbers or more after some titles."""
    if path.suffix.lower() != _TEXT_CLOUD:
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        rows = [_numbers(line) for _, line in zip(range(_HEAD_LINES), file)]
    filled = [row for row in rows if row]
    return len(filled) >= _FEWEST_IN_PROFILE and all(len(row) >= 3 for row in filled)


def is_array_cloud(path: Path) -> bool:
    """Whether a .npy file holds points: numbers with three in the last axis, in one or two others."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError):
        return False
    is_points = array.ndim in (2, 3) and array.shape[-1] == 3 and array.dtype.kind == "f"
    return is_points and array.size >= 3 * _FEWEST_IN_PROFILE


def without_markers(points: np.ndarray) -> np.ndarray:
    """The points (n, 3) without those whose depth marks an invalid measurement, such as 0, -9999 or -2147483.648.

    Such a depth stands in many points, the measured ones hardly ever agree in all digits, and it is 0 or lies outside
    of all others.
    """
    depths, counts = np.unique(points[:, 2], return_counts=True)
    if len(depths) < 3:
        return points
    most_frequent = int(counts.argmax())
    second = np.partition(counts, -2)[-2]
    is_frequent = counts[most_frequent] >= max(_REPEATED, _REPEATED_SHARE * len(points))
    is_end = most_frequent in (0, len(depths) - 1) or depths[most_frequent] == 0
    if not (is_frequent and is_end and counts[most_frequent] > _TIMES_AS_OFTEN * second):
        return points
    return points[points[:, 2] != depths[most_frequent]]


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
            numbers = _numbers(line)
            if numbers is not None and len(numbers) >= 3:
                rows.append(numbers[:3])
    return np.array(rows).reshape(-1, 3)
