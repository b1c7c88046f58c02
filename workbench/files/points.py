"""Named points in space, read from a table."""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.user_tables import read_named_points
from datasets.samples.columns import POINT

LABEL = "point"


def read_points(path: Path, unit: str | None = None) -> tuple[list[str] | None, np.ndarray]:
    """Labels (column `point`; None where there is none) and (n, 3) mm of a table in any form that the import reads.

    unit: of coordinates that state none; None asks for it. Raises InputError with file, row and column.
    """
    path = Path(path)
    table = read_named_points(path, (LABEL,), unit)
    for name in POINT:
        if name not in table.columns:
            found = ", ".join(list(table.columns)[:6])
            raise complaint(f"{path.name}, column {name}", "x_mm, y_mm and z_mm", found, "add it")
    points = np.stack([table.columns[name] for name in POINT], 1).astype(float)
    for row, column in np.argwhere(~np.isfinite(points)):
        found = f"{points[row, column]}"
        raise complaint(table.where(row, POINT[column]), "a finite number", found, "correct it")
    if LABEL not in table.columns:
        return None, points
    labels = [str(label) for label in table.columns[LABEL]]
    for row, label in enumerate(labels):
        if label in labels[:row]:
            raise complaint(
                table.where(row, LABEL), "every point once", label, "rename one of them"
            )
    return labels, points


__all__ = ["LABEL", "read_points"]
