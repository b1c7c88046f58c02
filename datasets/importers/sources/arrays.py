"""Arrays with names as tables: MATLAB .mat, OpenCV FileStorage and NumPy files.

An array (n, k) gives k columns "name 1" ... "name k"; poses (n, 4, 4) or (4, 4, n) give the twelve columns
"name r11" ... "name z", and rotations (n, 3, 3) or (3, 3, n) the first nine of them. Arrays of one length n stand side
by side in one table.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable

_MOST_COLUMNS = 24
_FEWEST_ROWS = 3
_POSES = ((3, 3), (3, 4), (4, 4))
"""Shapes of rotations and of transforms."""
_HDF5_NOT_NUMBERS = (b"char", b"cell", b"logical", b"struct")


def read_matlab(path: Path) -> list[RawTable]:
    """Tables of the arrays of a MATLAB file, structures included; version 7.3 is HDF5 and needs h5py.

    Raises InputError for files without arrays of one row per sample, ModuleNotFoundError without h5py.
    """
    from scipy.io import loadmat

    try:
        found = loadmat(path, squeeze_me=False, simplify_cells=False)
    except NotImplementedError:  # scipy reads versions 4 to 7.2
        return tables_of_arrays(path, _hdf5_arrays(path))
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
    elif value.dtype.names:
        for field in value.dtype.names:
            stacked = _stacked([element[field] for element in value.ravel()])
            if stacked is not None:
                arrays[f"{name} {field}"] = stacked
    elif value.dtype.kind in "fiu":
        arrays[name] = value.astype(float)
    elif value.dtype.kind == "O" and value.size:  # a cell array
        stacked = _stacked(value.ravel())
        if stacked is not None:
            arrays[name] = stacked


def _stacked(cells) -> np.ndarray | None:
    """(n, k) numbers of n structures or cells, or (n, 4, 4) of transforms; None where they hold anything else."""
    arrays = [np.asarray(cell) for cell in cells]
    if len({part.shape for part in arrays}) > 1 or arrays[0].dtype.kind not in "fiu":
        return None
    stacked = np.stack(arrays).astype(float)
    is_pose = stacked.shape[1:] in _POSES
    return stacked if is_pose else stacked.reshape(len(arrays), -1)


def _hdf5_arrays(path: Path) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file of version 7.3 by name; fields of a structure have its name in front.

    MATLAB stores arrays column by column and HDF5 row by row, so that the axes are in reverse order in the file.
    """
    import h5py

    arrays: dict[str, np.ndarray] = {}

    def collect(name: str, node) -> None:
        words = name.split("/")
        is_number = isinstance(node, h5py.Dataset) and node.dtype.kind in "fiu"
        if words[0].startswith("#") or not is_number or "MATLAB_empty" in node.attrs:
            return
        if node.attrs.get("MATLAB_class", b"double") not in _HDF5_NOT_NUMBERS:
            arrays[" ".join(words)] = np.asarray(node[()], float).T

    try:
        with h5py.File(path, "r") as file:
            file.visititems(collect)
    except Exception as problem:  # the library raises many kinds for damaged files
        raise complaint(
            path.name, "a MATLAB file", f"a damaged one ({problem})", "save it again"
        ) from None
    return arrays


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


def read_parquet(path: Path) -> list[RawTable]:
    """The table of a Parquet or Feather file: numbers, and text of all other columns. Raises InputError."""
    import pandas

    try:
        is_feather = path.suffix.lower() == ".feather"
        frame = pandas.read_feather(path) if is_feather else pandas.read_parquet(path)
    except Exception as problem:  # the libraries raise many kinds for damaged files
        raise complaint(
            path.name, "a Parquet table", f"a damaged file ({problem})", "write it again"
        ) from None
    columns = {}
    for name in frame.columns:
        cells = frame[name]
        is_number = pandas.api.types.is_numeric_dtype(cells)
        columns[str(name)] = cells.to_numpy(float) if is_number else cells.astype(str).to_numpy("U")
    return [RawTable(path.name, columns, np.arange(1, len(frame) + 1))]


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
    pairs = _pairs_of_poses(array)
    if pairs is not None:
        for number, part in enumerate(pairs, 1):
            yield from _as_columns(f"{name} {number}", part)
        return
    if array.ndim == 3:
        if array.shape[:2] in _POSES and array.shape[2] != array.shape[1]:
            array = array.transpose(2, 0, 1)
        if array.shape[1:] in _POSES[1:]:
            yield len(array), pose_columns(name, array)
        elif array.shape[1:] == _POSES[0]:
            yield len(array), rotation_columns(name, array)
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


def _pairs_of_poses(array: np.ndarray) -> list[np.ndarray] | None:
    """Two arrays of poses of one that holds both: (n, 2, 4, 4), (2, n, 4, 4), or lists of 6 or 7 numbers; else None."""
    is_pose = array.shape[2:] in _POSES[1:] or array.ndim == 3 and array.shape[2] in (6, 7)
    if not is_pose or 2 not in array.shape[:2]:
        return None
    if array.shape[1] == 2:
        array = array.swapaxes(0, 1)
    return list(array)


def rotation_columns(name: str, rotations: np.ndarray) -> dict[str, np.ndarray]:
    """Columns "name r11" ... "name r33" of rotations (n, 3, 3), or of transforms (n, 4, 4)."""
    columns = {}
    for row in range(3):
        for column in range(3):
            columns[f"{name} r{row + 1}{column + 1}"] = rotations[:, row, column]
    return columns


def pose_columns(name: str, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Columns "name r11" ... "name r33" and "name x", "name y", "name z" of transforms (n, 4, 4) or (n, 3, 4)."""
    columns = rotation_columns(name, poses)
    for row, axis in enumerate("xyz"):
        columns[f"{name} {axis}"] = poses[:, row, 3]
    return columns
