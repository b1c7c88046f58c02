"""Arrays with names as tables: MATLAB .mat, OpenCV FileStorage and NumPy files.

An array (n, k) gives k columns "name 1" ... "name k"; poses (n, 4, 4) or (4, 4, n) give the twelve columns
"name r11" ... "name t3". Arrays of one length n stand side by side in one table.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable

_MOST_COLUMNS = 24
_FEWEST_ROWS = 3


def read_matlab(path: Path) -> list[RawTable]:
    """Tables of the arrays of a MATLAB file of version 7 or older, structures included.

    Raises InputError for HDF5 files (version 7.3) and for files without arrays of one row per sample.
    """
    from scipy.io import loadmat

    try:
        found = loadmat(path, squeeze_me=False, simplify_cells=False)
    except NotImplementedError:
        raise complaint(
            path.name,
            "a MATLAB file of version 7 or older",
            "version 7.3",
            "save it with save(file, ..., '-v7')",
        ) from None
    except Exception as problem:  # scipy raises many kinds for damaged files
        raise complaint(
            path.name, "a MATLAB file", f"a damaged one ({problem})", "save it again"
        ) from None
    arrays: dict[str, np.ndarray] = {}
    for name, value in found.items():
        if not name.startswith("__"):
            _collect(name, value, arrays)
    return tables_of_arrays(path, arrays)


def _collect(name: str, value, arrays: dict[str, np.ndarray]) -> None:
    """Numeric arrays of a variable; fields of a structure get the structure's name in front."""
    value = np.asarray(value)
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            _collect(f"{name} {field}", value.ravel()[0][field], arrays)
    elif value.dtype.kind in "fiu":
        arrays[name] = value.astype(float)


def read_numpy(path: Path) -> list[RawTable]:
    """Tables of a .npy or .npz file; pickled objects are refused. Raises InputError."""
    try:
        found = np.load(path, allow_pickle=False)
        arrays = (
            {path.stem: found}
            if isinstance(found, np.ndarray)
            else {k: found[k] for k in found.files}
        )
    except Exception as problem:  # numpy raises many kinds for damaged files
        raise complaint(
            path.name, "arrays of numbers", f"another content ({problem})", "save plain arrays"
        ) from None
    return tables_of_arrays(
        path, {k: v.astype(float) for k, v in arrays.items() if v.dtype.kind in "fiu"}
    )


def tables_of_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> list[RawTable]:
    """One table for each length that arrays share. Raises InputError where no array has one row per sample."""
    by_length: dict[int, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        for rows, columns in _as_columns(name, array):
            by_length.setdefault(rows, {}).update(columns)
    tables = [
        RawTable(path.name, columns, np.arange(1, rows + 1))
        for rows, columns in by_length.items()
        if rows >= _FEWEST_ROWS
    ]
    if not tables:
        raise complaint(
            path.name,
            "arrays with one row per sample",
            "none",
            "save joints and points as n x k arrays",
        )
    return tables


def _as_columns(name: str, array: np.ndarray):
    """(rows, columns) of one array; nothing for scalars and for arrays that are no table."""
    array = np.squeeze(array) if array.ndim > 2 else array
    if array.ndim == 3:
        if array.shape[:2] == (4, 4) and array.shape[2] != 4:
            array = array.transpose(2, 0, 1)
        if array.shape[1:] == (4, 4):
            yield len(array), pose_columns(name, array)
        return
    if array.ndim == 1 or 1 in array.shape:
        array = array.reshape(-1, 1)
    if array.ndim != 2:
        return
    if array.shape[1] > _MOST_COLUMNS and array.shape[0] <= _MOST_COLUMNS:
        array = array.T
    if array.shape[1] == 1:
        yield len(array), {name: array[:, 0]}
    elif array.shape[1] <= _MOST_COLUMNS:
        yield len(array), {f"{name} {k + 1}": array[:, k] for k in range(array.shape[1])}


def pose_columns(name: str, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Columns "name r11" ... "name r33" and "name x", "name y", "name z" of homogeneous transforms (n, 4, 4)."""
    columns = {}
    for row in range(3):
        for column in range(3):
            columns[f"{name} r{row + 1}{column + 1}"] = poses[:, row, column]
    for row, axis in enumerate("xyz"):
        columns[f"{name} {axis}"] = poses[:, row, 3]
    return columns
