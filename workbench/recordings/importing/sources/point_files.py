"""Points of several reflectors in a file each, next to one file with the joint readings of the same rows.

Reflectors on one tool keep their distances from one another, and the vectors between them rotate with the tool.
"""

from collections.abc import Mapping as Keys
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from workbench.recordings.importing.target_poses.layouts import counts_rows

_RIGID, _ROTATED = 0.01, 0.01
"""Of the distance between two reflectors: its change, and that of the vector between them, over the rows."""
_FEWEST = 4


def with_point_files(
    tables: Sequence[RawTable], mapping: Mapping
) -> tuple[list[RawTable], Mapping] | None:
    """The tables with those of single reflectors side by side in one, and the mapping that names the reflectors.

    None where the mapping names other columns, or where no two or more files of points that keep their distances stand
    next to one file of other quantities with as many rows.
    """
    points = {table.stem: names for table in tables if (names := _point_of(table))}
    files = [table for table in tables if table.stem in points]
    others = [table for table in tables if table.stem not in points]
    is_row_by_row = len({table.n for table in tables}) == 1 and tables[0].n >= _FEWEST
    if len(files) < 2 or len(points) < len(files) or len(others) != 1 or not is_row_by_row:
        return None
    reflectors = {stem: tuple(f"{stem}: {name}" for name in points[stem]) for stem in points}
    is_stated = dict(mapping.reflectors) == reflectors
    is_open = mapping.point is None and not mapping.reflectors and mapping.join.by is None
    if not is_stated and not (is_open and _on_one_tool(files, points)):
        return None
    joined = _side_by_side(files, points)
    first = Group(next(iter(reflectors.values())))
    mapping = mapping if is_stated else replace(mapping, reflectors=reflectors, point=first)
    return [*others, joined], mapping


def _on_one_tool(files: Sequence[RawTable], points: Keys[str, Sequence[str]]) -> bool:
    """Whether the points of each two files keep their distance."""
    seen = [
        np.stack([table.columns[name] for name in points[table.stem]], axis=1) for table in files
    ]
    return all(keep_their_distance(first - second) for first, second in combinations(seen, 2))


def _side_by_side(files: Sequence[RawTable], points: Keys[str, Sequence[str]]) -> RawTable:
    """One table of the points of all files, whose columns have the name of the file in front."""
    columns, units = {}, {}
    for table in files:
        names = {name: f"{table.stem}: {name}" for name in points[table.stem]}
        columns |= {new: table.columns[name] for name, new in names.items()}
        units |= {names[name]: unit for name, unit in table.units.items() if name in names}
    file = " + ".join(table.file for table in files)
    note = (
        f"{file}: points that keep their distances from one another are read as {len(files)} reflectors on one tool, "
        "in the same rows as the joint readings."
    )
    warnings = (*(warning for table in files for warning in table.warnings), note)
    return replace(files[0], file=file, columns=columns, units=units, warnings=warnings)


def _point_of(table: RawTable) -> tuple[str, ...]:
    """The columns of the only point of a table that holds nothing else but a number of the row; () of other tables."""
    point_sets = find_sets(table)
    numbers = [
        name
        for name, cells in table.columns.items()
        if cells.dtype.kind == "f" and np.isfinite(cells).all() and not counts_rows(cells)
    ]
    if len(numbers) != 3 or len(point_sets) > 1:
        return ()
    if point_sets and (point_sets[0].kind != "point" or set(point_sets[0].names) != set(numbers)):
        return ()
    if point_sets:
        return tuple(point_sets[0].names)
    return tuple(numbers)


def keep_their_distance(vectors: np.ndarray) -> bool:
    """Whether vectors (n, 3) between two points keep their length and change their direction."""
    lengths = np.linalg.norm(vectors, axis=1)
    length = float(np.median(lengths))
    change = float(np.median(np.abs(lengths - length)))
    rotated = float(np.linalg.norm(np.std(vectors, axis=0)))
    return change < _RIGID * length and rotated > _ROTATED * length
