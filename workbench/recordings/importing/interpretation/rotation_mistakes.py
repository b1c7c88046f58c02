"""The mistake in joint readings or robot file that explains why no convention of the measured rotations fits.

The angle of the rotation between two rows depends neither on base nor tool. It is compared under every pair of a
convention and a correction, and the pairs that agree best are fitted with plausible geometry errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.candidates import RotationConvention, rotation_candidates
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.recording import Recording
from datasets.samples.columns import QUATERNION
from datasets.trust import naming_option
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import FAILURES, nominal_scales
from workbench.fitting.plausibility.hypotheses.corrections import Correction
from workbench.fitting.plausibility.hypotheses.coupling_corrections import coupling_corrections
from workbench.fitting.plausibility.hypotheses.joint_corrections import (
    joint_corrections,
    sign_vectors,
)
from workbench.fitting.plausibility.hypotheses.point_corrections import point_corrections
from workbench.fitting.plausibility.hypotheses.robot_corrections import robot_corrections
from workbench.fitting.plausibility.sampling import even_rows
from workbench.recordings.importing.interpretation.decisions import Build
from workbench.recordings.importing.interpretation.fits import CandidateFit, compare_readings
from workbench.recordings.importing.interpretation.orientation_misfits import (
    flange_rotations,
    least_misfits,
    rotation_misfits,
)

_AGREES_RAD = np.deg2rad(2.0)
"""More than geometry errors of an arm change the angle between two rows, RMS."""
_SCREENED, _SCREEN_ROWS, _FITTED = 400, 50, 8


@dataclass(frozen=True)
class _Explanation:
    """A correction under which the rotations fit under a convention, and that fit."""

    correction: Correction
    fit: CandidateFit

    @property
    def is_of_robot(self) -> bool:
        """Whether the robot file is said to be wrong, which is rarer than a wrong column."""
        return self.correction.subject.startswith("robot file")


def refuse_rotation_mistake(
    robot: Robot, mapping: Mapping, table: RawTable, build: Build, called: str
) -> None:
    """Raise InputError with the mistake that explains why no convention fits; nothing is found where none does.

    mapping: with decided units. build: makes the recording of a complete mapping. called: the recording, for the
    sentence.
    """
    turns = rotation_candidates(mapping.rotation, table)
    if not turns:
        return
    matrices = [convention.matrices(table) for convention in turns]
    found = list(_explanations(robot, mapping, turns, matrices, build))
    if found:
        raise InputError(naming_option(_sentence(_simplest(found), called)))


def _simplest(found: Sequence[_Explanation]) -> list[_Explanation]:
    """The explanations with the fewest mistakes that the data do not decide between, columns before the robot file."""
    fewest = min(explanation.correction.mistake_count for explanation in found)
    simple = [e for e in found if e.correction.mistake_count == fewest]
    best = min(simple, key=lambda explanation: explanation.fit.improbability)
    close = [e for e in simple if not best.fit.clearly_beats(e.fit)]
    return sorted(close, key=lambda explanation: explanation.is_of_robot)


def _explanations(
    robot: Robot,
    mapping: Mapping,
    turns: Sequence[RotationConvention],
    matrices: Sequence[np.ndarray],
    build: Build,
) -> Iterator[_Explanation]:
    """The pairs of a correction and a convention that fit, of those whose angles between rows agree best."""
    recordings = [build(replace(mapping, rotation=turn.group)) for turn in turns]
    corrections, misfits = [], []
    for correction in _corrections(robot, recordings[0]):
        try:
            flange = flange_rotations(*correction.apply(robot, recordings[0]))
        except FAILURES:
            continue
        corrections.append(correction)
        misfits.append(rotation_misfits(flange, matrices))
    if not misfits or np.min(misfits) > _AGREES_RAD:
        return
    places = least_misfits(np.ravel(misfits), _SCREENED)
    pairs = [(corrections[k // len(turns)], k % len(turns)) for k in places]
    for correction, place in _screened(robot, recordings, pairs):
        arm, corrected = correction.apply(robot, recordings[place])
        fits = compare_readings(arm, [(turns[place].title, corrected)], is_good_only=True)
        if fits and fits[0][1].is_good and np.deg2rad(fits[0][1].rms_deg) < _AGREES_RAD:
            yield _Explanation(correction, fits[0][1])


def _screened(
    robot: Robot, recordings: Sequence[Recording], pairs: Sequence[tuple[Correction, int]]
) -> list[tuple[Correction, int]]:
    """The pairs under which base and tool alone leave least.

    Angles between rows are the same under conventions that name the axes in a cycle, and whatever the positions.
    """
    rows = even_rows(recordings[0], _SCREEN_ROWS)
    selections = [recording.select(rows) for recording in recordings]
    scales = nominal_scales(
        [correction.apply(robot, selections[place]) for correction, place in pairs]
    )
    return [pairs[k] for k in np.argsort(scales, kind="stable")[:_FITTED]]


def _corrections(robot: Robot, recording) -> Iterator[Correction]:
    """The single mistakes in joint readings, robot file and positions, and several reversed joints."""
    yield from joint_corrections(robot, recording)
    yield from sign_vectors(recording)
    yield from coupling_corrections(robot)
    yield from robot_corrections(robot)
    # conventions of the rotation are among the readings
    yield from (c for c in point_corrections(recording) if not c.touches & set(QUATERNION))


def _sentence(explanations: Sequence[_Explanation], called: str) -> str:
    """The first explanation, and another one that the data do not decide against."""
    first = explanations[0]
    claims = [e.correction.claim for e in explanations if e.correction != first.correction]
    as_well = f" (equally well explained: {claims[0]})" if claims else ""
    file = "" if first.is_of_robot else "samples.csv of "
    return (
        f"{file}recording '{called}', {first.correction.subject}: expected measurements that belong to the joint "
        f"readings, found that no rotation convention fits as recorded, but that {first.fit.words} fit if "
        f"{first.correction.claim}{as_well}; {first.correction.remedy}."
    )
