"""Joint readings as counts of the encoders (Yaskawa: pulses): converted by the counts of one degree, never guessed."""

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.importers.units import COUNTS

_MOST_DEG = 3600.0
"""Ten revolutions: whole numbers beyond are no degrees."""


def refuse_counts(table: RawTable, mapping: Mapping) -> None:
    """Raise InputError where the joint readings are counts of encoders and the mapping does not state their size."""
    group = mapping.joints
    if group is None or group.counts_per_deg is not None:
        return
    columns = [table.columns[name] for name in group.columns if name in table.columns]
    if not columns or any(cells.dtype.kind != "f" for cells in columns):
        return
    largest = max((_largest(cells) for cells in columns), default=0.0)
    units = {read_header(name, table.units.get(name)).unit for name in group.columns}
    is_stated = COUNTS in units
    is_open = group.unit is None and _are_whole(columns) and largest > _MOST_DEG
    if is_stated or is_open:
        names = ", ".join(f'"{name}"' for name in group.columns)
        ratios = ", ".join(["?"] * len(group.columns))
        raise complaint(
            f"{table.file}, columns {', '.join(group.columns)}",
            "angles of the joints",
            f"pulses of the encoders, whole numbers up to {largest:.0f}, each of which needs the ratio of its gear",
            "export the joint angles in degrees, or state how many pulses make one degree, negative where the joint "
            f"turns the other way: [joints] columns = [{names}] and counts_per_deg = [{ratios}] in a mapping file for "
            "--map",
        )


def _largest(cells: np.ndarray) -> float:
    return float(np.nanmax(np.abs(cells), initial=0.0))


def _are_whole(columns: list[np.ndarray]) -> bool:
    cells = np.concatenate(columns)
    filled = cells[np.isfinite(cells)]
    return len(filled) > 0 and bool((filled % 1 == 0).all())
