"""Flange poses and measured points in tables whose headers do not say so: which columns are which.

A pose is 6, 7 or 12 numbers, a point three, in one table side by side or in two with the same rows. A ball stands
still, R_k (X p_k + s) + t_k = b for all rows k: with any matrix X, which takes up the unit of the points, too, this is
linear in X, the place s of the sensor and the ball's centre b. Other columns leave most of t_k. The same holds with the
inverse poses for a point on the flange, at b, which a stationary instrument measures.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.candidates import rotation_candidates
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.recordings.importing.target_poses.layouts import (
    PoseSet,
    counts_rows,
    has_joints,
    join_sets,
    pose_layouts,
)

FEWEST = 8
"""Rows that the linear test needs."""
_UNKNOWNS = 15
_WIDTHS = (6, 7, 12)
_MOST_LEFT = 0.02
"""Share of the scatter of the flange's positions that the poses of a fixed ball may leave."""


def pose_and_centre(
    tables: Sequence[RawTable], mapping: Mapping
) -> tuple[RawTable, Mapping] | None:
    """One table of flange poses and measured points, and its mapping; None for any other tables."""
    is_open = mapping.joints is None and mapping.flange_point is None and mapping.point is None
    if not is_open or not 0 < len(tables) <= 2 or any(map(has_joints, tables)):
        return None
    if any(table.n != tables[0].n or table.n < FEWEST for table in tables):
        return None
    best, least_share = None, _MOST_LEFT
    for pose, centre in _column_sets(tables):
        joined, (pose, centre) = join_sets([pose, centre])
        for place, rotation in pose_layouts(joined, pose.columns):
            share = share_left(joined, place, rotation, centre.columns)
            if share < least_share:
                best = (joined, place, rotation, centre.columns)
                least_share = share
    if best is None:
        return None
    joined, place, rotation, centre = best
    proposed = Mapping(flange_point=place, flange_rotation=rotation, point=Group(centre))
    note = (
        f"No header names flange poses or measured points; {', '.join(place.columns + rotation.columns)} are read as "
        f"poses of the flange and {', '.join(centre)} as a measured point, since one transform then connects all rows. "
        "If that is wrong, state the columns in a mapping file and name it with --map."
    )
    return replace(joined, warnings=(*joined.warnings, note)), mapping.merged(proposed)


def _column_sets(tables: Sequence[RawTable]) -> Iterator[tuple[PoseSet, PoseSet]]:
    """Columns that may be the poses and the centres, in either order."""
    columns = [_columns(table) for table in tables]
    if len(tables) == 2:
        for pose_index, centre_index in ((0, 1), (1, 0)):
            if len(columns[pose_index]) in _WIDTHS and len(columns[centre_index]) == 3:
                yield (
                    _set(tables[pose_index], columns[pose_index]),
                    _set(tables[centre_index], columns[centre_index]),
                )
    elif len(columns[0]) - 3 in _WIDTHS:
        table, names = tables[0], columns[0]
        yield _set(table, names[:-3]), _set(table, names[-3:])
        yield _set(table, names[3:]), _set(table, names[:3])


def _columns(table: RawTable) -> list[str]:
    """Columns of numbers without one that numbers the rows."""
    names = [name for name, cells in table.columns.items() if cells.dtype.kind == "f"]
    if names and counts_rows(table.columns[names[0]]):
        return names[1:]
    return names


def _set(table: RawTable, names: Sequence[str]) -> PoseSet:
    return PoseSet(table, tuple(names), table.stem)


def share_left(table: RawTable, place: Group, rotation: Group, centre: Sequence[str]) -> float:
    """Share of the scatter of the flange's positions that a fixed ball, or a point on the flange, leaves under the best
    rotation convention."""
    origins, seen = (
        np.stack([table.columns[name] for name in names], axis=1)
        for names in (place.columns, centre)
    )
    scatter = float(np.linalg.norm(origins.std(axis=0)))
    if not (np.isfinite(origins).all() and np.isfinite(seen).all() and scatter > 0):
        return np.inf
    try:
        candidates = rotation_candidates(rotation, table)
    except InputError:
        return np.inf
    found = []
    for candidate in candidates:
        rotations = candidate.matrices(table)
        inverses = rotations.transpose(0, 2, 1)
        found.append(_misfit(rotations, origins, seen))
        found.append(_misfit(inverses, -np.einsum("nij,nj->ni", inverses, origins), seen))
    return min(found, default=np.inf) / scatter


def _misfit(rotations: np.ndarray, origins: np.ndarray, seen: np.ndarray) -> float:
    """RMS distance that the best matrix, place of the sensor and ball leave. rotations: (n, 3, 3)."""
    count = len(origins)
    of_matrix = np.einsum("nij,nk->nijk", rotations, seen).reshape(count, 3, 9)
    fixed = np.broadcast_to(-np.eye(3), (count, 3, 3))
    rows = np.concatenate([of_matrix, rotations, fixed], axis=2).reshape(3 * count, _UNKNOWNS)
    residual = rows @ least_squares(rows, -origins.ravel(), 1e-9) + origins.ravel()
    return float(np.sqrt(3 * (residual**2).sum() / (3 * count - _UNKNOWNS)))
