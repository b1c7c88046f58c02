"""Profiles of a laser profiler in files of OpenCV's FileStorage: one profile in each file, and nothing else.

The points are a matrix (n, 2) of x and z, a matrix (n, 3) of x, 0 and z, or one list x, 0, z, x, 0, z, ...
"""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.sources.storage import is_file_storage, stored_arrays

EXTENSIONS = {".yml", ".yaml"}
_FEWEST_POINTS = 20


def is_stored_profile(path: Path) -> bool:
    """Whether a file holds one profile as a FileStorage."""
    return path.suffix.lower() in EXTENSIONS and _profile(path) is not None


def read_stored_profile(path: Path) -> np.ndarray:
    """(n, 3) x, 0, z of a profile, in the unit of the file. Raises InputError for a file that holds none."""
    points = _profile(path)
    if points is None:
        raise complaint(path.name, "one profile", "none", "export the profile again")
    return points


def _profile(path: Path) -> np.ndarray | None:
    """(n, 3) x, 0, z; None where the file holds something else, or several arrays."""
    arrays = stored_arrays(path) if is_file_storage(path) else None
    if arrays is None or len(arrays) != 1:
        return None
    (array,) = arrays.values()
    if array.size == 0:
        return None
    cells = array.reshape(len(array), -1)
    if cells.shape[1] == 1 and len(cells) % 3 == 0:
        cells = cells.reshape(-1, 3)
    count, width = cells.shape
    if count < _FEWEST_POINTS or width not in (2, 3):
        return None
    if width == 2:
        return np.insert(cells, 1, 0.0, axis=1)
    is_in_plane = np.all(cells[:, 1] == 0)
    return cells if is_in_plane else None
