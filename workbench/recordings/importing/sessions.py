"""Import of several tables with the same columns, such as those of two days, as one recording.

Units and conventions of every table are decided by itself. The tables are then joined in the units of a recording and
have to fit the robot together.
"""

from collections.abc import Sequence
from dataclasses import replace

from datasets.importers.mapping.conversion import complete_rows
from datasets.importers.mapping.joined_tables.sessions import (
    APPEND,
    SESSION,
    in_recording_units,
    sessions_origin,
)
from datasets.importers.mapping.model import QUANTITIES, Join, Mapping
from datasets.importers.source import RawTable
from datasets.trust import naming_option
from robot_model.state import sliding
from workbench.core.errors import InputError
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.calculated_points import calculated_points, guessed_robot
from workbench.recordings.importing.final_check import check_fit
from workbench.recordings.importing.interpretation.decisions import Decision
from workbench.recordings.importing.interpretation.fits import compare_readings
from workbench.recordings.importing.measured_robot import DecidedTable, Made, decide_table
from workbench.recordings.importing.segments.reading_changes import (
    reading_words,
    refuse_changed_units,
)

_FEWEST_ROWS = 12
"""Rows from which on the units of a table are tested by themselves; those of a smaller one are of the largest."""


def import_sessions(found, options, progress) -> Made:
    """The recording of all tables in `found.sessions`.

    found, options: `Found` and `ImportOptions` of the import. Raises InputError where one table cannot be imported, or
    where they do not fit the robot together.
    """
    sessions = found.sessions
    tables = [session.table for session in sessions]
    order = sorted(range(len(tables)), key=lambda place: -tables[place].n)
    decided: dict[int, DecidedTable] = {}
    for place in order:
        largest = decided.get(order[0])
        mapping = sessions[place].mapping
        if largest is not None:
            mapping = replace(mapping, robot=largest.decision.mapping.robot)
        if largest is not None and tables[place].n < _FEWEST_ROWS:
            decided[place] = _as_largest(tables[place], largest)
            continue
        session = replace(sessions[place], mapping=mapping)
        decided[place] = decide_table(session, options, progress)
    decided_tables = [decided[place] for place in range(len(tables))]
    is_named = (options.robot or sessions[order[0]].mapping.robot) is not None
    return _one_recording(decided_tables, order[0], options, is_named)


def _as_largest(table: RawTable, largest: DecidedTable) -> DecidedTable:
    """A table of few rows under the mapping of the largest one."""
    mapping = largest.decision.mapping
    names = {name for quantity in QUANTITIES for name in _columns(mapping, quantity)}
    missing = sorted(names - set(table.columns))
    if missing:
        raise InputError(
            f"{table.file}: expected {_FEWEST_ROWS} rows or more to test its units, or the headers of "
            f"{largest.builder.table.file}, found {table.n} rows without the column {missing[0]}; write the headers "
            "of the larger table."
        )
    rows, notes = complete_rows(table, mapping)
    return DecidedTable(replace(largest.builder, table=rows), Decision(mapping, ()), notes)


def _columns(mapping: Mapping, quantity: str) -> tuple[str, ...]:
    group = getattr(mapping, quantity)
    return () if group is None else group.columns


def _one_recording(
    decided_tables: Sequence[DecidedTable], largest: int, options, is_named: bool
) -> Made:
    """One recording of the decided tables, which has to fit the robot; is_named: whether the user named it."""
    builder = decided_tables[largest].builder
    robot = builder.robot
    tables = [part.builder.table for part in decided_tables]
    mappings = [part.decision.mapping for part in decided_tables]
    table, mapping, timed = in_recording_units(tables, mappings, sliding(robot))
    joined = Builder(table, builder.keys, robot, options)
    recording = replace(joined.complete(mapping), time_origin=sessions_origin(tables))
    fits = [fit for _, fit in compare_readings(robot, [("all tables together", recording)])]
    is_good = bool(fits) and fits[0].is_good
    if is_good:
        refuse_changed_units(joined, mapping, Decision(mapping, tuple(fits)))
    elif fits and not options.trust_data:
        refuse_changed_units(joined, mapping, None)
        raise InputError(naming_option(_separate_import(tables, fits[0].words)))
    calculated = calculated_points(joined, mapping, recording, options)
    checked = check_fit(robot, recording, fits, options.trust_data, table.lines)
    guess = () if is_named else guessed_robot(joined, recording, calculated, options)
    recording = replace(recording, remarks=(*guess, *calculated))
    checked = (*guess, *calculated, *checked)
    notes = [sentence for part in decided_tables for sentence in part.notes]
    part = [part.clocks.sentence for part in decided_tables if part.clocks and part.clocks.is_doubt]
    notes += [_counted(tables), *_differences(tables, mappings), *timed, *checked]
    shown = [fit for part in decided_tables for fit in _own_fits(part)]
    warnings = tuple(dict.fromkeys(notes))
    merged = replace(_merged(mappings), join=Join(APPEND))
    return Made(recording, merged, (*shown, *fits), warnings, suspicions=(*part, *checked))


def _own_fits(decided_table: DecidedTable):
    """The fit that decided a table, with its name."""
    best = decided_table.decision.fits[:1]
    return [replace(fit, title=f"{decided_table.builder.table.file}: {fit.title}") for fit in best]


def _separate_import(tables: Sequence[RawTable], words: str) -> str:
    names = " and ".join(table.file for table in tables)
    return (
        f"{names}: expected measurements in one frame, found that each table fits the robot, but not all together "
        f"({words}): the instrument, the base or the target was set up again between them; import each as a recording "
        "of its own, calibrate one, and test it on the other with `workbench evaluate --refit base-and-tool`."
    )


def _counted(tables: Sequence[RawTable]) -> str:
    """Which rows of the recording are of which table."""
    sentences, first = [], 1
    for number, table in enumerate(tables, 1):
        sentences.append(
            f"{SESSION} {number}: samples {first} to {first + table.n - 1} of {table.file}"
        )
        first += table.n
    return f"Tables with the same columns become one recording ({'; '.join(sentences)})."


def _differences(tables: Sequence[RawTable], mappings: Sequence[Mapping]) -> list[str]:
    """A sentence where tables have different units or conventions."""
    words = [reading_words(mapping) for mapping in mappings]
    if len(set(words)) == 1:
        return []
    units_by_table = "; ".join(f"{table.file}: {text}" for table, text in zip(tables, words))
    return [
        f"The tables differ in their units or conventions, which are converted ({units_by_table})."
    ]


def _merged(mappings: Sequence[Mapping]) -> Mapping:
    """Common entries of all mappings; the test of the next import decides a unit or convention that differs."""
    merged = mappings[0]
    for quantity in QUANTITIES:
        groups = [getattr(mapping, quantity) for mapping in mappings]
        if len(set(groups)) == 1:
            continue
        if len({group.columns for group in groups if group is not None}) > 1:
            merged = replace(merged, **{quantity: None})
            continue
        units = {group.unit for group in groups}
        conventions = {group.convention for group in groups}
        merged = merged.updated(
            quantity,
            unit=groups[0].unit if len(units) == 1 else None,
            convention=groups[0].convention if len(conventions) == 1 else None,
        )
    return merged
