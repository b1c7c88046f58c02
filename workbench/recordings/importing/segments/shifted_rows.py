"""Refusal of a table in which measurements and joint readings are shifted against each other from some row on.

A part of the rows fits the robot as it stands (an anchor, `row_segments`); the others fit its base, tool and geometry
with the measurement of a neighbouring row. Every row may be the one where the shift begins.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.model import Mapping
from datasets.recording import Recording
from workbench.core.errors import InputError
from workbench.fitting.plausibility.hypotheses.corrections import LABELS, observed_columns
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.interpretation import decisions
from workbench.recordings.importing.segments.row_segments import Segment, find_segments

_STEPS = (1, -1, 2, -2)


def refuse_shifted_rows(builder: Builder, mapping: Mapping) -> None:
    """Raise InputError where a part of the rows fits the robot and the rest does with shifted measurements."""
    readings = []
    for title, interpretation in decisions.unit_readings(mapping):
        try:
            readings.append((title, builder.positions(interpretation)))
        except InputError:
            continue
    if not readings or not observed_columns(readings[0][1]):
        return
    steps: list[int] = []

    def variants(anchor: int) -> list[Recording]:
        shifted = list(_shifted(readings[anchor][1]))
        steps.extend(step for step, _ in shifted)
        return [recording for _, recording in shifted]

    segments, _ = find_segments(builder.robot, readings, variants)
    shifts = [_step_of(segment, len(readings), steps) for segment in segments]
    if len(set(shifts)) > 1:
        raise InputError(_sentence(builder, mapping, segments, shifts))


def _step_of(segment: Segment, count: int, steps: Sequence[int]) -> int:
    """Rows by which the measurements of a segment are late, 0 as they stand; count: of readings without a shift."""
    if segment.reading >= count:
        return steps[segment.reading - count]
    return 0


def _shifted(recording: Recording) -> Iterator[tuple[int, Recording]]:
    """Step, and the recording with the measurements of `step` rows below, with and without their labels."""
    names = observed_columns(recording)
    bare = [name for name in names if name not in LABELS]
    rows = np.arange(recording.n)
    for step in _STEPS:
        source = np.clip(rows + step, 0, recording.n - 1)
        for moved in [names, bare] if len(bare) < len(names) else [names]:
            columns = {c: v[source] if c in moved else v for c, v in recording.columns.items()}
            yield step, replace(recording, columns=columns)


def _sentence(builder: Builder, mapping: Mapping, segments, shifts: Sequence[int]) -> str:
    """The rows that are shifted, the columns, and what is missing or doubled where the shift begins."""
    lines = builder.table.lines
    segments = _without_unmatched(segments, shifts)
    found = []
    for segment, step in zip(segments, shifts):
        rows = f"rows {lines[segment.first]} to {lines[segment.last]}"
        where = f"{abs(step)} row{'s' * (abs(step) > 1)} {'below' if step > 0 else 'above'}"
        found.append(f"{rows} fit " + (f"with the measurement {where}" if step else "as they are"))
    place = next(k for k in range(1, len(shifts)) if shifts[k] != shifts[k - 1])
    joints, point = (_named(group.columns) for group in (mapping.joints, mapping.point))
    is_late = shifts[place] > shifts[place - 1]
    missing, doubled = (joints, point) if is_late else (point, joints)
    return (
        f"{builder.table.file}: expected joint readings and measurement of one moment in each row, found that "
        f"{', '.join(found)}. From row {lines[segments[place].first]} on the columns {point} are "
        f"{'late' if is_late else 'early'} against {joints}: cells of {missing} are missing there, or cells of "
        f"{doubled} are one too many; move the columns of one part, or remove the row."
    )


def _without_unmatched(segments: Sequence[Segment], shifts: Sequence[int]) -> list[Segment]:
    """The segments with rows that fit neither side of a missing measurement in the later one.

    They fit no reading, and `find_segments` counts them with the rows that fit as they stand.
    """
    corrected = list(segments)
    for k in range(1, len(corrected)):
        unmatched = shifts[k - 1] - shifts[k]
        if unmatched > 0 and shifts[k - 1] == 0:
            first = corrected[k].first - unmatched
            corrected[k - 1], corrected[k] = (
                replace(corrected[k - 1], last=first - 1),
                replace(corrected[k], first=first),
            )
    return corrected


def _named(columns: Sequence[str]) -> str:
    return f"'{columns[0]}' to '{columns[-1]}'"
