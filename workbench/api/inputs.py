"""Inputs of the Python API: folders and files as they are, recordings, tables and arrays by way of a file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text


def as_argument(value, name: str, folder: Path):
    """What a command takes for a Python value.

    value: a path, a text, a number, a `Recording`, a result of this API, a DataFrame or an array of
    joint readings in degrees (n, J). name: of the parameter; folder: where files are written for
    values that exist only in memory. Raises InputError for values of another type.
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
        return _written_readings(value, name, folder)
    return value


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


def _written_readings(values: np.ndarray, name: str, folder: Path) -> Path:
    if values.ndim != 2:
        raise InputError(
            f"{name}: expected an array of joint readings in degrees with one row for each target, "
            f"found {values.ndim} dimensions; reshape it"
        )
    header = [f"q{k}_deg" for k in range(1, values.shape[1] + 1)]
    path = folder / f"{name}.csv"
    path.write_text(csv_text(header, values.tolist()), encoding="utf-8")
    return path
