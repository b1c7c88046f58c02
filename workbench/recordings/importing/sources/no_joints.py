"""Refusals of points and poses without joint readings: what the data lack, and which command needs none."""

import shlex
from collections.abc import Sequence

import numpy as np

from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from workbench.core.errors import InputError
from workbench.recordings.importing.target_poses.layouts import counts_rows

_FEWEST_JOINTS = 4
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
        raise InputError(
            f"{start}, or flange poses that one transform connects with the measurements (points of a tracker, centres "
            "of a fixed ball, or poses of a marker), found that none does under any reading of the flange poses "
            f"({', '.join(flange)}) and of {names}; check that the rows belong together, or {_NEEDED}."
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


def _free_columns(table: RawTable, mapping: Mapping) -> int:
    """Number of columns of numbers that no quantity is read from and that do not number the rows."""
    free = [
        name for name in unused_columns(table, mapping) if table.columns[name].dtype.kind == "f"
    ]
    return sum(
        np.isfinite(table.columns[name]).any() and not counts_rows(table.columns[name])
        for name in free
    )
