"""The whole import: what was found in the sources, decisions, recording, and its check."""

import shlex
import shutil
from collections.abc import Callable, Sequence
from collections.abc import Mapping as Keys
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from datasets.formats.recording1 import read_recording
from datasets.formats.recording1_writer import write
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.joined_tables.joining import time_columns
from datasets.importers.mapping.joined_tables.sessions import SESSION
from datasets.importers.mapping.left_out import unused_rotation_sentences
from datasets.importers.mapping.model import Mapping, write_mapping
from datasets.recording import Recording
from robot_model import builtin_robots
from sensors.camera.model import Camera
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import DESCRIPTIONS, file_and_tip
from workbench.recordings.importing.ball_scans.ball_clouds import with_ball_centres
from workbench.recordings.importing.ball_scans.centre_tables import (
    import_centres,
    import_positions_alone,
)
from workbench.recordings.importing.ball_scans.profile_tables import import_profiles
from workbench.recordings.importing.ball_scans.surface_scans import (
    import_scans,
    is_profile_file,
    is_scan,
)
from workbench.recordings.importing.board_images.board_poses import import_images
from workbench.recordings.importing.board_images.image_rows import file_link
from workbench.recordings.importing.final_check import LARGE_ERRORS
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.interpretation.questions import Ask
from workbench.recordings.importing.measured_robot import Made, import_table
from workbench.recordings.importing.remarks import remarks_sentence, unused_sentence
from workbench.recordings.importing.robots import read_artefact
from workbench.recordings.importing.sessions import import_sessions
from workbench.recordings.importing.sources.finding import Found, find_mapping, is_mapped
from workbench.recordings.importing.sources.timed_join import ClockDecision, OffsetMode
from workbench.recordings.importing.target_poses.tables import UnexplainedPoses, import_target_poses
from workbench.recordings.importing.user_columns import in_user_columns
from workbench.recordings.inspection.needs import coverage_needs

MAPPING_FILE = "import.toml"
ROBOT_FILES = ("robot.toml", *(f"robot{suffix}" for suffix in DESCRIPTIONS))
"""Names of the robot's file in a recording."""


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import; all are optional.

    `robot`: built-in name, robot.toml, URDF or MJCF. `mapping`: from a file. `board`: keys of [board]. `artefact`: an
    artefact.csv. `ball_radius_mm`: certified radius of the ball of clouds. `sigma_mm`: of a coordinate. `ask`: asks a
    person; None refuses with a sentence. `trust_data`: a bad fit is a warning. `time_offset`: seconds to add to the
    times of the shorter of two tables, "auto" (estimate it), "none", or None: as the mapping states, else "auto".
    `name`: of the recording in messages; default: the name of the folder.
    `camera`: of images of a board; None: it is calibrated from them.
    """

    robot: str | None = None
    mapping: Mapping = field(default_factory=Mapping)
    board: Keys | None = None
    camera: Camera | None = None
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

    `suspicions`: those `warnings` that say what may be wrong with the data and is to be checked before a calibration.
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
    suspicions: tuple[str, ...] = ()

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
            "doubts": list(self.suspicions),
            **clocks,
        }


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
        with _user_columns(found), _remarks(found):
            found, built = _made(found, options, Path(scratch) / "recording", progress)
            _check_clock(built, options.trust_data)
        # without a name of its own, a recording has that of its folder
        recording = replace(built.recording, title=options.title or _title(paths), name="")
        write(recording, folder)
    with _user_columns(found, built.mapping):
        read = _read_back(folder, options.trust_data)
    comment = (
        "# Mapping of this import. Repeat it with\n"
        f"#   workbench import {_names(paths)} {shlex.join(repeated_options(options))} --out DIR\n"
    )
    write_mapping(_movable(built.mapping, folder), folder / MAPPING_FILE, comment)
    called = found.called
    if found.table is None:
        dropped = ()
    else:
        dropped = unused_rotation_sentences(found.table, built.mapping)
    user_words = _UserWords(called, built.mapping)
    needs = coverage_needs(read)
    required = [need.sentence for need in needs if need.is_required]
    useful = [need.sentence for need in needs if not need.is_required]
    warning_sentences = user_words.of((*built.suspicions, *read.warnings, *required))
    explained = [remarks_sentence(found.table, built.mapping)] if warning_sentences else []
    warnings = user_words.of(
        (*found.warnings, *built.warnings, *dropped, *useful, *read.warnings, *required)
    )
    warnings = (*warnings, *filter(None, explained))
    unused = never_read(found, built.mapping, "time_s" in recording.columns)
    links = links_of(found, built.mapping, "time_s" in recording.columns)
    return ImportResult(
        read, built.mapping, built.fits, unused, warnings, built.clocks, links, warning_sentences
    )


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
    if files:
        return file_link(files, found.table)[0]
    return ()


def _movable(mapping: Mapping, folder: Path) -> Mapping:
    """The mapping with the robot of the recording, which lies next to it, in the place of a file elsewhere."""
    if mapping.robot is None or mapping.robot in builtin_robots():
        return mapping
    robot_files = [name for name in ROBOT_FILES if (folder / name).is_file()]
    if not robot_files:
        return mapping
    _, tip = file_and_tip(mapping.robot)
    if tip is None:
        robot = robot_files[0]
    else:
        robot = f"{robot_files[0]}#{tip}"
    return replace(mapping, robot=robot)


def _made(found: Found, options, folder: Path, progress) -> tuple[Found, Made]:
    """Sources with the centres of balls in clouds, and the recording made from them. Raises InputError."""
    if found.source.images:
        return found, import_images(found, options, folder, progress)
    options = _with_certified_radius(found, options)
    if is_scan(found):
        return found, import_scans(found, options, progress)
    if options.ball_radius_mm is not None and not found.source.clouds:
        raise _without_clouds(found, options.ball_radius_mm)
    if found.source.clouds and is_profile_file(found.source.clouds[0]):
        return found, import_profiles(found, options, progress)
    if found.source.clouds:
        found, suspicions = with_ball_centres(found, options, progress)
        return found, _made_of_table(found, options, progress).with_suspicions(suspicions)
    return found, _made_of_table(found, options, progress)


def _with_certified_radius(found: Found, options):
    """The options with the radius of the artefact's balls, where no radius is stated and all have the same one."""
    if options.ball_radius_mm is not None or options.artefact is None or not found.source.clouds:
        return options
    radii = {radius for *_, radius in read_artefact(options.artefact).values()}
    return replace(options, ball_radius_mm=radii.pop()) if len(radii) == 1 else options


def _made_of_table(found: Found, options, progress) -> Made:
    """The recording of tables alone. Raises InputError."""
    try:
        made = import_target_poses(found, options, progress)
    except UnexplainedPoses as problem:
        made = import_positions_alone(found, options, progress, problem.reason)
        if made is None:
            raise
    made = made or import_centres(found, options, progress)
    if made is not None:
        return made
    if found.sessions:
        return import_sessions(found, options, progress)
    return import_table(found, options, progress)


def _check_clock(built: Made, trust_data: bool) -> None:
    """InputError where an offset of the clocks may explain errors that are accepted otherwise."""
    clocks = built.clocks
    if clocks is None or not clocks.is_doubt or trust_data:
        return
    errors = [text for text in (*built.suspicions, *built.warnings) if LARGE_ERRORS in text]
    if errors:
        raise InputError(f"{clocks.sentence} {errors[0]}")


def _without_clouds(found: Found, radius: float) -> InputError:
    files = ", ".join(table.file for table in found.source.tables)
    return InputError(
        f"--ball-radius {radius:g}: expected clouds or profiles of the ball, found only tables ({files}); write each "
        "scan into a file of its own (.ply, .pcd, .xyz, .asc, or text with the columns x and z), and name their folder."
    )


def repeated_options(options: ImportOptions, mapping_file: Path | str = MAPPING_FILE) -> list[str]:
    """Words of a command that repeats an import: the mapping, and what a mapping does not hold."""
    words = ["--map", str(mapping_file)]
    if options.ball_radius_mm is not None:
        words += ["--ball-radius", f"{options.ball_radius_mm:g}"]
    if options.sigma_mm is not None:
        words += ["--sigma", f"{options.sigma_mm:g}"]
    if options.artefact is not None:
        words += ["--artefact", str(options.artefact)]
    return words


@contextmanager
def _user_columns(found: Found, mapping: Mapping | None = None):
    """Errors inside name the columns of the user's table instead of those of the recording."""
    try:
        yield
    except InputError as problem:
        sentence = in_user_columns(str(problem), found.called, mapping or found.mapping)
        raise InputError(sentence, problem.example) from None


@contextmanager
def _remarks(found: Found):
    """Errors inside end with the remarks and the unused columns of the user's table, which may explain them."""
    try:
        yield
    except InputError as problem:
        if problem.example:  # the example lists all columns
            raise
        unused = never_read(found, found.mapping, with_times=True)
        sentences = (
            remarks_sentence(found.table, found.mapping),
            unused_sentence(found.table, unused),
        )
        raise InputError(" ".join(filter(None, (str(problem), *sentences)))) from None


def links_of(found: Found, mapping: Mapping, with_times: bool) -> dict[str, dict]:
    """Columns with times and with names of images or clouds, and how they are read.

    with_times: whether the recording has times.
    """
    table, source = found.table, found.source
    if table is None:
        return {}
    links = {}
    is_stated = "time_s" in mapping.columns.values()
    tables = (table,) if found.timed is None else found.timed.tables
    names = [f"{part.file}: {name}" for part in tables for name in time_columns(part)]
    if names and (with_times or found.timed is not None) and not is_stated:
        named = names if len(tables) > 1 else list(time_columns(table))
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
    join = found.mapping.join
    read = {join.key, SESSION, *file_columns(found)}
    if with_times or join.by == "time":
        read |= set(time_columns(found.table))
    # a column that several tables have is named "table: column"
    names_of_columns = {name: name.rpartition(": ")[2] for name in found.unused}
    if join.by == "time":
        read |= {
            name for name, column in names_of_columns.items() if read_header(column).kind == "time"
        }
    return tuple(
        name
        for name, column in names_of_columns.items()
        if not read & {name, column} and not is_mapped(mapping, name)
    )


def _read_back(folder: Path, trust_data: bool) -> Recording:
    """The recording as every command will read it; the folder is removed where it is refused. Raises InputError."""
    try:
        return read_recording(folder, trust_data)
    except InputError:
        shutil.rmtree(folder)
        raise


def _title(paths: Sequence[Path]) -> str:
    return f"imported from {_names(paths)}"


def _names(paths: Sequence[Path]) -> str:
    return " ".join(Path(path).name for path in paths)
