"""The whole import: sources, proposal, joined table, decisions, recording, and its check."""

import shutil
from collections.abc import Callable, Sequence
from collections.abc import Mapping as Keys
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from datasets.columns import KINDS
from datasets.formats.recording1 import read_recording
from datasets.formats.recording1_writer import write
from datasets.importers.mapping.conversion import (
    axis_columns,
    complete_rows,
    joint_columns,
    other_columns,
    point_columns,
    rotation_columns,
)
from datasets.importers.mapping.headers import read_header
from datasets.importers.mapping.joining import join_tables, time_columns
from datasets.importers.mapping.model import Mapping, write_mapping
from datasets.importers.mapping.proposal import measures_of, propose
from datasets.importers.mapping.sets import find_sets
from datasets.importers.source import RawTable, Source
from datasets.importers.sources import read_sources
from datasets.recording import Recording
from robot_model import builtin_robots, load_robot
from workbench.core.errors import InputError
from workbench.recordings.importing import decisions
from workbench.recordings.importing.ball_clouds import with_ball_centres
from workbench.recordings.importing.board_poses import image_column, import_images
from workbench.recordings.importing.final_check import check_fit
from workbench.recordings.importing.fits import CandidateFit
from workbench.recordings.importing.questions import Ask
from workbench.recordings.importing.robots import read_artefact, robot_candidates, robot_keys
from workbench.recordings.importing.surface_scans import import_scans, is_scan

MAPPING_FILE = "import.toml"
_EXTERNAL = ("external-point", "external-pose", "partial-pose")
_OTHER_KIND = {"external-point": "ball-centre", "ball-centre": "external-point"}


@dataclass(frozen=True)
class ImportOptions:
    """What the user says about an import; everything may be left out.

    `robot`: built-in name, robot.toml or URDF. `mapping`: from a file. `board`: keys of [board]. `artefact`: an
    artefact.csv. `ball_radius_mm`: certified radius of the ball of clouds. `sigma_mm`: of a coordinate. `ask`: asks a
    person; None refuses with a sentence. `trust_data`: a bad fit is a warning.
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


@dataclass(frozen=True)
class ImportResult:
    """The recording as written, the complete mapping, the fits that decided, and what is worth saying."""

    recording: Recording
    mapping: Mapping
    fits: tuple[CandidateFit, ...]
    unused: tuple[str, ...]
    warnings: tuple[str, ...]

    def as_json(self) -> dict:
        """`mapping`, `conventions` and `questions` of the answer (docs: results)."""
        return {
            "measures": self.recording.measures,
            "samples": self.recording.n,
            "images": len(self.recording.images),
            "mapping": self.mapping.as_keys(),
            "conventions": [fit.as_json() for fit in self.fits],
            "questions": [],
            "unused_columns": list(self.unused),
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class Found:
    """Everything that was read: the source, one joined table (None without tables), the mapping so far."""

    source: Source
    table: RawTable | None
    mapping: Mapping
    unused: tuple[str, ...]
    warnings: tuple[str, ...]


def import_recording(
    paths: Sequence[Path],
    folder: Path,
    options: ImportOptions,
    progress: Callable[[str], None] = lambda text: None,
) -> ImportResult:
    """Write the recording of foreign files into a new folder, with the mapping next to it.

    Raises InputError with one sentence where a file cannot be read, a question is open or nothing fits the robot.
    """
    with TemporaryDirectory(prefix="workbench-import-") as scratch:
        found = find_mapping(paths, options, Path(scratch), progress)
        if found.source.images:
            made = import_images(found, options, Path(scratch) / "recording", progress)
        elif is_scan(found):
            made = import_scans(found, options, progress)
        elif found.source.clouds:
            found = with_ball_centres(found, options, progress)
            made = _import_table(found, options, progress)
        else:
            made = _import_table(found, options, progress)
        recording, mapping, fits, said = made
        recording = replace(recording, title=options.title or _title(paths))
        write(recording, folder)
    read = _read_back(folder, options.trust_data)
    comment = (
        "# Mapping of this import. Repeat it with\n"
        f"#   workbench import {_names(paths)} --map {MAPPING_FILE} --out DIR\n"
    )
    write_mapping(mapping, folder / MAPPING_FILE, comment)
    warnings = (*found.warnings, *said, *read.warnings)
    unused = _never_read(found, mapping, "time_s" in recording.columns)
    return ImportResult(read, mapping, fits, unused, tuple(dict.fromkeys(warnings)))


def _never_read(found: Found, mapping: Mapping, with_times: bool) -> tuple[str, ...]:
    """Columns that no quantity, time, join or image name was read from; with_times: whether the recording has times."""
    if found.table is None:
        return found.unused
    read = {found.mapping.join.key, *image_column(found.source.images, found.table)}
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
    tables, ignored = _useful(source, mapping)
    warnings += [sentence for table in tables for sentence in table.warnings]
    if ignored:
        warnings.append(f"Tables without a known quantity are not read: {', '.join(ignored)}.")
    table, join, said = join_tables(tables, mapping.join)
    proposal = propose(table, bool(source.images), bool(source.clouds))
    mapping = mapping.merged(proposal.mapping)
    if mapping.point is not None and mapping.measures in (None, "external-point"):
        # the mapping file may name a point or a rotation that no header shows
        stated = options.mapping.measures
        mapping = replace(mapping, measures=stated or measures_of(mapping))
    if len(tables) > 1:
        mapping = replace(mapping, join=join)
    unused = tuple(name for name in proposal.unused if not _is_mapped(mapping, name))
    return Found(source, table, mapping, unused, (*warnings, *said))


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
        raise _nothing_known(source.tables[0])
    return useful, [t.file for t in source.tables if not any(t is one for one in useful)]


def _nothing_known(table: RawTable) -> InputError:
    shown = ", ".join(list(table.columns)[:12])
    return InputError(
        f"{table.file}: expected headers that name joint readings and points, found {shown}; write a mapping file "
        'with [joints] columns = ["...", ...] and [point] columns = ["...", "...", "..."] and name it with --map.'
    )


def _is_mapped(mapping: Mapping, name: str) -> bool:
    keys = mapping.as_keys()
    groups = [
        value["columns"]
        for value in keys.values()
        if isinstance(value, dict) and isinstance(value.get("columns"), list)
    ]
    return name in mapping.columns or any(name in columns for columns in groups)


def _import_table(found: Found, options: ImportOptions, progress):
    """Recording, complete mapping, fits and warnings of a robot that was measured."""
    table, mapping = found.table, found.mapping
    if mapping.joints is None:
        raise _without_joints(table, mapping)
    measures = mapping.measures
    if measures is None or measures not in KINDS or KINDS[measures].images:
        raise _without_measurement(table, mapping)
    table, said = complete_rows(table, mapping)
    named = options.robot or mapping.robot
    if named is None:
        progress("comparing the built-in robots")
        named = _robot_that_fits(table, mapping, options)
        said = (*said, f"No robot was named; of the built-in ones {named} fits.")
    keys, decided = _robot_of(named, table, mapping, options)
    said = (*said, *decided)
    robot = load_robot(keys, f"--robot {named}")
    _check_count(robot, mapping, table)
    builder = Builder(table, keys, robot, options)
    progress("testing units on the robot")
    mapping = replace(mapping, robot=named)
    decision = decisions.decide_units(robot, mapping, builder.positions, table.file, options.ask)
    fits = decision.fits
    if options.mapping.measures is None and fits and not fits[0].is_good:
        _refuse_other_kind(robot, mapping, builder, fits[0])
    if mapping.rotation is not None and measures == "external-pose":
        progress("testing rotation conventions on the robot")
        decision = decisions.decide_rotation(
            robot, decision.mapping, table, builder.complete, options.ask
        )
        fits = decision.fits
    recording = builder.complete(decision.mapping)
    said = (*said, *check_fit(robot, recording, fits, options.trust_data))
    return recording, decision.mapping, fits, said


def _robot_of(named: str, table: RawTable, mapping: Mapping, options: ImportOptions):
    """Keys of the named robot, and a sentence where the data decided the convention of its table."""
    candidates = robot_candidates(named, table.file)
    if len(candidates) == 1:
        return next(iter(candidates.values())), ()
    for title, keys in candidates.items():
        _check_count(load_robot(keys, title), mapping, table)

    def build_with(title: str):
        robot = load_robot(candidates[title], title)
        return robot, Builder(table, candidates[title], robot, options).positions

    chosen = decisions.decide_robot(mapping, build_with, list(candidates), table.file, options.ask)
    return candidates[chosen], (f"The convention of the table was open; of both {chosen} fits.",)


def _refuse_other_kind(robot, mapping: Mapping, builder: "Builder", found: CandidateFit) -> None:
    """Raise InputError where points fit in the frame of the other side: a sensor on the flange or an instrument."""
    if mapping.measures not in _OTHER_KIND:
        return
    other = _OTHER_KIND[mapping.measures]
    readings = [
        (title, replace(made, measures=other, rotation=None))
        for title, made in decisions.unit_readings(mapping)
    ]
    best = decisions.compare(robot, readings, builder.complete)
    if best and best[0][1].is_good:
        raise InputError(
            f"{builder.table.file}: expected points of kind {mapping.measures}, which fit with "
            f"{found.rms_mm:.3g} mm, found that they fit as {other} ({best[0][1].words}); add "
            f'measures = "{other}" to a mapping file and name it with --map.'
        )


def _robot_that_fits(table: RawTable, mapping: Mapping, options: ImportOptions) -> str:
    """The built-in robot that fits clearly best. Raises InputError as `decisions.decide_robot`."""

    def build_with(name: str):
        robot = load_robot(name)
        return robot, Builder(table, {"builtin": name}, robot, options).positions

    count = len(mapping.joints.columns)
    names = [name for name in builtin_robots() if load_robot(name).mixing.shape[1] == count]
    if not names:
        robot_keys(None, table.file)
    return decisions.decide_robot(mapping, build_with, names, table.file, options.ask)


def _check_count(robot, mapping: Mapping, table: RawTable) -> None:
    wanted = robot.mixing.shape[1]
    if len(mapping.joints.columns) != wanted:
        columns = ", ".join(f'"{name}"' for name in mapping.joints.columns[:wanted])
        raise InputError(
            f"{table.file}: expected {wanted} joint columns for '{robot.name}', found "
            f"{len(mapping.joints.columns)} ({', '.join(mapping.joints.columns)}); add [joints] columns = [{columns}] "
            "to a mapping file and name it with --map, or name another robot."
        )


def _without_joints(table: RawTable, mapping: Mapping) -> InputError:
    shown = ", ".join(list(table.columns)[:16])
    if mapping.flange_point is not None and mapping.point is not None:
        return InputError(
            f"{table.file}: expected joint readings, which a calibration of the robot needs, found poses of the flange "
            f"({', '.join(mapping.flange_point.columns)}) only; export the joint angles of the same rows too."
        )
    return InputError(
        f"{table.file}: expected columns with joint readings such as J1 ... J6, found {shown}; add [joints] columns = "
        '["...", ...] to a mapping file and name it with --map, or name the file with the joint log as well.'
    )


def _without_measurement(table: RawTable, mapping: Mapping) -> InputError:
    shown = ", ".join(name for name in table.columns if name not in mapping.joints.columns)
    return InputError(
        f"{table.file}: expected columns with a measured point such as X, Y, Z, found "
        f"{shown or 'joint readings only'}; "
        'add [point] columns = ["...", "...", "..."] (or measures = "touch-point", "plane-touch", ...) to a mapping '
        "file and name it with --map, or name the file of the instrument as well."
    )


@dataclass(frozen=True)
class Builder:
    """Makes recordings of one table under different mappings."""

    table: RawTable
    keys: Keys
    robot: object
    options: ImportOptions

    def positions(self, mapping: Mapping) -> Recording:
        """The recording of the positions alone, for the test of the units."""
        measures = "external-point" if mapping.measures in _EXTERNAL else mapping.measures
        return self._recording(replace(mapping, measures=measures, rotation=None, axis=None))

    def complete(self, mapping: Mapping) -> Recording:
        """The whole recording. Raises InputError where numbers cannot be what the mapping says."""
        return self._recording(mapping)

    def _recording(self, mapping: Mapping) -> Recording:
        table = self.table
        columns: dict[str, np.ndarray] = {"sample": np.arange(1, table.n + 1, dtype=float)}
        length = mapping.point.unit if mapping.point is not None and mapping.point.unit else "mm"
        slides = self.robot.mixing.any(0) & (self.robot.prismatic @ np.abs(self.robot.mixing) > 0)
        columns |= joint_columns(table, mapping.joints, slides, length)
        if mapping.point is not None:
            columns |= point_columns(table, mapping.point)
        if mapping.rotation is not None and mapping.rotation.convention:
            columns |= rotation_columns(table, mapping.rotation)
        elif mapping.axis is not None:
            columns |= axis_columns(table, mapping.axis)
        columns |= _named_groups(other_columns(table, mapping))
        balls = read_artefact(self.options.artefact) if self.options.artefact else {}
        if mapping.measures == "ball-centre":
            columns.setdefault("ball", np.ones(table.n))
            balls = balls or {int(columns["ball"][0]): (0.0, 0.0, 0.0, 10.0)}
        return Recording(
            measures=mapping.measures,
            columns=columns,
            robot=self.keys,
            sigma_mm=self.options.sigma_mm,
            balls=balls,
            name="import",
        )


def _named_groups(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Names of groups as numbers in the order in which they first occur, as the reader of recordings does."""
    made = {}
    for name, cells in columns.items():
        if cells.dtype.kind == "f" or name == "note":
            made[name] = cells
            continue
        order = list(dict.fromkeys(cells.tolist()))
        made[name] = np.array([order.index(cell) + 1 for cell in cells.tolist()], float)
    return made


def _title(paths: Sequence[Path]) -> str:
    return f"imported from {_names(paths)}"


def _names(paths: Sequence[Path]) -> str:
    return " ".join(Path(path).name for path in paths)
