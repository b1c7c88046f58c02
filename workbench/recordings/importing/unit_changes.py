"""Search for a unit that changes at some row of a table, as where a second session was exported in metres."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from datasets.columns import joint_columns
from datasets.importers.mapping.candidates import ANGLE_WORDS, LENGTH_WORDS
from datasets.importers.mapping.column_units import each_unit
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from datasets.importers.units import ANGLES, LENGTHS
from datasets.recording import Recording
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.check import good_scale
from workbench.fitting.plausibility.fitting import fit_recording, row_mismatch
from workbench.fitting.plausibility.sampling import even_rows

_LEAST_RATIO = 8.0  # of the sizes before and after; smaller ones occur in measurements in one unit
_NEAR = 3.0
_FEWEST_ROWS = 4
_ROWS = 100
_FITTING = 0.95
_POINT = ("x_mm", "y_mm", "z_mm")
_ANGLE_UNITS = ("deg", "rad", "gon")
_LENGTH_UNITS = ("mm", "m", "in", "cm")


@dataclass(frozen=True)
class UnitChange:
    """`columns` of a recording that hold another unit from row `first` on, which times `factor` is the one before."""

    columns: tuple[str, ...]
    first: int
    factor: float

    def corrected(self, recording: Recording) -> Recording:
        """The recording with one unit in all rows."""
        columns = dict(recording.columns)
        for name in self.columns:
            cells = columns[name].copy()
            cells[self.first :] *= self.factor
            columns[name] = cells
        return replace(recording, columns=columns)


def check_unit_changes(robot: Robot, table: RawTable, mapping: Mapping, readings, build) -> None:
    """Raise InputError where the data fit the robot only with a unit that changes at a row.

    readings: (title, mapping) of every combination of units; build: makes the recording of such a mapping.
    """
    try:
        first = build(readings[0][1])
    except InputError:
        return
    if not any(_change_of_size(first, names) for names in _quantities(first)):
        return
    for _, made in readings:
        try:
            recording = build(made)
        except InputError:
            continue
        for change, units in _changes(recording, made):
            if _fits(robot, change.corrected(recording)):
                raise InputError(_sentence(table, made, change, units))


def _quantities(recording: Recording) -> list[tuple[str, ...]]:
    """Columns of angles, and of the point."""
    names = joint_columns(recording.columns)
    angles = tuple(name for name in names if name.endswith("_deg"))
    point = _POINT if set(_POINT) <= set(recording.columns) else ()
    return [names for names in (angles, point) if names]


def _change_of_size(recording: Recording, names: tuple[str, ...]) -> tuple[int, float] | None:
    """Row at which the size of a quantity changes most, and the ratio after / before; None for a small one.

    The logarithm of the length of each row is split into two parts with the least sum of squares.
    """
    count = recording.n
    size = np.sqrt(sum(recording.columns[name] ** 2 for name in names))
    if count < 2 * _FEWEST_ROWS or not (size > 0).all():
        return None
    logs = np.log(size)
    sums = np.cumsum(logs)[:-1]
    before = np.arange(1, count)
    gain = sums**2 / before + (logs.sum() - sums) ** 2 / (count - before)
    first = int(gain[_FEWEST_ROWS - 1 : count - _FEWEST_ROWS].argmax()) + _FEWEST_ROWS
    ratio = float(np.exp(np.median(logs[first:]) - np.median(logs[:first])))
    return (first, ratio) if max(ratio, 1 / ratio) > _LEAST_RATIO else None


def _changes(
    recording: Recording, mapping: Mapping
) -> Iterator[tuple[UnitChange, tuple[str, str]]]:
    """Changes of unit that agree with a change of size, with the units before and after."""
    for names in _quantities(recording):
        found = _change_of_size(recording, names)
        if found is None:
            continue
        first, ratio = found
        is_point = names == _POINT
        known, sizes = (_LENGTH_UNITS, LENGTHS) if is_point else (_ANGLE_UNITS, ANGLES)
        before = each_unit(_group(mapping, is_point).unit, len(names))[0]
        for after in known:
            if before not in known or after == before:
                continue
            factor = sizes[after] / sizes[before]
            if 1 / _NEAR < factor * ratio < _NEAR:
                yield UnitChange(names, first, factor), (before, after)


def _group(mapping: Mapping, is_point: bool) -> Group:
    return mapping.point if is_point else mapping.joints


def _fits(robot: Robot, recording: Recording) -> bool:
    """Whether nearly all rows fit the robot."""
    try:
        fit = fit_recording(robot, recording.select(even_rows(recording, _ROWS)))
        good = good_scale(robot, recording)
        own = row_mismatch(robot, recording, fit)
    except (np.linalg.LinAlgError, InputError, ValueError):
        return False
    return bool(fit.core <= good and (own < 3 * good).mean() >= _FITTING)


def _sentence(table: RawTable, mapping: Mapping, change: UnitChange, units) -> str:
    group = _group(mapping, change.columns == _POINT)
    rows = table.lines
    last = change.first - 1
    before, after = ({**ANGLE_WORDS, **LENGTH_WORDS}[unit] for unit in units)
    return (
        f"{table.file}, columns {', '.join(group.columns)}: expected one unit in all rows, found {before} in rows "
        f"{rows[0]} to {rows[last]} and {after} in rows {rows[change.first]} to {rows[-1]}, with which the robot fits; "
        f"convert one of the two parts, or import them as two tables."
    )
