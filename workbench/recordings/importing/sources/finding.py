"""Contents of the sources of an import: tables that belong together, as one, and the mapping from their headers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.errors import InputError
from datasets.importers.mapping.columns.reflectors import stacked, with_reflectors
from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.mapping.counts import refuse_counts
from datasets.importers.mapping.joined_tables.joining import join_tables, zone_sentence
from datasets.importers.mapping.joined_tables.sessions import APPEND, appended, session_groups
from datasets.importers.mapping.joined_tables.time_units import with_time_units
from datasets.importers.mapping.left_out import left_out_sentences
from datasets.importers.mapping.model import OF_PROGRAMS, QUANTITIES, Join, Mapping
from datasets.importers.mapping.proposal import measures_of, propose
from datasets.importers.source import RawTable, Source, with_distinct_stems
from datasets.importers.sources import read_sources
from workbench.recordings.importing.board_images.image_sessions import joined_image_sessions
from workbench.recordings.importing.sources.header_problems import header_error
from workbench.recordings.importing.sources.named_joints import with_named_joints
from workbench.recordings.importing.sources.no_joints import refuse_point_lists
from workbench.recordings.importing.sources.point_files import with_point_files
from workbench.recordings.importing.sources.timed_join import TimedJoin
from workbench.recordings.importing.sources.touches import with_touches
from workbench.recordings.importing.target_poses.centre_layouts import pose_and_centre
from workbench.recordings.importing.target_poses.common_rows import with_common_rows
from workbench.recordings.importing.target_poses.layouts import two_pose_sets

_OF_POSITIONS = ("external-point", "ball-centre")
"""Kinds of flange poses with the positions of a target alone, in the columns of two sets of poses."""


@dataclass(frozen=True)
class Found:
    """Everything that was read: the source, one joined table (None without tables), the mapping so far.

    `timed`: the two tables where they are joined by time; sentences on their rows are not in `warnings`. `sessions`:
    what was found for each of several tables with the same columns, whose rows stand below each other in `table`.
    """

    source: Source
    table: RawTable | None
    mapping: Mapping
    unused: tuple[str, ...]
    warnings: tuple[str, ...]
    timed: TimedJoin | None = None
    sessions: "tuple[Found, ...]" = ()

    @property
    def called(self) -> str:
        """The table for messages."""
        return "the images" if self.table is None else self.table.file

    def left_out(self) -> tuple[str, ...]:
        """Sentences on what the mapping leaves out although it looks like a quantity."""
        if self.table is None:
            return ()
        return left_out_sentences(self.table, self.mapping, bool(self.source.images))


def find_mapping(
    paths: Sequence[Path],
    options,
    scratch: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> Found:
    """Read the sources, join their tables and propose what the user's mapping leaves open. Raises InputError.

    options: `ImportOptions`.
    """
    stated = [f"[{name}]" for name in OF_PROGRAMS if getattr(options.mapping, name) is not None]
    if stated:
        raise InputError(
            f"--map: expected no {' and '.join(stated)}, which belong to targets (compensate, stiffness, export), "
            "found them; remove them. Poses of one tool are imported as they are."
        )
    progress("reading the files")
    options = replace(options, mapping=with_reflectors(options.mapping))
    source = read_sources(paths, scratch)
    mapping = options.mapping
    warnings = tuple(source.warnings)
    if not source.tables:
        return Found(source, None, mapping, (), warnings)
    tables = with_time_units([_with_time(table, mapping) for table in source.tables])
    source = replace(source, tables=tuple(tables))
    mapping = with_named_joints(source.tables, mapping, options.robot or mapping.robot)
    is_plain = not source.images and not source.clouds
    point_files = with_point_files(source.tables, mapping) if is_plain else None
    if point_files is not None:
        tables, mapping = point_files
        source = replace(source, tables=tuple(tables))
    options = replace(options, mapping=mapping)
    if is_plain and _may_be_target_poses(options):
        tables, notes = with_common_rows(with_distinct_stems(source.tables))
        pair = two_pose_sets(tables, mapping) or pose_and_centre(tables, mapping)
        if pair is not None:
            return Found(source, *pair, (), (*warnings, *pair[0].warnings, *notes))
    if is_plain:
        touches = with_touches(source.tables, mapping, options.robot or mapping.robot)
    else:
        touches = None
    if touches is not None:
        return Found(source, *touches, (), (*warnings, *touches[0].warnings))
    if is_plain and (options.robot or mapping.robot) is None and mapping == Mapping():
        refuse_point_lists(source.tables)
    if source.images:
        source, notes = joined_image_sessions(source)
        warnings = (*warnings, *notes)
    if is_plain and mapping.join.by in (None, APPEND):
        useful, ignored = _useful(source, options)
        groups = session_groups(useful, mapping)
        if groups:
            return _found_sessions(source, groups, options, (*warnings, *_not_read(ignored)))
    if mapping.join.by == APPEND and len(source.tables) > 1:
        raise _not_alike(source)
    found = _found_in(source, source.tables, options)
    refuse_counts(found.table, found.mapping)
    return replace(found, warnings=(*warnings, *found.warnings))


def _may_be_target_poses(options) -> bool:
    """Whether the user says nothing that speaks against flange poses and target poses."""
    named = options.robot or options.mapping.robot or options.ball_radius_mm or options.board
    mapping = options.mapping
    is_of_positions = mapping.flange_point is not None and mapping.measures in _OF_POSITIONS
    return not named and (is_of_positions or mapping.measures in (None, "target-pose"))


def _found_in(source: Source, tables: Sequence[RawTable], options) -> Found:
    """One joined table, and its mapping.

    Tables without a known header are read where the others do not hold all that a recording needs.
    """
    useful, ignored = _useful(replace(source, tables=tuple(tables)), options)
    found = _joined(source, useful, options)
    is_table = not (source.images or source.clouds or options.ball_radius_mm)
    if ignored and is_table and not _is_complete(found.mapping):
        try:
            return _joined(source, tables, options)
        except InputError as problem:
            sentence = (
                f"{problem} Without a known header, and therefore not read: {_names(ignored)}."
            )
            raise InputError(sentence, problem.example) from None
    warnings = (*found.warnings, *_not_read(ignored))
    return replace(found, warnings=warnings)


def _is_complete(mapping: Mapping) -> bool:
    return mapping.joints is not None and mapping.measures is not None


def _not_read(ignored: Sequence[RawTable]) -> tuple[str, ...]:
    if not ignored:
        return ()
    return (f"Tables without a known quantity are not read: {_names(ignored)}.",)


def _names(tables: Sequence[RawTable]) -> str:
    return ", ".join(table.file for table in tables)


def _with_time(table: RawTable, mapping: Mapping) -> RawTable:
    """The table with the column that the mapping names as the time."""
    named = [name for name, target in mapping.columns.items() if target == "time_s"]
    columns = [name for name in named if name in table.columns]
    return replace(table, time_name=columns[0]) if columns else table


def _joined(source: Source, tables: Sequence[RawTable], options) -> Found:
    """Tables joined to one, and its mapping. Raises InputError where nothing says which rows belong together."""
    tables, wanted = with_distinct_stems(tables), options.mapping.join
    if wanted.by == APPEND:
        wanted = replace(wanted, by=None)
    if options.time_offset is not None:
        seconds = options.time_offset if isinstance(options.time_offset, float) else None
        wanted = replace(wanted, time_offset_s=seconds)
    table, join, notes = join_tables(tables, wanted)
    if join.by == "time":  # joined again at other offsets: each table gets its rows first
        tables = [stacked(table, options.mapping) for table in tables]
        table, join, notes = join_tables(tables, wanted)
    else:
        table = stacked(table, options.mapping)
    warnings = list(table.warnings)
    mapping, unused = _proposed(table, source, options)
    if len(tables) > 1:
        # an offset is part of the mapping only where it was stated or estimated
        stated = replace(join, time_offset_s=options.mapping.join.time_offset_s)
        mapping = replace(mapping, join=stated)
    if len(tables) == 2 and join.by == "time" and not source.images and not source.clouds:
        timed = TimedJoin((tables[0], tables[1]), join)
        zone = timed.join.time_offset_s - (wanted.time_offset_s or 0.0)
        warnings += [zone_sentence(timed.short, timed.log, zone)] if zone else []
        mapping = replace(mapping, columns=_without_time_of(timed.log, mapping))
        return Found(source, table, mapping, unused, tuple(warnings), timed)
    return Found(source, table, mapping, unused, (*warnings, *notes))


def _without_time_of(log: RawTable, mapping: Mapping) -> dict[str, str]:
    """Columns that are copied, without the time of the log: its rows are those of the other table."""
    names = {log.time_name, f"{log.stem}: {log.time_name}"}
    return {
        name: target
        for name, target in mapping.columns.items()
        if target != "time_s" or name not in names
    }


def _found_sessions(source: Source, groups, options, warnings: Sequence[str]) -> Found:
    """Tables with the same columns: what is found in each, and all rows below each other.

    groups: the tables of each session, which are joined first where they are several.
    """
    sessions = tuple(_joined(source, group, options) for group in groups)
    table = appended([part.table for part in sessions])
    mapping, unused = _proposed(table, source, options)
    refuse_counts(table, mapping)
    mapping = replace(mapping, join=Join(APPEND))
    notes = (*warnings, *table.warnings)
    return Found(source, table, mapping, unused, notes, sessions=sessions)


def _proposed(table: RawTable, source: Source, options):
    """The user's mapping, completed by what the headers of a table suggest, and the columns that it leaves out."""
    proposal = propose(table, bool(source.images), bool(source.clouds), options.mapping)
    mapping = options.mapping.merged(proposal.mapping)
    if mapping.point is not None and mapping.measures in (None, "external-point"):
        # the mapping file may name a point or a rotation that no header shows
        stated = options.mapping.measures
        mapping = replace(mapping, measures=stated or measures_of(mapping))
    unused = tuple(name for name in proposal.unused if not is_mapped(mapping, name))
    return mapping, unused


def _not_alike(source: Source) -> InputError:
    names = ", ".join(table.file for table in source.tables)
    return InputError(
        f'{names}: expected several tables with the same columns for [join] by = "{APPEND}", each with joint readings '
        "and a measurement, found others; correct the headers, or remove the key from the mapping file."
    )


def _useful(source: Source, options) -> tuple[list[RawTable], list[RawTable]]:
    """Tables with at least one known set of columns, and the others.

    Where no header is known, all are read for the test of unknown columns on the robot. Raises InputError without one.
    """
    mapping = options.mapping
    robot = options.robot or options.mapping.robot
    named = set(mapping.columns)
    for quantity in QUANTITIES:
        group = getattr(mapping, quantity)
        named |= set(group.columns) if group is not None else set()
    useful = [t for t in source.tables if find_sets(t) or named & _names_of_columns(t)]
    if not useful:
        if len(source.tables) == 1 or source.images:
            return list(source.tables[:1]), []
        if robot is not None or session_groups(source.tables, mapping):
            return list(source.tables), []
        raise _nothing_known(source.tables[0], mapping)
    return useful, [
        t for t in source.tables if not any(t is table_of_source for table_of_source in useful)
    ]


def _names_of_columns(table: RawTable) -> set[str]:
    """Names of the columns, also with the name of the file in front, as the joined table has them."""
    return {*table.columns, *(f"{table.stem}: {name}" for name in table.columns)}


def _nothing_known(table: RawTable, mapping: Mapping) -> InputError:
    shown = ", ".join(list(table.columns)[:12])
    sentence = (
        f"{table.file}: expected headers that name joint readings and points, found {shown}; write a mapping file "
        'with [joints] columns = ["...", ...] and [point] columns = ["...", "...", "..."] and name it with --map.'
    )
    return header_error(table, mapping, mapping.robot, [sentence])


def is_mapped(mapping: Mapping, name: str) -> bool:
    """Whether a quantity or a covariate is read from a column."""
    groups = [getattr(mapping, quantity) for quantity in QUANTITIES]
    of_reflectors = any(name in names for names in mapping.reflectors.values())
    return (
        of_reflectors
        or name in mapping.columns
        or any(name in group.columns for group in groups if group is not None)
    )
