"""Inputs of the Python API: folders and files as they are, recordings, tables and arrays by way of a file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text


def as_argument(value, name: str, folder: Path):
    """Argument of a command for a Python value.

    value: a path, a text, a number, a `Recording`, a result of this API, a DataFrame or an array of
    joint readings in degrees (n, J), or of points (n, 3) in mm for `source` and `target`. name: of the parameter;
    folder: where files are written for values that exist only in memory. Raises InputError for arrays of another shape.
    """
    if hasattr(value, "answer") and hasattr(value, "folder"):
        return _run_of(value, name)
    if hasattr(value, "measures") and hasattr(value, "columns"):
        return str(_written_recording(value, folder))
    if hasattr(value, "to_csv"):
        path = folder / f"{name}.csv"
        value.to_csv(path, index=False)
        return path
    if isinstance(value, np.ndarray):
        return _written_array(value, name, folder)
    return value


def sources_list(values, folder: Path) -> list:
    """Sources of an import: one or several files, folders or tables; a table becomes a file."""
    if isinstance(values, (str, Path)) or hasattr(values, "to_csv"):
        values = [values]
    return [as_argument(value, f"table-{k}", folder) for k, value in enumerate(values, 1)]


def sample_list(values: Sequence[int] | Path | str | None, name: str, folder: Path) -> Path | None:
    """A file with one sample number on each line, for numbers in a sequence."""
    if values is None or isinstance(values, (str, Path)):
        return None if values is None else Path(values)
    path = folder / f"{name}.txt"
    path.write_text("".join(f"{int(value)}\n" for value in values), encoding="utf-8")
    return path


def _run_of(result, name: str) -> Path:
    if result.folder is None:
        raise InputError(
            f"{name}: expected a result with a run folder, found one of {result.command}, which writes none; "
            "give the result of calibrate or diagnose"
        )
    return result.folder


def _written_recording(recording, folder: Path) -> Path:
    """The recording as a folder. A recording that was read from a folder with images stays where it is."""
    if recording.images and recording.folder is not None:
        return recording.folder
    from datasets import write

    path = folder / (recording.name or "recording")
    write(recording, path)
    return path


_POINTS = ("source", "target")


def _written_array(values: np.ndarray, name: str, folder: Path) -> Path:
    if values.ndim != 2 or (name in _POINTS and values.shape[1] != 3):
        expected = "points (n, 3) in mm" if name in _POINTS else "joint readings in degrees (n, J)"
        raise InputError(
            f"{name}: expected an array of {expected}, with one row for each, found shape {values.shape}; reshape it"
        )
    header = ["x_mm", "y_mm", "z_mm"]
    if name not in _POINTS:
        header = [f"q{k}_deg" for k in range(1, values.shape[1] + 1)]
    path = folder / f"{name}.csv"
    path.write_text(csv_text(header, values.tolist()), encoding="utf-8")
    return path
