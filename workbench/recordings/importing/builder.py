"""Recordings of one joined table under different mappings."""

from collections.abc import Mapping as Keys
from dataclasses import dataclass, field, replace

import numpy as np

from datasets.formats.table import is_number
from datasets.importers.mapping.columns.column_units import each_unit, joined_units
from datasets.importers.mapping.conversion import (
    axis_columns,
    joint_columns,
    other_columns,
    point_columns,
    rotation_columns,
    time_origin,
)
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.importers.units import LENGTHS
from datasets.recording import Recording
from datasets.samples.columns import GROUPS
from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.recordings.importing.robots import read_artefact

_EXTERNAL = ("external-point", "external-pose", "partial-pose")


@dataclass(frozen=True)
class Builder:
    """Makes recordings of one table under different mappings.

    keys, robot: what the recording says of the robot, and the robot. options: `ImportOptions`.
    """

    table: RawTable
    keys: Keys
    robot: Robot
    options: object
    _others: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    def positions(self, mapping: Mapping) -> Recording:
        """The recording of the positions alone, for the test of the units."""
        measures = "external-point" if mapping.measures in _EXTERNAL else mapping.measures
        return self._recording(replace(mapping, measures=measures, rotation=None, axis=None))

    def complete(self, mapping: Mapping) -> Recording:
        """The whole recording. Raises InputError where numbers cannot be what the mapping says."""
        return self._recording(mapping)

    def readings(self, mapping: Mapping) -> dict[str, np.ndarray]:
        """q1_deg ... (qK_mm of a prismatic joint)."""
        length = _length_of_slides(mapping)
        return joint_columns(self.table, mapping.joints, sliding(self.robot), length)

    def with_lengths_of_slides(self, mapping: Mapping) -> Mapping:
        """The mapping with the unit of the readings of prismatic joints, which one unit for all does not state."""
        slides = sliding(self.robot)
        group = mapping.joints
        if not slides.any() or group.counts_per_deg is not None:
            return mapping
        length = _length_of_slides(mapping)
        units = [
            length if slide and unit not in LENGTHS else unit
            for slide, unit in zip(slides, each_unit(group.unit, len(slides)))
        ]
        return mapping.updated("joints", unit=joined_units(units))

    def _other_columns(self, mapping: Mapping) -> dict[str, np.ndarray]:
        """Columns that depend neither on units nor on conventions; times take long to read, and are read once."""
        named = tuple(mapping.columns.items())
        if named not in self._others:
            self._others[named] = other_columns(self.table, mapping)
        return dict(self._others[named])

    def _time_origin(self, mapping: Mapping) -> float | str | None:
        """As of `time_origin`; None where the recording has no times."""
        key = ("origin", *mapping.columns.items())
        if key not in self._others:
            has_times = "time_s" in self._other_columns(mapping)
            self._others[key] = time_origin(self.table, mapping) if has_times else None
        return self._others[key]

    def _recording(self, mapping: Mapping) -> Recording:
        table = self.table
        columns: dict[str, np.ndarray] = {"sample": np.arange(1, table.n + 1, dtype=float)}
        columns |= self.readings(mapping)
        if mapping.point is not None:
            columns |= point_columns(table, mapping.point)
        if mapping.rotation is not None and mapping.rotation.convention:
            columns |= rotation_columns(table, mapping.rotation)
        elif mapping.axis is not None:
            columns |= axis_columns(table, mapping.axis)
        others, group_names = _numbered_groups(self._other_columns(mapping))
        columns |= others
        balls = read_artefact(self.options.artefact) if self.options.artefact else {}
        if mapping.measures == "ball-centre":
            columns.setdefault("ball", np.ones(table.n))
            balls = balls or {int(columns["ball"][0]): (0.0, 0.0, 0.0, 10.0)}
        if mapping.measures == "ball-surface" and self.options.ball_radius_mm is not None:
            columns.setdefault("ball", np.ones(table.n))
            balls = balls or {int(columns["ball"][0]): (0.0, 0.0, 0.0, self.options.ball_radius_mm)}
        return Recording(
            measures=mapping.measures,
            columns=columns,
            robot=self.keys,
            sigma_mm=self.options.sigma_mm,
            balls=balls,
            name=self.options.name,
            time_origin=self._time_origin(mapping),
            group_names=group_names,
        )


def _length_of_slides(mapping: Mapping) -> str:
    """The unit of prismatic joints whose column states none: that of the measured point."""
    stated = None if mapping.point is None else mapping.point.unit
    return (stated[0] if isinstance(stated, tuple) else stated) or "mm"


def _numbered_groups(
    columns: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], dict[str, tuple[str, ...]]]:
    """Names of groups as numbers by their first occurrence, as the reader of recordings has them; and the names."""
    groups, names = {}, {}
    for name, cells in columns.items():
        if cells.dtype.kind == "f" or name == "note":
            groups[name] = cells
            continue
        order = list(dict.fromkeys(cells.tolist()))
        groups[name] = np.array([order.index(cell) + 1 for cell in cells.tolist()], float)
        if name in GROUPS and not any(is_number(text) for text in order):
            names[name] = tuple(order)
    return groups, names
