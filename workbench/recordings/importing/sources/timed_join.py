"""Two tables joined by time: the rows at any offset between their clocks, and the offset that the import uses."""

from collections.abc import Mapping as Keys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from datasets.importers.mapping.conversion import complete_rows
from datasets.importers.mapping.joined_tables.joining import is_dense, join_tables, seconds_of
from datasets.importers.mapping.model import Join, Mapping
from datasets.importers.source import RawTable
from robot_model.robot import Robot
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.interpretation.decisions import unit_readings
from workbench.recordings.importing.sources.clock_offset import (
    MOST_SCANNED_S,
    OffsetEstimate,
    RowsAt,
    TimedRows,
    estimate_offset,
)

OffsetMode = float | Literal["auto", "none"] | None
"""Seconds, "auto", "none", or None: what the mapping states, else "auto"."""
_ROWS = 600
_MOVING = 1e-3
"""Share of a joint's range between two rows of a log from which on it moves; encoders at rest change by far less."""


@dataclass(frozen=True)
class TimedJoin:
    """Two tables that are joined by time, and the join in use, its offset included."""

    tables: tuple[RawTable, RawTable]
    join: Join

    @property
    def short(self) -> RawTable:
        """The table whose rows are kept, and to whose times the offset is added."""
        first, second = self.tables
        return first if first.n <= second.n else second

    @property
    def log(self) -> RawTable:
        """The table that is interpolated."""
        first, second = self.tables
        return second if first.n <= second.n else first

    @cached_property
    def step_s(self) -> float:
        """Median sampling interval of the interpolated table, s."""
        steps = np.diff(np.sort(seconds_of(self.log)))
        if (steps > 0).any():
            return float(np.median(steps[steps > 0]))
        return 1.0

    def table_at(self, seconds: float) -> RawTable:
        """The joined table with another offset. Raises InputError where the clocks do not overlap."""
        return join_tables(self.tables, replace(self.join, time_offset_s=seconds))[0]

    def joined_at(self, seconds: float) -> tuple[RawTable, tuple[str, ...]]:
        """`table_at` with the sentences on rows that were left out or measured in motion."""
        table, _, notes = join_tables(self.tables, replace(self.join, time_offset_s=seconds))
        return table, notes

    def thinned(self) -> "TimedJoin":
        """The join with at most some hundred rows of the shorter table."""
        short = self.short
        if short.n <= _ROWS:
            return self
        rows = np.linspace(0, short.n - 1, _ROWS).astype(int)
        thinned_table = short.take(rows)
        tables = [thinned_table if part is short else part for part in self.tables]
        return replace(self, tables=tuple(tables))

    def rows_at(self, robot: Robot, keys: Keys, mapping: Mapping, options) -> RowsAt:
        """The rows of a mapping with complete units, as a function of the offset."""

        def rows(seconds: float) -> TimedRows:
            table, _ = complete_rows(self.table_at(seconds), mapping)
            recording = Builder(table, keys, robot, options).positions(mapping)
            return TimedRows(recording, table.lines)

        return rows

    def speeds(self, builder: Builder, mapping: Mapping) -> dict[str, np.ndarray]:
        """qK_deg_s columns of the rows of a builder, named qdotK_...; {} where no joint moves or the log holds stops.

        Differences over one sampling interval of the log to either side, as far as the log reaches.
        """
        if not is_dense(seconds_of(self.log)):
            return {}
        now = self.join.time_offset_s or 0.0
        centre = builder.readings(mapping)
        sides = [self._readings_near(builder, mapping, now + s * self.step_s) for s in (-1, 1)]
        columns, is_moving = {}, False
        for name, values in centre.items():
            before, after = (np.where(np.isnan(side[name]), values, side[name]) for side in sides)
            intervals = sum(~np.isnan(side[name]) for side in sides)
            change = after - before
            is_moving |= bool((np.abs(change) > 2 * _MOVING * np.ptp(values)).any())
            number, _, unit = name.removeprefix("q").partition("_")
            columns[f"qdot{number}_{unit}_s"] = change / (np.maximum(intervals, 1) * self.step_s)
        return columns if is_moving else {}

    def _readings_near(self, builder: Builder, mapping: Mapping, seconds: float):
        """Joint readings at another offset for the rows of a builder; nan where the log has none."""
        table = self.table_at(seconds)
        lines = builder.table.lines
        is_in_table = np.isin(table.lines, lines)
        found = replace(builder, table=table.take(np.flatnonzero(is_in_table))).readings(mapping)
        places = np.searchsorted(lines, table.lines[is_in_table])
        columns = {}
        for name, values in found.items():
            columns[name] = np.full(builder.table.n, np.nan)
            columns[name][places] = values
        return columns


@dataclass(frozen=True)
class ClockDecision:
    """The offset in use (s), the estimate (None where it could not be made), and what to say of it.

    `applied`: whether the estimate replaced the offset of the start. `is_warning`: whether it changes the data, or
    should do so.
    """

    seconds: float
    estimate: OffsetEstimate | None
    applied: bool
    is_warning: bool
    sentence: str

    @property
    def is_doubt(self) -> bool:
        """Whether the data should be changed and are not."""
        return self.is_warning and not self.applied

    def as_json(self) -> dict:
        """The entry `time_offset` of the answer."""
        found = self.estimate
        keys = {"seconds": self.seconds, "applied": self.applied, "sentence": self.sentence}
        if found is not None:
            keys |= {"estimate_s": found.seconds, "sigma_s": found.sigma_s}
            keys |= {"effect_mm": found.effect_mm, "significant": found.is_significant}
            keys |= {"rms_before_mm": found.before_mm, "rms_after_mm": found.after_mm}
        return keys


def decide_offset(
    timed: TimedJoin, robots: Sequence[tuple[Keys, Robot]], mapping: Mapping, options, stated: bool
) -> ClockDecision:
    """Estimate the offset under every robot and unit that is open, and decide whether it is applied.

    stated: whether the mapping file states an offset, which then is kept unless "auto" is asked for.
    """
    start = timed.join.time_offset_s or 0.0
    if not is_dense(seconds_of(timed.log)):
        return ClockDecision(start, None, False, False, _of_stops(timed))
    thinned = timed.thinned()
    candidates = []
    for keys, robot in robots:
        for _, reading in unit_readings(mapping, stated_only=True):
            candidates.append((robot, thinned.rows_at(robot, keys, reading, options)))
    found = estimate_offset(candidates, start, timed.step_s)
    mode = options.time_offset
    corrects = mode == "auto" or (mode is None and not stated)
    if found is None or not found.is_visible:
        sentence = _without_effect(timed, found)
        return ClockDecision(start, found, False, False, sentence)
    rounded = round(found.seconds, 7)
    if corrects:
        return ClockDecision(rounded, found, True, True, _applied(timed, found))
    return ClockDecision(start, found, False, True, _not_applied(timed, found))


def _named(timed: TimedJoin) -> str:
    return f"the clocks of {timed.short.file} and {timed.log.file}"


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.4g} ms"


def _sigma_words(found: OffsetEstimate) -> str:
    if np.isfinite(found.sigma_s):
        return f" (sigma {_milliseconds(found.sigma_s)})"
    return ""


def _without_effect(timed: TimedJoin, found: OffsetEstimate | None) -> str:
    """Why nothing is corrected."""
    if found is None:
        return (
            f"The offset between {_named(timed)} is not estimated: too few rows fit the robot. Nothing is corrected. "
            f"If the clocks differ by more than {MOST_SCANNED_S:g} s, state the difference with --time-offset."
        )
    if found.sigma_s > timed.step_s:
        return (
            f"The offset between {_named(timed)} is not determined{_sigma_words(found)}, because "
            "the arm hardly moves at the times of the measurements. It then has no effect either, and nothing is "
            "corrected."
        )
    size = f"{_milliseconds(found.change_s)}, sigma {_milliseconds(found.sigma_s)}"
    if not found.is_significant:
        return f"{_named(timed).capitalize()} agree: estimated offset {size}. Nothing is corrected."
    return (
        f"The offset between {_named(timed)} is significant but small ({size}): it displaces the points by "
        f"{found.effect_mm:.2g} mm RMS, and {found.after_mm:.2g} mm of residual remain. Nothing is corrected."
    )


def _of_stops(timed: TimedJoin) -> str:
    return (
        f"The offset between {_named(timed)} is not estimated: {timed.log.file} has one row for each stop, and only an "
        f"offset of half their interval ({timed.step_s / 2:.3g} s) would exchange stops. State it with --time-offset."
    )


def _applied(timed: TimedJoin, found: OffsetEstimate) -> str:
    return (
        f"{_difference(timed, found)} The import corrects it: the RMS residual of the best 90 % of the rows "
        f"falls from "
        f"{found.before_mm:.3g} to {found.after_mm:.3g} mm. --time-offset none keeps the times as recorded."
    )


def _not_applied(timed: TimedJoin, found: OffsetEstimate) -> str:
    return (
        f"{_difference(timed, found)} It is not corrected, because the mapping or --time-offset states "
        f"{found.start_s:g} s; --time-offset auto would lower the RMS residual of a fit to the robot from "
        f"{found.before_mm:.3g} to {found.after_mm:.3g} mm."
    )


def _difference(timed: TimedJoin, found: OffsetEstimate) -> str:
    """Which clock is ahead by how much, and what this does to the points."""
    where = "behind" if found.change_s > 0 else "ahead of"
    return (
        f"The clock of {timed.short.file} is {_milliseconds(abs(found.change_s))} {where} that of {timed.log.file} "
        f"(sigma {_milliseconds(found.sigma_s)}), which displaces the points by {found.effect_mm:.3g} mm RMS."
    )
