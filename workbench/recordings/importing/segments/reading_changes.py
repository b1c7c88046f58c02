"""Refusal of a table in which the unit, sign, order or convention of columns changes at a row, with the rows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from datasets.importers.mapping.candidates import ANGLE_WORDS, LENGTH_WORDS, rotation_candidates
from datasets.importers.mapping.columns.column_units import unit_words
from datasets.importers.mapping.model import Mapping
from datasets.importers.units import ANGLES
from datasets.recording import Recording
from datasets.samples.columns import POINT, joint_columns
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import FAILURES, fit_recording, row_mismatch
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.rows.change_points import find_new_setup
from workbench.fitting.plausibility.sampling import even_rows
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.interpretation import decisions
from workbench.recordings.importing.interpretation.orientation_misfits import (
    flange_rotations,
    measured_rotations,
    screened_rotations,
)
from workbench.recordings.importing.segments.row_segments import Segment, find_segments

_FIT_ROWS = 100
_OFF_FACTOR = 3.0
_UNITS = {**ANGLE_WORDS, **LENGTH_WORDS}
_SIGNS = ("one sign", "the opposite sign")
_ORDERS = ("the order of the headers", "exchanged columns")

Words = dict[tuple[str, ...], str]
"""Columns of the user's table -> how they are read, in words."""


@dataclass(frozen=True)
class _Reading:
    """A recording of all rows, and how its columns are read; `usual`: how readings without these words read them."""

    recording: Recording
    words: Words = field(default_factory=dict)
    usual: Words = field(default_factory=dict)


def refuse_changed_units(
    builder: Builder, mapping: Mapping, decided: decisions.Decision | None
) -> None:
    """Raise InputError where the units, signs or order of joint readings or coordinates change at a row.

    decided: the units of all rows; None where none fit, and rows that fit by themselves only are an error, too.
    """
    if decided is not None and not _has_rows_off(builder, builder.positions(decided.mapping)):
        return
    choices = list(decisions.unit_readings(mapping, stated_only=False))
    if decided is not None:
        choices.insert(0, ("as decided", decided.mapping))
    readings = list(_built(choices, builder.positions, _unit_words))
    if not readings:
        return
    variants = _Variants(mapping, readings)
    named = [(str(k), recording.recording) for k, recording in enumerate(readings)]
    segments, _ = find_segments(builder.robot, named, variants.of)
    all_readings = [*readings, *variants.made]
    changed = len({segment.reading for segment in segments}) > 1
    if changed or (segments and decided is None):
        raise InputError(_sentence(builder, segments, all_readings))


def refuse_changed_rotation(
    builder: Builder, mapping: Mapping, decided: decisions.Decision | None
) -> None:
    """Raise InputError where unit or convention of the measured rotation changes at a row.

    mapping: with decided units of joint readings and point. decided: the convention of all rows; None where none fit.
    """
    if decided is not None and not _has_rows_off(builder, builder.complete(decided.mapping)):
        return
    table = builder.table
    turns = rotation_candidates(mapping.rotation, table, stated_only=False)
    turns += _part_turns(builder, mapping, turns)
    interpretations = [(turn.title, replace(mapping, rotation=turn.group)) for turn in turns]
    readings = list(_built(interpretations, builder.complete, _rotation_words))
    if not readings:
        return
    flange = flange_rotations(builder.robot, readings[0].recording)
    matrices = [measured_rotations(interpretation.recording) for interpretation in readings]

    def screen(rows: np.ndarray) -> list[int]:
        return screened_rotations(
            flange[rows], [matrices_of_reading[rows] for matrices_of_reading in matrices]
        )

    named = [(str(k), recording.recording) for k, recording in enumerate(readings)]
    segments, _ = find_segments(builder.robot, named, lambda anchor: (), screen)
    if len({segment.reading for segment in segments}) > 1:
        raise InputError(_sentence(builder, segments, readings))


def reading_words(mapping: Mapping) -> str:
    """Units and rotation convention of a complete mapping in words."""
    words = [f"{_short(names)} in {text}" for names, text in _unit_words(mapping).items()]
    if mapping.rotation is not None and mapping.rotation.convention:
        words += [f"rotation {text}" for text in _rotation_words(mapping).values()]
    return ", ".join(words)


def _has_rows_off(builder: Builder, recording: Recording) -> bool:
    """Whether two neighbouring rows differ from the others by much more than a sound arm does."""
    robot = builder.robot
    try:
        fit = fit_recording(robot, recording.select(even_rows(recording, _FIT_ROWS)))
        is_off = row_mismatch(robot, recording, fit) > _OFF_FACTOR * good_scale(robot, recording)
    except (np.linalg.LinAlgError, InputError, ValueError):
        return False
    return bool((is_off[1:] & is_off[:-1]).any())


def _built(choices, build: Callable, words: Callable) -> Iterator[_Reading]:
    """The readings whose numbers can be what they say."""
    for _, mapping in choices:
        try:
            recording = build(mapping)
        except InputError:
            continue
        yield _Reading(recording, words(mapping))


def _unit_words(mapping: Mapping) -> Words:
    if mapping.point is None:
        groups = [mapping.joints]
    else:
        groups = [mapping.joints, mapping.point]
    return {group.columns: unit_words(group.unit, group.columns, _UNITS.get) for group in groups}


def _rotation_words(mapping: Mapping) -> Words:
    group = mapping.rotation
    unit = f" in {unit_words(group.unit, group.columns, _UNITS.get)}" if group.unit else ""
    inverse = ", inverse" if group.inverse else ""
    return {tuple(sorted(group.columns)): f"{group.convention}{unit}{inverse}"}


class _Variants:
    """Single columns of the reading of an anchor in another unit, sign or order; `made` after a call of `of`."""

    def __init__(self, mapping: Mapping, readings: Sequence[_Reading]):
        self.mapping, self.readings = mapping, readings
        self.made: list[_Reading] = []

    def of(self, anchor: int) -> list[Recording]:
        """The recordings of all variants of the reading with this index."""
        base = self.readings[anchor]
        self.made = [*self._of_joints(base), *self._of_point(base)]
        return [interpretation.recording for interpretation in self.made]

    def _of_joints(self, base: _Reading) -> Iterator[_Reading]:
        columns = base.recording.columns
        names = joint_columns(columns)
        headers = self.mapping.joints.columns
        for name, header in zip(names, headers):
            cells = columns[name]
            yield _changed(base, {name: -cells}, (header,), _SIGNS)
            if not name.endswith("_deg"):
                continue
            for before, after in (("deg", "rad"), ("rad", "deg")):
                scaled = ANGLES[after] / ANGLES[before] * cells
                words = (ANGLE_WORDS[before], ANGLE_WORDS[after])
                yield _changed(base, {name: scaled}, (header,), words)

    def _of_point(self, base: _Reading) -> Iterator[_Reading]:
        columns, group = base.recording.columns, self.mapping.point
        if group is None or not set(POINT) <= set(columns):
            return
        headers = dict(zip(POINT, group.columns))
        for name in POINT:
            yield _changed(base, {name: -columns[name]}, (headers[name],), _SIGNS)
        for first_axis, two in combinations(POINT, 2):
            exchanged = {first_axis: columns[two], two: columns[first_axis]}
            yield _changed(base, exchanged, (headers[first_axis], headers[two]), _ORDERS)


def _changed(base: _Reading, columns: dict, headers: tuple[str, ...], words) -> _Reading:
    """A variant of a reading; words: how the columns are read without and with the change."""
    recording = replace(base.recording, columns={**base.recording.columns, **columns})
    return _Reading(recording, {**base.words, headers: words[1]}, {headers: words[0]})


def _part_turns(builder: Builder, mapping: Mapping, known) -> list:
    """Readings of rotations that are distinguishable in a part of the rows only."""
    seen = {turn.group for turn in known}
    found = []
    rows = np.arange(builder.table.n)
    for half in np.array_split(rows, 2):
        half_table = builder.table.take(half)
        for turn in rotation_candidates(mapping.rotation, half_table, stated_only=False):
            if turn.group not in seen:
                seen.add(turn.group)
                found.append(turn)
    return found


def _sentence(builder: Builder, segments: Sequence[Segment], readings: Sequence[_Reading]) -> str:
    """Finding, its rows, and what to do."""
    table = builder.table
    chosen = [readings[segment.reading] for segment in segments]
    usual = {
        key: text for reading_of_segment in chosen for key, text in reading_of_segment.usual.items()
    }
    used = [{**usual, **reading_of_segment.words} for reading_of_segment in chosen]
    keys = list(dict.fromkeys(key for words in used for key in words))
    differing = [key for key in keys if len({words.get(key) for words in used}) > 1]
    if not differing:
        moved = _moved_object(builder.robot, chosen[0].recording) if len(segments) == 2 else ""
        return _set_up_sentence(table.file, _row_ranges(table, segments), moved)
    found = []
    for words, rows in zip(used, _row_ranges(table, segments)):
        found.append(f"{_described(words, differing)} in {rows}")
    names = ", ".join(dict.fromkeys(name for key in differing for name in key))
    moved = len({segment.anchor for segment in segments}) > 1
    setup_note = " (after the instrument, the base or the target was set up again)" if moved else ""
    return (
        f"{table.file}, columns {names}: expected one unit and convention in all rows, found "
        f"{_listed(found)}, with which the robot fits{setup_note}; convert one of the parts, or import each as a "
        "table of its own, which tests the units of each table."
    )


def _moved_object(robot, recording: Recording) -> str:
    """What explains best that two parts fit separately only: base, target or the zero of a joint; "" if unknown."""
    try:
        change = find_new_setup(robot, recording, good_scale(robot, recording))
    except FAILURES:
        return ""
    return "" if change is None else change.moved_object


def _set_up_sentence(file: str, ranges: Sequence[str], moved: str) -> str:
    """moved: the object that explains it best, "" if unknown."""
    if moved:
        cause = f"{moved} has moved between them"
    else:
        cause = "the instrument, the base or the target was set up again between them"
    return (
        f"{file}: expected measurements in one frame, found that {_listed(ranges)} fit the robot each by itself, but "
        f"not together: {cause}; import each as a "
        "recording of its own, calibrate one, and test it on the other with `workbench evaluate --refit "
        "base-and-tool`."
    )


def _row_ranges(table, segments: Sequence[Segment]) -> list[str]:
    """In words: "rows 2 to 31", or "rows 2 to 31 of monday.csv" where the table is made of several."""
    ranges = []
    for segment in segments:
        first, _, file = str(table.lines[segment.first]).partition(" of ")
        last, _, other = str(table.lines[segment.last]).partition(" of ")
        start = f"{first} of {file}" if file != other else first
        end = f"{last} of {other}" if other else last
        ranges.append(f"rows {start} to {end}")
    return ranges


def _described(words: Words, differing: Sequence[tuple[str, ...]]) -> str:
    """Interpretation of the differing columns; with their names where several groups of columns differ."""
    if len(differing) == 1:
        return words[differing[0]]
    return " and ".join(f"{_short(key)} in {words[key]}" for key in differing)


def _short(names: Sequence[str]) -> str:
    if len(names) <= 3:
        return ", ".join(names)
    return f"{names[0]} ... {names[-1]}"


def _listed(words: Sequence[str]) -> str:
    if len(words) > 1:
        return f"{', '.join(words[:-1])} and {words[-1]}"
    return words[0]
