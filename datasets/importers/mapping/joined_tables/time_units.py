"""The unit of times that no header states: joints of a log that move smoothly move on within a second."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.joined_tables.time_stamps import times_of
from datasets.importers.source import RawTable

_UNITS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_SLOWEST_S = 1.0
"""Interval from which on a log of an arm in motion would show jumps."""
_SMOOTH = 0.1
"""Ratio of the second to the first differences of a smooth motion; independent poses have 1.7."""
_REGULAR = 0.2
"""Spread of the intervals of a log, as a share of their median."""
_FEWEST = 20
_FASTEST = 7.0
"""Speed of a joint, rad/s; more than 400 deg/s."""
_SIMILAR = 5.0
"""Ratio of the time spans of two tables of one recording."""


def with_time_units(tables: Sequence[RawTable]) -> list[RawTable]:
    """Tables that may be joined by time, with ms, us or ns as the unit where none is stated and a log is read so only.

    The other tables without a unit get the one under which their time span is similar to that of the log. A warning
    of the table states the unit. A single table is not changed.
    """
    if len(tables) < 2:
        return list(tables)
    found = [_unit_of_log(table) for table in tables]
    logs = [k for k, unit in enumerate(found) if unit]
    if not logs:
        return list(tables)
    span = _span(tables[logs[0]]) * dict(_UNITS)[found[logs[0]]]
    made = []
    for table, unit in zip(tables, found):
        unit = unit or _unit_by_span(table, span)
        made.append(_with_unit(table, unit) if unit else table)
    return made


def _open_times(table: RawTable) -> np.ndarray | None:
    """(n,) times as in the file where they are numbers, count from any moment, and state no unit; else None."""
    seconds, names = times_of(table)
    if seconds is None or len(names) != 1:
        return None
    cells = table.columns[names[0]]
    is_open = cells.dtype.kind == "f" and headers_of(table)[names[0]].unit is None
    return seconds if is_open and np.array_equal(seconds, cells) else None


def _span(table: RawTable) -> float:
    seconds = _open_times(table)
    return 0.0 if seconds is None else float(np.ptp(seconds))


def _unit_of_log(table: RawTable) -> str:
    """ms, us or ns where the joints move smoothly over intervals that are longer than a second in s; else ""."""
    seconds = _open_times(table)
    if seconds is None or len(seconds) < _FEWEST or not np.isfinite(seconds).all():
        return ""
    steps = np.diff(seconds)
    interval = float(np.median(steps))
    is_log = interval >= _SLOWEST_S and np.abs(steps - interval).max() <= _REGULAR * interval
    step = _step_of_smooth_motion(table) if is_log else None
    for unit, size in _UNITS:
        if step is not None and interval * size <= _SLOWEST_S:
            return unit if step <= _FASTEST * interval * size else ""
    return ""


def _step_of_smooth_motion(table: RawTable) -> float | None:
    """The largest step (rad) of a joint from row to row; None where the joints do not move as in one motion."""
    joints = [
        table.columns[name]
        for name, header in headers_of(table).items()
        if header.kind in ("joint", "qindex") and table.columns[name].dtype.kind == "f"
    ]
    if not joints:
        return None
    readings = np.stack(joints, axis=1)
    first, second = np.diff(readings, axis=0), np.diff(readings, n=2, axis=0)
    moved = np.linalg.norm(first)
    if not (np.isfinite(moved) and moved > 0 and np.linalg.norm(second) <= _SMOOTH * moved):
        return None
    is_radian = np.ptp(readings, axis=0).max() <= 2 * np.pi
    return float(np.abs(first).max()) * (1.0 if is_radian else np.pi / 180)


def _unit_by_span(table: RawTable, span: float) -> str:
    """The unit under which the times of a table last about as long as a log of `span` s; "" for s and for none."""
    own_span = _span(table)
    for unit, size in (("", 1.0), *_UNITS):
        if span / _SIMILAR <= own_span * size <= span * _SIMILAR:
            return unit
    return ""


def _with_unit(table: RawTable, unit: str) -> RawTable:
    (name,) = times_of(table)[1]
    sentence = (
        f"{table.file}: the times in '{name}' state no unit and are read in {unit}, in which the joints of the log "
        f"move smoothly from row to row. Write the unit into the header, as in '{name} [{unit}]'."
    )
    return replace(table, units={**table.units, name: unit}, warnings=(*table.warnings, sentence))
