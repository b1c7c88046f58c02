"""Tables of joint readings and nothing else: readings at which the tip of the tool touches one fixed point.

With the pose R_k, t_k of the flange at the nominal geometry, the tip s and the point b, R_k s + t_k = b for all rows of
a file. This is linear in s and b; readings that have nothing to do with one another leave most of the scatter of t_k.
Without a column that numbers the points, each file is a point of its own, which assumes nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.candidates import angle_units
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.conversion import joint_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.fitting.plausibility.fitting import EXPLAINED, FAILURES, fit_recording
from workbench.fitting.plausibility.sampling import even_rows
from workbench.recordings.importing.robots import robot_candidates
from workbench.recordings.importing.target_poses.layouts import counts_rows

KIND = "touch-point"
POINT = "point"
_ROWS = 200
_FEWEST = 6
"""Rows of a file: 18 equations for the six unknowns of tip and point."""
_MOST_LEFT = 0.25
"""Share of the scatter of the flange that is left at the nominal geometry, before plausible errors of it are fitted.

An arm whose zeros are off by degrees leaves 10 %, readings of poses that touch nothing 40 % and more.
"""
_COMPUTED_MM = 1e-6
"""Misfit below it holds for any readings, as of a wrist whose axes meet: no tip was measured."""
_OF_NO_MEASUREMENT = ("time", "sample")


@dataclass(frozen=True)
class _Touch:
    """Misfit and scatter of the flange, mm, under one reading of the joints."""

    rms_mm: float
    scatter_mm: float

    @property
    def share(self) -> float:
        return self.rms_mm / max(self.scatter_mm, 1e-9)


def with_touches(
    tables: Sequence[RawTable], mapping: Mapping, named: str | None
) -> tuple[RawTable, Mapping] | None:
    """One table of all touches with a column for the number of the point, and its mapping; None for other tables.

    named: the robot that the user names. The readings are tested unless the mapping says measures = "touch-point".
    """
    groups = (mapping.point, mapping.flange_point, mapping.rotation, mapping.flange_rotation)
    is_open = all(group is None for group in groups) and mapping.measures in (None, KIND)
    has_points = POINT in mapping.columns.values() or any(POINT in t.columns for t in tables)
    if named is None or not is_open or has_points or any(t.n < _FEWEST for t in tables):
        return None
    try:
        robots = [load_robot(keys, named) for keys in robot_candidates(named, "").values()]
    except InputError:
        return None  # refused later
    names = _readings_of(tables, mapping, robots[0].mixing.shape[1])
    if names is None:
        return None
    table = _stacked(tables, names)
    mapping = replace(mapping, joints=mapping.joints or Group(names), measures=KIND)
    mapping = replace(mapping, columns={**mapping.columns, POINT: POINT})
    touch = _best_touch(table, mapping.joints, robots)
    if touch is None:
        return None
    warnings = (*table.warnings, _note(tables, touch))
    return replace(table, warnings=warnings), mapping


def _readings_of(
    tables: Sequence[RawTable], mapping: Mapping, count: int
) -> tuple[str, ...] | None:
    """The columns of the joint readings, which all tables have, where these hold no other numbers."""
    if mapping.joints is None:
        names = _named_readings(tables[0])
    else:
        names = mapping.joints.columns
    if len(names) != count:
        return None
    for table in tables:
        if not set(names) <= set(table.columns):
            return None
        others = [name for name in _numbers(table) if name not in names]
        if mapping.measures is None and any(_may_be_measured(table, name) for name in others):
            return None
        if not np.isfinite(np.stack([table.columns[name] for name in names])).all():
            return None
    return names


def _named_readings(table: RawTable) -> tuple[str, ...]:
    """Columns of joints by their headers; without any such header all columns of numbers."""
    numbers = _numbers(table)
    joints = tuple(name for name in numbers if read_header(name).kind == "joint")
    return joints or tuple(name for name in numbers if _may_be_measured(table, name))


def _numbers(table: RawTable) -> list[str]:
    return [name for name, cells in table.columns.items() if cells.dtype.kind == "f"]


def _may_be_measured(table: RawTable, name: str) -> bool:
    """Whether a column neither numbers the rows nor holds their times."""
    return read_header(name).kind not in _OF_NO_MEASUREMENT and not counts_rows(table.columns[name])


def _stacked(tables: Sequence[RawTable], names: Sequence[str]) -> RawTable:
    """All rows below each other, with the number of the file as the number of the point."""
    columns = {name: np.concatenate([table.columns[name] for table in tables]) for name in names}
    numbers = np.repeat(np.arange(1.0, len(tables) + 1), [table.n for table in tables])
    lines = np.concatenate([table.lines for table in tables])
    file = " + ".join(table.file for table in tables)
    return replace(tables[0], file=file, columns={**columns, POINT: numbers}, lines=lines)


def _best_touch(table: RawTable, joints: Group, robots) -> _Touch | None:
    """The best reading under any unit and any convention of a table of the robot; None where none fits.

    Plausible errors of the geometry have to explain what is left at the nominal one.
    """
    found = []
    for robot in robots:
        for unit in angle_units(joints):
            columns = joint_columns(table, replace(joints, unit=unit), robot.prismatic, "mm")
            columns[POINT] = table.columns[POINT]
            recording = Recording(KIND, columns, {})
            touch = _touch(robot, recording.joints, table.columns[POINT])
            found.append((touch, robot, recording))
    touch, robot, recording = min(found, key=lambda item: item[0].share)
    if touch.share > _MOST_LEFT or touch.rms_mm < _COMPUTED_MM:
        return None
    try:
        fit = fit_recording(robot, recording.select(even_rows(recording, _ROWS)))
    except FAILURES:
        return None
    if fit.core <= EXPLAINED * touch.scatter_mm:
        return touch
    return None


def _touch(robot, readings: np.ndarray, numbers: np.ndarray) -> _Touch:
    """readings: (n, J) as of `Recording.joints`. numbers: (n,) of the touched points from 1."""
    frames = forward(robot, robot.mixing @ readings.T)
    rotations = np.stack(frames.end, -1).transpose(1, 0, 2)
    places = frames.end_origin.T
    count = len(places)
    points = int(numbers.max())
    rows = np.zeros((count, 3, 3 + 3 * points))
    rows[:, :, :3] = rotations
    for axis in range(3):
        rows[np.arange(count), axis, 3 * numbers.astype(int) + axis] = -1
    rows = rows.reshape(3 * count, -1)
    residual = rows @ least_squares(rows, -places.ravel(), 1e-9) + places.ravel()
    rms = np.sqrt(3 * (residual**2).sum() / max(3 * count - rows.shape[1], 1))
    scatter_mm = float(np.linalg.norm(places.std(axis=0)))
    return _Touch(float(rms), scatter_mm)


def _note(tables: Sequence[RawTable], touch: _Touch) -> str:
    files = ", ".join(table.file for table in tables)
    target = "one fixed point for each file" if len(tables) > 1 else "one fixed point"
    return (
        f"{files}: only joint readings, which are read as touches of {target}: one tip on the flange stays within "
        f"{touch.rms_mm:.2g} mm RMS of it at the nominal geometry, while the flange moves by {touch.scatter_mm:.3g} mm "
        f"RMS. Points that several files share need a column {POINT} with their number."
    )
