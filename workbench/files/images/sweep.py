"""Direction of the sweep, of images whose mirror angles and times tell it: nobody need record it as a column."""

from dataclasses import replace

import numpy as np

from datasets.recording_files.rows import Rows

SWEEP = "sweep"


def with_sweep(rows: Rows, group: str) -> Rows:
    """Images with the laser, with the column `sweep` where angles and times tell it and it was not recorded.

    -1 or 1: the sign by which mirror_deg changes from the image before, of the same board pose or scan (`group`) in the
    order of time_s; of the first one that to the next, 0 where it does not change.
    """
    needed = {"mirror_deg", "time_s", group}
    if SWEEP in rows.columns or not needed <= rows.columns.keys() or not len(rows):
        return rows
    angle, time = (rows.columns[name][rows.chosen] for name in ("mirror_deg", "time_s"))
    if not (np.isfinite(angle) & np.isfinite(time)).all():
        return rows
    body = rows.columns[group][rows.chosen]
    order = np.lexsort((time, body))
    change = np.sign(np.diff(angle[order], prepend=0.0))
    first = np.diff(body[order], prepend=-1) != 0
    change[first] = np.where(np.roll(first, -1), 0.0, np.roll(change, -1))[first]
    direction = np.full(len(next(iter(rows.columns.values()))), np.nan)
    direction[rows.chosen[order]] = change
    return replace(rows, columns={**rows.columns, SWEEP: direction})


__all__ = ["with_sweep"]
