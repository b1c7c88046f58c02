"""The whole import: sources, proposal, joined table, decisions, recording, and its check."""

import shutil
from collections.abc import Callable, Sequence
from collections.abc import Mapping as Keys
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from datasets.formats.recording1 import read_recording
from datasets.formats.recording1_writer import write
from datasets.importers.mapping.headers import read_header
from datasets.importers.mapping.joining import join_tables, time_columns, zone_sentence
from datasets.importers.mapping.left_out import (
    left_out_sentences,
    unused_rotation_sentences,
)
from datasets.importers.mapping.model import Join, Mapping, write_mapping
from datasets.importers.mapping.proposal import measures_of, propose
from datasets.importers.mapping.sessions import APPEND, appended, are_sessions
from datasets.importers.mapping.sets import find_sets
from datasets.importers.source import RawTable, Source
from datasets.importers.sources import read_sources
from datasets.recording import Recording
from robot_model import builtin_robots
from workbench.core.errors import InputError
from workbench.recordings.importing.ball_clouds import with_ball_centres
from workbench.recordings.importing.board_poses import file_link, import_images
from workbench.recordings.importing.fits import CandidateFit
from workbench.recordings.importing.header_problems import header_error
from workbench.recordings.importing.measured_robot import Made, import_table
from workbench.recordings.importing.questions import Ask
from workbench.recordings.importing.sessions import import_sessions
from workbench.recordings.importing.surface_scans import import_scans, is_scan
from workbench.recordings.importing.timed_join import ClockDecision, OffsetMode, TimedJoin
from workbench.recordings.importing.user_columns import in_user_columns

MAPPING_FILE = "import.toml"
ROBOT_FILES = ("robot.toml", "robot.urdf")
"""Names of the robot's file in a recording."""


@dataclass(frozen=True)
class ImportOptions:
    """What the user says about an import; everything may be left out.

    `robot`: built-in name, robot.toml or URDF. `mapping`: from a file. `board`: keys of [board]. `artefact`: an
    artefact.csv. `ball_radius_mm`: certified radius of the ball of clouds. `sigma_mm`: of a coordinate. `ask`: asks a
    person; None refuses with a sentence. `trust_data`: a bad fit is a warning. `time_offset`: seconds to add to the
    times of the shorter of two tables, "auto" (estimate it), "none", or None: as the mapping states, else "auto".
    `name`: of the recording in messages; default: the name of the folder.
    """

    robot: str | None = None
    mapping: Mapping = field(default_factory=Mapping)
    board: Keys | None = None
    artefact: Path | None = None
    ball_radius_mm: float | None = None
    sigma_mm: float | None = None
    title: str = ""
    ask: Ask | None = None
    trust_data: bool = False
    time_offset: OffsetMode = None
    name: str = ""


@dataclass(frozen=True)
class ImportResult:
    """The recording as written, the complete mapping, the fits that decided, and what is worth saying.

    `doubts`: those of `warnings` that say what may be wrong with the data and is to be looked at before a calibration.
    `clocks`: of two tables that are joined by time; None otherwise. `links`: "time" and "images" with the columns that
    they are read from, and how.
    """

    recording: Recording
    mapping: Mapping
    fits: tuple[CandidateFit, ...]
    unused: tuple[str, ...]
    warnings: tuple[str, ...]
    clocks: ClockDecision | None = None
    links: Keys[str, Keys[str, object]] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    def as_json(self) -> dict:
        """`mapping`, `conventions` and `questions` of the answer (docs: results)."""
        clocks = {} if self.clocks is None else {"time_offset": self.clocks.as_json()}
        return {
            "measures": self.recording.measures,
            "samples": self.recording.n,
            "images": len(self.recording.images),
            "mapping": self.mapping.as_keys(),
            "links": {name: dict(link) for name, link in self.links.items()},
            "conventions": [fit.as_json() for fit in self.fits],
            "questions": [],
            "unused_columns": list(self.unused),
            "warnings": list(self.warnings),
            "doubts": list(self.doubts),
            **clocks,
        }


@dataclass(frozen=True)
class Found:
    """Everything that was read: the source, one joined table (None without tables), the mapping so far.

    `timed`: the two tables where they are joined by time; sentences on their rows are not in `warnings`. `sessions`:
    tables with the same columns, whose rows stand below each other in `table`, and `proposed`, the mapping of each.
    """

    source: Source
    table: RawTable | None
    mapping: Mapping
    unused: tuple[str, ...]
    warnings: tuple[str, ...]
    timed: TimedJoin | None = None
    sessions: tuple[RawTable, ...] = ()
    proposed: tuple[Mapping, ...] = ()

    @property
    def called(self) -> str:
        """The table for messages."""
        return "the images" if self.table is None else self.table.file

    def left_out(self) -> tuple[str, ...]:
        """Sentences on what the mapping leaves out although it looks like a quantity."""
        if self.table is None:
            return ()
        return left_out_sentences(self.table, self.mapping, bool(self.source.images))


def import_recording(
    paths: Sequence[Path],
    folder: Path,
    options: ImportOptions,
    progress: Callable[[str], None] = lambda text: None,
) -> ImportResult:
    """Write the recording of foreign files into a new folder, with the mapping next to it.

    Raises InputError with one sentence where a file cannot be read, a question is open or nothing fits the robot.
    """
    options = replace(options, name=options.name or folder.name)
    with TemporaryDirectory(prefix="workbench-import-") as scratch:
        found = find_mapping(paths, options, Path(scratch), progress)
        with _user_columns(found):
            found, made = _made(found, options, Path(scratch) / "recording", progress)
        # without a name of its own, a recording has that of its folder
        recording = replace(made.recording, title=options.title or _title(paths), name="")
        write(recording, folder)
    with _user_columns(found, made.mapping):
        read = _read_back(folder, options.trust_data)
    comment = (
        "# Mapping of this import. Repeat it with\n"
        f"#   workbench import {_names(paths)} --map {MAPPING_FILE} --out DIR\n"
    )
    write_mapping(_movable(made.mapping, folder), folder / MAPPING_FILE, comment)
    called = found.called
    dropped = () if found.table is None else unused_rotation_sentences(found.table, made.mapping)
    own = _UserWords(called, made.mapping)
    warnings = own.of((*found.warnings, *made.warnings, *dropped, *read.warnings))
    doubts = own.of((*made.doubts, *read.warnings))
    unused = never_read(found, made.mapping, "time_s" in recording.columns)
    links = links_of(found, made.mapping, "time_s" in recording.columns)
    return ImportResult(read, made.mapping, made.fits, unused, warnings, made.clocks, links, doubts)


@dataclass(frozen=True)
class _UserWords:
    """Sentences with the name of the user's file and its headers."""

    called: str
    mapping: Mapping

    def of(self, sentences: Sequence[str]) -> tuple[str, ...]:
        """The sentences, each once."""
        named = [in_user_columns(text, self.called, self.mapping) for text in sentences]
        return tuple(dict.fromkeys(named))


def file_columns(found: Found) -> tuple[str, ...]:
    """The column with names of images or clouds; () where none has them."""
    files = found.source.images or found.source.clouds
    return file_link(files, found.table)[0] if files else ()


def _movable(mapping: Mapping, folder: Path) -> Mapping:
    """The mapping with the robot of the recording, which lies next to it, in the place of a file elsewhere."""
    if mapping.robot is None or mapping.robot in builtin_robots():
        return mapping
    own = [name for name in ROBOT_FILES if (folder / name).is_file()]
    return replace(mapping, robot=own[0]) if own else mapping


def _made(found: "Found", options, folder: Path, progress) -> tuple["Found", Made]:
    """What was found, with the centres of balls in clouds, and the recording that is made of it. Raises InputError."""
    if found.source.images:
        return found, import_images(found, options, folder, progress)
    if is_scan(found):
        return found, Made(*import_scans(found, options, progress))
    if found.source.clouds:
        found = with_ball_centres(found, options, progress)
    if found.sessions:
        return found, import_sessions(found, options, progress)
    return found, import_table(found, options, progress)


@contextmanager
def _user_columns(found: "Found", mapping: Mapping | None = None):
    """Errors inside name the columns of the user's table instead of those of the recording."""
    try:
        yield
    except InputError as problem:
        sentence = in_user_columns(str(problem), found.called, mapping or found.mapping)
        raise InputError(sentence, problem.example) from None


def links_of(found: Found, mapping: Mapping, with_times: bool) -> dict[str, dict]:
    """Columns with times and with names of images or clouds, and how they are read.

    with_times: whether the recording has times.
    """
    table, source = found.table, found.source
    if table is None:
        return {}
    links = {}
    is_stated = "time_s" in mapping.columns.values()
    parts = (table,) if found.timed is None else found.timed.parts
    names = [f"{part.file}: {name}" for part in parts for name in time_columns(part)]
    if names and (with_times or found.timed is not None) and not is_stated:
        named = names if len(parts) > 1 else list(time_columns(table))
        links["time"] = {"columns": named, "read as": "time of the row, s since the first"}
    for kind, files in (("images", source.images), ("clouds", source.clouds)):
        if files:
            columns, words = file_link(files, table)
            links[kind] = {"columns": list(columns), "read as": words}
    return links


def never_read(found: Found, mapping: Mapping, with_times: bool) -> tuple[str, ...]:
    """Columns that no quantity, time, join or image name was read from; with_times: whether the recording has times."""
    if found.table is None:
        return found.unused
    read = {found.mapping.join.key, *file_columns(found)}
    if with_times or found.mapping.join.by == "time":
        read |= set(time_columns(found.table))
    # a column that several tables have is named "table: column"
    own = {name: name.rpartition(": ")[2] for name in found.unused}
    if found.mapping.join.by == "time":
        read |= {name for name, column in own.items() if read_header(column).kind == "time"}
    return tuple(
        name
        for name, column in own.items()
        if not read & {name, column} and not _is_mapped(mapping, name)
    )


def _read_back(folder: Path, trust_data: bool) -> Recording:
    """The recording as every command will read it; the folder is removed where it is refused. Raises InputError."""
    try:
        return read_recording(folder, trust_data)
    except InputError:
        shutil.rmtree(folder)
        raise


def find_mapping(
    paths: Sequence[Path],
    options: ImportOptions,
    scratch: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> Found:
    """Read the sources, join their tables and propose what the user's mapping leaves open. Raises InputError."""
    progress("reading the files")
    source = read_sources(paths, scratch)
    warnings = [*source.warnings]
    mapping = options.mapping
    if not source.tables:
        return Found(source, None, mapping, (), tuple(warnings))
    is_plain = not source.images and not source.clouds
    if is_plain and mapping.join.by in (None, APPEND) and are_sessions(source.tables, mapping):
        return _found_sessions(source, options, warnings)
    if mapping.join.by == APPEND and len(source.tables) > 1:
        raise _not_alike(source)
    tables, ignored = _useful(source, mapping)
    warnings += [sentence for table in tables for sentence in table.warnings]
    if ignored:
        warnings.append(f"Tables without a known quantity are not read: {', '.join(ignored)}.")
    wanted = mapping.join
    if options.time_offset is not None:
        seconds = options.time_offset if isinstance(options.time_offset, float) else None
        wanted = replace(wanted, time_offset_s=seconds)
    table, join, said = join_tables(tables, wanted)
    mapping, unused = _proposed(table, source, options)
    if len(tables) > 1:
        # an offset is part of the mapping only where it was stated or estimated
        stated = replace(join, time_offset_s=options.mapping.join.time_offset_s)
        mapping = replace(mapping, join=stated)
    if len(tables) == 2 and join.by == "time" and is_plain:
        timed = TimedJoin((tables[0], tables[1]), join)
        zone = timed.join.time_offset_s - (wanted.time_offset_s or 0.0)
        warnings += [zone_sentence(timed.short, timed.log, zone)] if zone else []
        return Found(source, table, mapping, unused, tuple(warnings), timed)
    return Found(source, table, mapping, unused, (*warnings, *said))


def _found_sessions(source: Source, options: ImportOptions, warnings: Sequence[str]) -> Found:
    """Tables with the same columns: their rows below each other, and the mapping of each."""
    tables = source.tables
    table = appended(tables)
    proposed = [_proposed(one, source, options)[0] for one in tables]
    mapping, unused = _proposed(table, source, options)
    join = Join(APPEND)
    proposed = [replace(one, join=join) for one in proposed]
    mapping = replace(mapping, join=join)
    said = (*warnings, *table.warnings)
    return Found(source, table, mapping, unused, said, sessions=tables, proposed=tuple(proposed))


def _proposed(table: RawTable, source: Source, options: ImportOptions):
    """The user's mapping, completed by what the headers of a table suggest, and the columns that it leaves out."""
    proposal = propose(table, bool(source.images), bool(source.clouds))
    mapping = options.mapping.merged(proposal.mapping)
    if mapping.point is not None and mapping.measures in (None, "external-point"):
        # the mapping file may name a point or a rotation that no header shows
        stated = options.mapping.measures
        mapping = replace(mapping, measures=stated or measures_of(mapping))
    return mapping, tuple(name for name in proposal.unused if not _is_mapped(mapping, name))


def _not_alike(source: Source) -> InputError:
    names = ", ".join(table.file for table in source.tables)
    return InputError(
        f'{names}: expected several tables with the same columns for [join] by = "{APPEND}", each with joint readings '
        "and a measurement, found others; correct the headers, or remove the key from the mapping file."
    )


def _useful(source: Source, mapping: Mapping) -> tuple[list[RawTable], list[str]]:
    """Tables with at least one known set of columns, and the names of the others."""
    named = set(mapping.columns)
    for quantity in ("joints", "point", "rotation", "axis", "flange_point", "flange_rotation"):
        group = getattr(mapping, quantity)
        named |= set(group.columns) if group is not None else set()
    useful = [t for t in source.tables if find_sets(t) or named & set(t.columns)]
    if not useful:
        if len(source.tables) == 1 or source.images:
            return list(source.tables[:1]), []
        raise _nothing_known(source.tables[0], mapping)
    return useful, [t.file for t in source.tables if not any(t is one for one in useful)]


def _nothing_known(table: RawTable, mapping: Mapping) -> InputError:
    shown = ", ".join(list(table.columns)[:12])
    sentence = (
        f"{table.file}: expected headers that name joint readings and points, found {shown}; write a mapping file "
        'with [joints] columns = ["...", ...] and [point] columns = ["...", "...", "..."] and name it with --map.'
    )
    return header_error(table, mapping, mapping.robot, [sentence])


def _is_mapped(mapping: Mapping, name: str) -> bool:
    keys = mapping.as_keys()
    groups = [
        value["columns"]
        for value in keys.values()
        if isinstance(value, dict) and isinstance(value.get("columns"), list)
    ]
    return name in mapping.columns or any(name in columns for columns in groups)


def _title(paths: Sequence[Path]) -> str:
    return f"imported from {_names(paths)}"


def _names(paths: Sequence[Path]) -> str:
    return " ".join(Path(path).name for path in paths)
