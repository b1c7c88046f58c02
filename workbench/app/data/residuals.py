"""Residuals of a run from its files: vectors by sample, and arrows in the robot's root frame."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.files.results import ARROWS

TABLE = "residuals.csv"
FIT = "fit"
HELD_OUT = "held_out"
NOMINAL = "nominal"
HELD_OUT_BEFORE = "held_out_before"
HELD_OUT_AFTER = "held_out_after"
_UNITS = ("_mm", "_px", "_deg")
ROTATION = "_deg"
"""End of a kind of residual of the orientation, such as "held_out_deg"."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Of m samples: `sample` (m,) numbers, `vectors` kind -> (3, m) mm, predicted minus measured.

    Kinds are "fit", "held_out" (nan where a row was never held out) and "nominal", or "before" and "after" of the fit
    of a diagnosis. `angles` kind -> (m,) deg, angle of the rotation from measured to predicted orientation, where
    poses or directions were measured. `points`, `arrows` (3, m) mm in the robot's root frame and `pose` (m,) are None
    where they are not known. `held_out_lengths` kind -> (m,) mm: of a diagnosis, which states no held-out vectors.
    """

    sample: np.ndarray
    vectors: dict[str, np.ndarray]
    points: np.ndarray | None = None
    arrows: np.ndarray | None = None
    pose: np.ndarray | None = None
    angles: Mapping[str, np.ndarray] = field(default_factory=dict)
    held_out_lengths: Mapping[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def lengths(self) -> dict[str, np.ndarray]:
        """Kind -> (m,) mm, 3-D length of the residual; kinds that end in "_deg" are angles in degrees."""
        found = {kind: np.sqrt((vector**2).sum(0)) for kind, vector in self.vectors.items()}
        found |= self.held_out_lengths
        return found | {f"{kind}{ROTATION}": values for kind, values in self.angles.items()}

    @cached_property
    def shown(self) -> np.ndarray:
        """(m,) mm: held-out length where there is one, else that of the fit (or "after" of a diagnosis)."""
        if HELD_OUT in self.lengths:
            return np.where(
                np.isfinite(self.lengths[HELD_OUT]), self.lengths[HELD_OUT], self.lengths[FIT]
            )
        return self.lengths.get(FIT, self.lengths.get("after"))


def read_residuals(folder: Path) -> Residuals | None:
    """Residuals of a run folder; None where it holds none in mm. Raises InputError for a file that cannot be read."""
    path = folder / TABLE
    if not path.is_file():
        return None
    columns = read_columns(path)
    _check_columns(path, columns)
    names = [name.removesuffix("_x_mm") for name in columns if name.endswith("_x_mm")]
    vectors = {name: np.stack([columns[f"{name}_{axis}_mm"] for axis in "xyz"]) for name in names}
    if not vectors or "sample" not in columns:
        return None
    sample = columns["sample"].astype(int)
    placed = _read_arrows(folder / ARROWS, sample)
    held_out = {
        kind: columns[f"{kind}_mm"]
        for kind in (HELD_OUT_BEFORE, HELD_OUT_AFTER)
        if f"{kind}_mm" in columns
    }
    return Residuals(sample, vectors, *placed, _angles(columns, vectors), held_out)


def _missing_components(columns: Mapping[str, np.ndarray]) -> list[str]:
    """Columns y and z that the vectors with a column x lack."""
    vectors = [name.removesuffix("_x_mm") for name in columns if name.endswith("_x_mm")]
    needed = [f"{name}_{axis}_mm" for name in vectors for axis in "xyz"]
    return [name for name in needed if name not in columns]


def _check_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Raise InputError where no column is a residual with its unit, or a vector lacks a component."""
    missing = _missing_components(columns)
    if not any(name.endswith(_UNITS) for name in columns):
        missing = ["fit_x_mm"]
    if missing:
        found = ", ".join(columns)[:80]
        raise InputError(
            f"{path}: expected a table of residuals with the column {missing[0]}, found {found}; calibrate again"
        )


def unit_of(kind: str) -> str:
    """Unit of a kind of residual."""
    return "deg" if kind.endswith(ROTATION) else "mm"


def updated_threshold(threshold: float, largest_before: float, largest: float) -> float:
    """Outlier threshold, mm, once the largest residual is another one.

    A threshold that a person chose stays; one that excludes nothing becomes the largest residual.
    """
    is_chosen = 0 < threshold < largest_before
    return threshold if is_chosen and threshold <= largest else largest


def _angles(columns: Mapping[str, np.ndarray], kinds: Iterable[str]) -> dict[str, np.ndarray]:
    """Kind -> (m,) deg: length of the rotation vector, or the angle between two directions."""
    found = {}
    for kind in kinds:
        components = [columns.get(f"{kind}_{axis}_deg") for axis in ("rx", "ry", "rz", "axis")]
        known = [part for part in components if part is not None]
        if known:
            found[kind] = np.sqrt((np.stack(known) ** 2).sum(0))
    return found


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of a residuals.csv by name. Raises InputError for a file that cannot be read."""
    import pyarrow as pa
    import pyarrow.csv as table

    try:
        read = table.read_csv(path)
        return {name: np.asarray(read[name].to_numpy(), float) for name in read.column_names}
    except (pa.ArrowInvalid, OSError, ValueError) as problem:
        reason = " ".join(str(problem).split())[:150]
        raise InputError(
            f"{path}: expected a table of residuals, found {reason}; calibrate again"
        ) from None


def _read_arrows(path: Path, sample: np.ndarray):
    """points (3, m), arrows (3, m) and pose (m,), each None where the file is missing or of other samples."""
    if not path.is_file():
        return None, None, None
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        read = pq.read_table(path, page_checksum_verification=True)
        columns = {name: read[name].to_numpy() for name in read.column_names}
        points = np.stack([columns[f"{axis}_mm"] for axis in "xyz"])
        arrows = np.stack([columns[f"d{axis}_mm"] for axis in "xyz"])
    except (pa.ArrowInvalid, OSError, KeyError) as problem:
        raise InputError(
            f"{path}: expected arrows of residuals, found {problem}; calibrate again"
        ) from None
    if not np.array_equal(columns["sample"].astype(int), sample):
        return None, None, None
    return points, arrows, columns["pose"].astype(int)
