"""Numbers of published tables, with their source: facts to compare with, copied as printed.

One TOML file per paper, named after first author and year. A key `csv` of a table names a CSV file in
the same folder; `load` replaces it by arrays.
"""

import csv
import tomllib
from collections.abc import Mapping
from importlib import resources

import numpy as np

from datasets.errors import complaint


def names() -> list[str]:
    """Papers that `load` knows."""
    return sorted(
        f.name.removesuffix(".toml")
        for f in resources.files(__name__).iterdir()
        if f.name.endswith(".toml")
    )


def load(name: str) -> dict:
    """Tables of the paper `name` ("gubankov-2022"), units in the keys.

    Raises InputError for a name that is not known.
    """
    if name not in names():
        raise complaint(
            f"paper {name}", f"one of {', '.join(names())}", repr(name), "correct the name"
        )
    text = resources.files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return {key: _with_arrays(value) for key, value in tomllib.loads(text).items()}


def _with_arrays(value):
    if not isinstance(value, Mapping) or "csv" not in value:
        return value
    text = resources.files(__name__).joinpath(value["csv"]).read_text(encoding="utf-8")
    header, *rows = csv.reader(text.splitlines())
    columns = np.array(rows, float).T
    return {**{k: v for k, v in value.items() if k != "csv"}, **dict(zip(header, columns))}


def cloud(table: Mapping, name: str) -> np.ndarray:
    """(n, 3) points of the columns <name>_x_mm, <name>_y_mm, <name>_z_mm, mm."""
    return np.stack([table[f"{name}_{axis}_mm"] for axis in "xyz"], axis=1)


def registration_rms(points: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square 3-D distance of two (n, 3) clouds of corresponding points after registration.

    Both are centred and one is turned onto the other by the best rotation (Kabsch 1976, as in
    `scipy.spatial.transform.Rotation.align_vectors`). Unit of the points.
    """
    from scipy.spatial.transform import Rotation

    a, b = reference - reference.mean(axis=0), points - points.mean(axis=0)
    rotation, _ = Rotation.align_vectors(a, b)
    return float(np.sqrt(np.mean(np.sum((a - rotation.apply(b)) ** 2, axis=1))))
