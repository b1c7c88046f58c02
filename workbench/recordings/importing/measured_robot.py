"""Import of a table of a measured robot: robot, clocks, units and rotation convention, decided by fits."""

from collections.abc import Mapping as Keys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.reflectors import stacked
from datasets.importers.mapping.conversion import complete_rows
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.importers.sources.dh_tables import is_dh_table
from datasets.importers.units import LENGTHS
from datasets.recording import Recording
from datasets.samples.columns import KINDS
from robot_model import builtin_robots, load_robot
from robot_model.state import sliding
from workbench.core.deadline import OutOfTime, limited
from workbench.core.errors import InputError
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.calculated_points import calculated_points, guessed_robot
from workbench.recordings.importing.final_check import check_fit
from workbench.recordings.importing.interpretation import decisions, robot_decision
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.interpretation.label_columns import (
    best_labels,
    label_columns,
    label_sentence,
)
from workbench.recordings.importing.interpretation.rotation_decision import decide_rotation
from workbench.recordings.importing.interpretation.rotation_mistakes import refuse_rotation_mistake
from workbench.recordings.importing.interpretation.text_cells import text_sentence
from workbench.recordings.importing.interpretation.unnamed_columns import (
    find_unnamed,
    refuse_wrong_slides,
)
from workbench.recordings.importing.robots import robot_candidates, robot_keys
from workbench.recordings.importing.segments.reading_changes import (
    refuse_changed_rotation,
    refuse_changed_units,
)
from workbench.recordings.importing.segments.shifted_rows import refuse_shifted_rows
from workbench.recordings.importing.sources.finding import is_mapped
from workbench.recordings.importing.sources.header_problems import header_error
from workbench.recordings.importing.sources.no_joints import refuse_without_joints
from workbench.recordings.importing.sources.required_columns import with_required_columns
from workbench.recordings.importing.sources.timed_join import ClockDecision, decide_offset

_SEARCH_S = 15.0
"""Processor time of a search for the cause of a misfit."""
_FIXED_ROWS = (
    " A row of the Denavit-Hartenberg table that moves with no joint, such as the flange's, needs the word fixed in a "
    "column type, and the theta of a joint needs its variable (q6) where those of the others have theirs."
)
_OTHER_KIND = {"external-point": "ball-centre", "ball-centre": "external-point"}


@dataclass(frozen=True)
class Made:
    """The recording, the complete mapping, the fits that decided, and what is worth saying.

    `suspicions`: those of `warnings` that say what may be wrong with the data. `clocks`: of two tables that are joined
    by time; None otherwise.
    """

    recording: Recording
    mapping: Mapping
    fits: tuple[CandidateFit, ...]
    warnings: tuple[str, ...]
    clocks: ClockDecision | None = None
    suspicions: tuple[str, ...] = ()

    def with_suspicions(self, suspicions: tuple[str, ...]) -> "Made":
        """The same with further suspicions, which come first."""
        warnings = tuple(dict.fromkeys((*suspicions, *self.warnings)))
        return replace(self, warnings=warnings, suspicions=(*suspicions, *self.suspicions))


@dataclass(frozen=True)
class DecidedTable:
    """One table with its decision: `builder` of its complete rows, and sentences on rows left out and assumptions.

    `clocks`: of two tables that are joined by time; None otherwise.
    """

    builder: Builder
    decision: decisions.Decision
    notes: tuple[str, ...]
    clocks: ClockDecision | None = None


def import_table(found, options, progress) -> Made:
    """The recording of a robot that an instrument or a sensor on its flange measured.

    found, options: `Found` and `ImportOptions` of the import. Raises InputError where columns are missing, a question
    is open or nothing fits the robot.
    """
    decided = decide_table(found, options, progress)
    clocks = decided.clocks
    with _clocks_named(clocks):
        imported = _finished(decided, found, options)
    if clocks is not None and clocks.is_doubt:
        warnings = (*imported.suspicions, clocks.sentence)
    else:
        warnings = imported.suspicions
    return replace(imported, suspicions=warnings)


@contextmanager
def _clocks_named(clocks: ClockDecision | None):
    """Errors inside also say what is open about the clocks of two tables."""
    try:
        yield
    except InputError as problem:
        if clocks is None or not (clocks.is_doubt or clocks.estimate is None):
            raise
        raise InputError(f"{problem} {clocks.sentence}", problem.example) from None


def decide_table(found, options, progress) -> DecidedTable:
    """Robot, clocks, units and rotation convention of one table, before its recording is made.

    Raises as `import_table`.
    """
    mapping, candidates, notes = _with_robot(found, options, progress)
    table = _with_reflectors(found, mapping)
    found = replace(found, mapping=mapping, table=table)
    clocks = _decide_clocks(found, mapping, candidates, options, progress)
    if clocks is not None:
        table, joined = found.timed.joined_at(clocks.seconds)
        mapping = replace(mapping, join=replace(mapping.join, time_offset_s=clocks.seconds))
        notes = (*notes, *joined, *((clocks.sentence,) if clocks.is_warning else ()))
    else:
        mapping, labels = _with_labels(table, mapping, candidates, options)
        notes = (*notes, *labels)
    with _clocks_named(clocks):
        decided = _decided(table, mapping, candidates, options, progress)
    return replace(decided, notes=(*notes, *decided.notes), clocks=clocks)


def _with_robot(found, options, progress):
    """The mapping with columns and robot, every robot that the name may mean, and sentences on what was assumed."""
    mapping, notes = with_unnamed_columns(found, options, progress)
    table = _with_reflectors(found, mapping)
    named = options.robot or mapping.robot
    missing = _missing(table, mapping)
    if missing:
        refuse_without_joints(table, mapping, named, [part.file for part in found.source.tables])
        raise header_error(table, mapping, named, missing)
    mapping = with_required_columns(table, mapping)
    if named is None:
        progress("comparing the built-in robots")
        named = _robot_that_fits(complete_rows(table, mapping)[0], mapping, options)
    mapping = replace(mapping, robot=named)
    return mapping, _candidates(named, table, mapping), notes


def _with_reflectors(found, mapping: Mapping) -> RawTable:
    """The table with a row for each reflector, where the fit to the robot has found them in one row."""
    is_new = mapping.reflectors and not found.mapping.reflectors
    return stacked(found.table, mapping) if is_new else found.table


def with_unnamed_columns(found, options, progress) -> tuple[Mapping, tuple[str, ...]]:
    """The mapping with columns whose headers are unknown, where one set of them fits the robot, and a sentence."""
    named = options.robot or found.mapping.robot
    if named is None or found.timed is not None or options.mapping.measures is not None:
        return found.mapping, ()
    progress("comparing columns with unknown headers on the robot")
    try:
        candidates = robot_candidates(named, found.table.file)
    except InputError:
        if _missing(found.table, found.mapping):
            return found.mapping, ()  # the error of the headers states that of the robot, too
        raise
    robots = [(load_robot(keys, title), keys) for title, keys in candidates.items()]

    def positions(robot, rows, mapping):
        robot_position = next(position for candidate, position in robots if candidate is robot)
        return Builder(rows, robot_position, robot, options).positions(mapping)

    arms = [robot for robot, _ in robots]
    try:
        with limited(_SEARCH_S, _searching(progress, "comparing columns with unknown headers")):
            return find_unnamed(found.table, found.mapping, arms, positions, options.ask)
    except OutOfTime:
        return found.mapping, ()


def _with_labels(
    table: RawTable, mapping: Mapping, candidates: dict[str, Keys], options
) -> tuple[Mapping, tuple[str, ...]]:
    """The mapping with the column that distinguishes the reflectors, where the points fit with it alone; a sentence."""
    is_point = mapping.measures in ("external-point", "external-pose")
    if not is_point or not label_columns(table, mapping):
        return mapping, ()
    rows, _ = complete_rows(table, mapping)
    arms = [(load_robot(keys, title), keys) for title, keys in candidates.items()]
    builders = [Builder(rows, keys, robot, options) for robot, keys in arms]

    def fit(candidate: Mapping) -> CandidateFit | None:
        readings = list(decisions.unit_readings(candidate))
        fits = [
            decisions.compare(builder.robot, readings, builder.positions, 1) for builder in builders
        ]
        found = [compared[0][1] for compared in fits if compared]
        return min(found, key=lambda builder: builder.improbability, default=None)

    found = best_labels(rows, mapping, fit)
    if found is None:
        return (mapping, ())
    return (found.mapping, (label_sentence(rows, found),))


def _decided(table: RawTable, mapping: Mapping, candidates, options, progress) -> DecidedTable:
    """The decision on the complete rows of a table."""
    table, incomplete = complete_rows(table, mapping)
    keys, decided = _robot_of(candidates, table, mapping, options, progress)
    robot = load_robot(keys, f"--robot {mapping.robot}")
    builder = Builder(table, keys, robot, options)
    decision = _decide(builder, mapping, options, progress)
    assumed = (decision.assumed,) if decision.assumed else ()
    return DecidedTable(builder, decision, (*incomplete, *decided, *assumed))


def _finished(decided: DecidedTable, found, options) -> Made:
    """The recording of a decided table, after the last check."""
    builder, decision, clocks = decided.builder, decided.decision, decided.clocks
    recording = builder.complete(decision.mapping)
    if clocks is not None:
        used = replace(found.timed, join=decision.mapping.join)
        speeds = used.speeds(builder, decision.mapping)
        recording = replace(recording, columns={**speeds, **recording.columns})
    lines = builder.table.lines
    calculated = calculated_points(builder, decision.mapping, recording, options)
    checked = check_fit(builder.robot, recording, decision.fits, options.trust_data, lines)
    is_named = (options.robot or found.mapping.robot) is not None
    guess = () if is_named else guessed_robot(builder, recording, calculated, options)
    recording = replace(recording, remarks=(*guess, *calculated))
    checked = (*guess, *calculated, *checked)
    notes = (*decided.notes, *checked)
    mapping = builder.with_lengths_of_slides(decision.mapping)
    return Made(recording, mapping, decision.fits, notes, clocks, checked)


def _decide_clocks(found, mapping, candidates, options, progress) -> ClockDecision | None:
    """The offset between the clocks of two tables; None where they are not joined by time."""
    if found.timed is None:
        if isinstance(options.time_offset, float):
            raise InputError(
                f"--time-offset {options.time_offset:g}: expected two tables that are joined by their times, found "
                f"{found.table.file}; remove the option."
            )
        return None
    progress("comparing the clocks on the robot")
    stated = options.time_offset is not None or options.mapping.join.time_offset_s is not None
    robots = [(keys, load_robot(keys, title)) for title, keys in candidates.items()]
    return decide_offset(found.timed, robots, mapping, options, stated)


def _decide(builder: Builder, mapping: Mapping, options, progress) -> decisions.Decision:
    """Units and rotation convention. Raises InputError where the data do not decide and nobody can be asked."""
    progress("testing units on the robot")
    robot, table = builder.robot, builder.table
    case = decisions.UnitCase(
        robot, mapping, builder.positions, table.file, options.ask, options.trust_data
    )
    try:
        with limited(_SEARCH_S, _searching(progress, "looking for the cause of the misfit")):
            decision = decisions.decide_units(case, lambda: refuse_shifted_rows(builder, mapping))
    except InputError:
        with _cut_short(progress, "looking for a unit that changes at a row"):
            refuse_changed_units(builder, mapping, None)
        if options.mapping.measures is None:
            _refuse_other_kind(robot, mapping, builder, None)
        raise
    fits = decision.fits
    is_good = bool(fits) and fits[0].is_good
    refuse_changed_units(builder, mapping, decision if is_good else None)
    if options.mapping.measures is None and fits and not is_good:
        _refuse_other_kind(robot, mapping, builder, fits[0])
    if mapping.rotation is None or mapping.measures != "external-pose":
        return decision
    progress("testing rotation conventions on the robot")
    try:
        turned = decide_rotation(
            robot, decision.mapping, table, builder.complete, options.ask, is_good
        )
    except InputError as problem:
        refuse_changed_rotation(builder, decision.mapping, None)
        if isinstance(problem, decisions.NoReadingFits):
            with _cut_short(progress, "looking for the cause of the misfit"):
                refuse_rotation_mistake(
                    robot, decision.mapping, table, builder.complete, options.name
                )
        raise
    refuse_changed_rotation(builder, decision.mapping, turned)
    return replace(turned, assumed=decision.assumed)


def _searching(progress, label: str):
    """A function that reports how long a search lasts."""
    return lambda elapsed: progress(f"{label} ({elapsed})")


@contextmanager
def _cut_short(progress, label: str):
    """A search inside ends without a result after `_SEARCH_S`."""
    progress(label)
    try:
        with limited(_SEARCH_S, _searching(progress, label)):
            yield
    except OutOfTime:
        pass


def _candidates(named: str, table: RawTable, mapping: Mapping) -> dict[str, Keys]:
    """Title and keys of every robot that the name may mean. Raises InputError where the joints do not match."""
    candidates = robot_candidates(named, table.file)
    for title, keys in candidates.items():
        called = f"--robot {named}" if len(candidates) == 1 else title
        robot = load_robot(keys, called)
        _check_count(robot, mapping, table)
        _check_units(robot, mapping, table)
        refuse_wrong_slides(table, mapping, robot, sliding(robot))
    return candidates


def _robot_of(candidates: dict[str, Keys], table: RawTable, mapping: Mapping, options, progress):
    """Keys of the robot that fits, and a sentence where the data decided the convention of its table."""
    if len(candidates) == 1:
        return next(iter(candidates.values())), ()

    def builder_of(title: str) -> Builder:
        return Builder(table, candidates[title], load_robot(candidates[title], title), options)

    def build_with(title: str):
        builder = builder_of(title)
        return builder.robot, builder.positions

    def refuse_changes(title: str):
        builder = builder_of(title)
        with _cut_short(progress, "looking for rows that are read in another way"):
            refuse_shifted_rows(builder, mapping)
            refuse_changed_units(builder, mapping, None)

    case = robot_decision.ConventionCase(
        mapping,
        build_with,
        list(candidates),
        table.file,
        refuse_changes,
        options.ask,
        options.trust_data,
    )
    chosen, sentence = robot_decision.decide_convention(case)
    return candidates[chosen], (sentence,)


def _refuse_other_kind(
    robot, mapping: Mapping, builder: Builder, found: CandidateFit | None
) -> None:
    """Raise InputError where points fit in the frame of the other side: a sensor on the flange or an instrument.

    found: fit as they are mapped; None where no reading of them fits.
    """
    if mapping.measures not in _OTHER_KIND:
        return
    other = _OTHER_KIND[mapping.measures]
    readings = [
        (title, replace(interpretation, measures=other, rotation=None))
        for title, interpretation in decisions.unit_readings(mapping)
    ]
    best = decisions.compare(robot, readings, builder.complete)
    if best and best[0][1].is_good:
        raise InputError(
            f"{builder.table.file}: expected points of kind {mapping.measures}, which "
            f"{'do not fit' if found is None else f'fit with {found.rms_mm:.3g} mm'}, found that they fit as {other} "
            f"({best[0][1].words}); add "
            f'measures = "{other}" to a mapping file and name it with --map.'
        )


def _robot_that_fits(table: RawTable, mapping: Mapping, options) -> str:
    """The built-in robot that fits clearly best. Raises InputError as `robot_decision.decide_robot`."""

    def build_with(name: str):
        robot = load_robot(name)
        return robot, Builder(table, {"builtin": name}, robot, options).positions

    count = len(mapping.joints.columns)
    known = {name: load_robot(name) for name in builtin_robots()}
    names = [name for name, robot in known.items() if robot.mixing.shape[1] == count]
    if not names:
        robot_keys(None, table.file)
    wrong = [_wrong_unit(known[name], mapping) for name in names]
    if all(wrong):
        column, word = wrong[0]
        raise InputError(
            f"{table.file}, column {column}: expected an angle, as the built-in robots of {count} joints have rotating "
            f"joints, found the unit {word}; correct the header, or name the file of the robot with --robot."
        )
    names = [name for name, mistake in zip(names, wrong) if not mistake]
    return robot_decision.decide_robot(mapping, build_with, names, table.file, options.ask)


def _check_count(robot, mapping: Mapping, table: RawTable) -> None:
    wanted = robot.mixing.shape[1]
    if len(mapping.joints.columns) != wanted:
        columns = ", ".join(f'"{name}"' for name in _proposed_columns(robot, mapping, table))
        is_table = mapping.robot is not None and is_dh_table(Path(mapping.robot))
        hint = _FIXED_ROWS if is_table else ""
        raise InputError(
            f"{table.file}: expected {wanted} joint columns for '{robot.name}', found "
            f"{len(mapping.joints.columns)} ({', '.join(mapping.joints.columns)}); add [joints] columns = [{columns}] "
            f"to a mapping file and name it with --map, or name another robot.{hint}"
        )


def _proposed_columns(robot, mapping: Mapping, table: RawTable) -> list[str]:
    """A column for each reading, "?" where none is known: a sliding joint has a length that nothing else reads."""
    slides = sliding(robot)
    known = list(mapping.joints.columns)
    if len(known) != int((~slides).sum()):
        return (known + ["?"] * len(slides))[: len(slides)]
    units = {name: read_header(name).unit for name in table.columns if not is_mapped(mapping, name)}
    lengths = [name for name, unit in units.items() if unit in LENGTHS]
    if len(lengths) != int(slides.sum()):
        lengths = ["?"] * int(slides.sum())
    return [(lengths if slide else known).pop(0) for slide in slides]


def _missing(table: RawTable, mapping: Mapping) -> list[str]:
    """Sentences on joint readings and measurement as far as neither headers nor mapping name them."""
    missing = []
    if mapping.joints is None:
        missing.append(text_sentence(table) or _without_joints(table, mapping))
    measures = mapping.measures
    if measures is None or measures not in KINDS or KINDS[measures].images:
        missing.append(text_sentence(table) or _without_measurement(table, mapping))
    return list(dict.fromkeys(missing))


def _without_joints(table: RawTable, mapping: Mapping) -> str:
    shown = ", ".join(list(table.columns)[:16])
    if mapping.flange_point is not None and mapping.point is not None:
        return (
            f"{table.file}: expected joint readings, which a calibration of the robot needs, found poses of the flange "
            f"({', '.join(mapping.flange_point.columns)}) only; export the joint angles of the same rows too. "
            "`workbench handeye` needs none, but one transform that connects flange poses and measurements."
        )
    return (
        f"{table.file}: expected columns with joint readings such as J1 ... J6, found {shown}; add [joints] columns = "
        '["...", ...] to a mapping file and name it with --map, or name the file with the joint log as well.'
    )


def _without_measurement(table: RawTable, mapping: Mapping) -> str:
    lengths = [name for name, target in mapping.columns.items() if target == "length_mm"]
    if lengths:
        return (
            f"{table.file}: expected each length (column {lengths[0]}) in two rows, with the joint readings at its two "
            'ends and with one number in a column pair, as measures = "distance" has them, found no such column; write '
            "the table so, or add [point] columns if it also has measured points."
        )
    read = () if mapping.joints is None else mapping.joints.columns
    shown = ", ".join([name for name in table.columns if name not in read][:16])
    return (
        f"{table.file}: expected columns with a measured point such as X, Y, Z, found "
        f"{shown or 'joint readings only'}; "
        'add [point] columns = ["...", "...", "..."] (or measures = "touch-point", "plane-touch", ...) to a mapping '
        "file and name it with --map, or name the file of the instrument as well."
    )


def _check_units(robot, mapping: Mapping, table: RawTable) -> None:
    """Raise InputError where a rotating joint has a length as its unit, and others have none."""
    found = _wrong_unit(robot, mapping)
    if found is not None:
        name, word = found
        raise InputError(
            f"{table.file}, column {name}: expected an angle of a rotating joint of '{robot.name}', found the "
            f"unit {word}; correct the header, or state the units under [joints] in a mapping file for --map."
        )


def _wrong_unit(robot, mapping: Mapping) -> tuple[str, str] | None:
    """Column of a rotating joint and the length that is its unit; None where there is none."""
    unit = mapping.joints.unit
    if not isinstance(unit, tuple):
        return None
    for name, word, is_sliding in zip(mapping.joints.columns, unit, sliding(robot)):
        if word in LENGTHS and not is_sliding:
            return name, word
    return None
