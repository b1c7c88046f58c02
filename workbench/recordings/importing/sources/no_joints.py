"""Refusals of points and poses without joint readings: what the data lack, and which command needs none."""

import re
import shlex
from collections.abc import Sequence

import numpy as np

from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from workbench.core.errors import InputError
from workbench.recordings.importing.target_poses.layouts import counts_rows

_FEWEST_JOINTS = 4
_FEWEST_POINTS = 8
_POINT_WIDTH = 3
_WITHOUT_HEADER = re.compile(r"column \d+")
_RIGID = 0.1
"""Share of their scatter by which positions may differ after one rigid motion: what a depth camera leaves of the motion
of an arm. Positions that have nothing in common differ by about their scatter."""
_NEEDED = "export the joint angles of the same rows for a calibration of the robot"


def refuse_without_joints(
    table: RawTable, mapping: Mapping, named: str | None, files: Sequence[str]
) -> None:
    """Raise InputError for known points or poses next to which no column can be a joint reading.

    named: the user's robot. files: those of the tables that were joined. Other tables are left to the proposal of a
    mapping.
    """
    group = mapping.point or mapping.flange_point
    if named is not None or mapping.joints is not None or group is None:
        return
    if _free_columns(table, mapping) >= _FEWEST_JOINTS:
        return
    start, names = f"{table.file}: expected joint readings", ", ".join(group.columns)
    if mapping.flange_rotation is not None and mapping.point is not None:
        flange = (*mapping.flange_point.columns, *mapping.flange_rotation.columns)
        remedy = _registration(table, mapping, files)
        raise InputError(
            f"{start}, or flange poses that one transform connects with the measurements (points of a tracker, centres "
            "of a fixed ball, or poses of a marker), found that none does under any reading of the flange poses "
            f"({', '.join(flange)}) and of {names}; {remedy}, or {_NEEDED}."
        )
    if mapping.rotation is not None or mapping.flange_rotation is not None:
        raise InputError(
            f"{start}, found poses ({names}, ...); {_NEEDED}. Without joint readings, `workbench handeye` needs flange "
            "poses together with images, scans of a ball, poses of a marker or points of a tracker."
        )
    lists = files if len(files) == 2 else [files[0], "OTHER"]
    raise InputError(
        f"{start}, found points only ({names}); {_NEEDED}. Two lists of points are compared by "
        f"`{shlex.join(['workbench', 'register', *lists])}`."
    )


def refuse_point_lists(tables: Sequence[RawTable]) -> None:
    """Raise InputError for two tables that are lists of points and nothing else."""
    if len(tables) != 2 or not all(map(_is_point_list, tables)):
        return
    files = [table.file for table in tables]
    raise InputError(
        f"{' and '.join(files)}: expected joint readings or flange poses, found points only; {_NEEDED}. Two lists of "
        f"points are compared by `{shlex.join(['workbench', 'register', *files])}`."
    )


def _is_point_list(table: RawTable) -> bool:
    """Whether three columns without headers, or with those of a point, are all numbers of a table."""
    names = [name for name, cells in table.columns.items() if cells.dtype.kind == "f"]
    if len(names) > _POINT_WIDTH and counts_rows(table.columns[names[0]]):
        names = names[1:]
    is_plain = all(_WITHOUT_HEADER.fullmatch(name) for name in names)
    is_named = any(
        column_set.kind == "point" and set(column_set.names) == set(names)
        for column_set in find_sets(table)
    )
    return len(names) == _POINT_WIDTH and (is_plain or is_named)


def _registration(table: RawTable, mapping: Mapping, files: Sequence[str]) -> str:
    """What to do about flange poses and points: `register`, where one rigid motion connects the positions alone."""
    share = _rigid_share(table, mapping)
    if len(files) != 2 or share > _RIGID:
        return "check that the rows belong together"
    command = shlex.join(["workbench", "register", *files])
    return (
        f"the positions alone agree after one rigid motion (they differ by {100 * share:.2g} % of their scatter), "
        f"which `{command}` gives: correct the rotations"
    )


def _rigid_share(table: RawTable, mapping: Mapping) -> float:
    """RMS distance of flange positions and points after rotation, translation and scale, as a share of the scatter."""
    flange, seen = (
        np.stack([table.columns[name] for name in group.columns], axis=1)
        for group in (mapping.flange_point, mapping.point)
    )
    is_measured = np.isfinite(flange).all(axis=1) & np.isfinite(seen).all(axis=1)
    flange, seen = flange[is_measured], seen[is_measured]
    if len(flange) < _FEWEST_POINTS:
        return np.inf
    flange, seen = flange - flange.mean(axis=0), seen - seen.mean(axis=0)
    left, sizes, right = np.linalg.svd(flange.T @ seen)
    sizes[2] *= np.sign(np.linalg.det(left @ right))
    scatter = np.linalg.norm(flange) * np.linalg.norm(seen)
    correlation = sizes.sum() / scatter if scatter > 0 else 0.0
    return float(np.sqrt(max(1 - correlation**2, 0.0)))


def _free_columns(table: RawTable, mapping: Mapping) -> int:
    """Number of columns of numbers that no quantity is read from and that do not number the rows."""
    free = [
        name for name in unused_columns(table, mapping) if table.columns[name].dtype.kind == "f"
    ]
    return sum(
        np.isfinite(table.columns[name]).any() and not counts_rows(table.columns[name])
        for name in free
    )
