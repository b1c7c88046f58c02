"""The last check of an import: does the recording fit its robot at all, and if not, which mistake explains it?"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.samples.duplicates import first_of_equal_rows
from datasets.trust import accepted_by_option, naming_option
from robot_model.measurements import samples_of
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.robot_files.far_geometry import (
    CAUSE,
    OTHER_ROBOT,
    find_far_geometry,
)
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.fitting.plausibility.wording import listed
from workbench.recordings.importing.interpretation.decisions import ROTATION_REMEDY
from workbench.recordings.importing.interpretation.fits import CandidateFit, compare_readings

LARGE_ERRORS = "with large errors only"
"""Of a recording that is accepted with a misfit that an accurate arm does not have."""
_SHIFTED = "rows-shifted"
_NAMED_ROWS = 12
_NO_MISTAKE_OF_ALL_ROWS = (
    "unexplained",
    "blunders",
    "sigma",
    "payload",
    "temperature",
    "time",
    "few-poses",
)
"""Causes of suspicions that say nothing against columns, order of rows or robot."""


def check_fit(
    robot: Robot, recording, fits: Sequence[CandidateFit], trust_data: bool, lines: np.ndarray
) -> tuple[str, ...]:
    """Sentences on what is unusual. Raises InputError where the recording does not fit its robot.

    fits: of the readings that were compared, empty where nothing had to be decided. trust_data: a misfit is a warning.
    lines (n,): row of the user's table that each sample was read from.
    """
    full_recording, recording = recording, samples_of(recording)
    # the two rows of a length are one sample
    place = {sample: row for row, sample in enumerate(full_recording.sample_ids.tolist())}
    of_sample = lines[[place[sample] for sample in recording.sample_ids.tolist()]]
    best = fits[0] if fits else None
    if best is None:
        compared = compare_readings(robot, [("as mapped", recording)])
        best = compared[0][1] if compared else None
    if best is not None and best.is_good:
        far_sentence = _far_geometry(robot, recording, trust_data)
        rows = _implausible_rows(robot, recording, of_sample, trust_data)
        return (*far_sentence, *rows, *_copied_rows(full_recording, lines))
    found = check_plausibility(robot, recording)
    if found and all(suspicion.robot_keys for suspicion in found):
        return tuple(suspicion.sentence for suspicion in found)
    if best is not None and best.explains:
        others = [finding for finding in found if finding.cause not in _NO_MISTAKE_OF_ALL_ROWS]
        if not others:
            rows = [_with_lines(s, recording, of_sample) for s in found if s.cause != "unexplained"]
            return (
                _large_errors(robot, recording, best),
                *rows,
                *_copied_rows(full_recording, lines),
            )
    if not any(suspicion.certain for suspicion in found):
        rotations = _wrong_rotations(robot, recording)
        if rotations and not trust_data:
            raise InputError(naming_option(rotations))
        if rotations:
            return (accepted_by_option(rotations),)
    sentence = _with_share(found[0], best) if found else _sentence(robot, best)
    if best is None and not found:
        return (sentence,)
    if not trust_data:
        raise InputError(naming_option(sentence))
    return (accepted_by_option(sentence),)


def _implausible_rows(
    robot: Robot, recording, lines: np.ndarray, trust_data: bool
) -> tuple[str, ...]:
    """Sentences on what `check_plausibility` finds in a recording most of whose rows fit, with the user's rows.

    Raises InputError where rows hold the measurements of their neighbours: whole poses are then wrong, and no row alone
    is a blunder. trust_data: that is a warning, too.
    """
    found = check_plausibility(robot, recording)
    shifted = [finding for finding in found if finding.cause == _SHIFTED]
    if shifted and not trust_data:
        raise InputError(naming_option(_with_lines(shifted[0], recording, lines)))
    return tuple(
        _with_lines(suspicion, recording, lines)
        for suspicion in found
        if suspicion.cause not in (CAUSE, OTHER_ROBOT)
    )


def _copied_rows(recording, lines: np.ndarray) -> tuple[str, ...]:
    """A sentence on rows that are exact copies of earlier ones, with the user's rows; () without any."""
    first = first_of_equal_rows(recording)
    copies = np.flatnonzero(first != np.arange(recording.n))
    if not copies.size:
        return ()
    # a row of the table with several reflectors makes several samples
    pairs = list(dict.fromkeys(f"{lines[row]} = {lines[first[row]]}" for row in copies))
    if len(pairs) > _NAMED_ROWS:
        unlisted = f" and {len(pairs) - _NAMED_ROWS} more"
    else:
        unlisted = ""
    statement = (
        "1 row is an exact copy" if len(pairs) == 1 else f"{len(pairs)} rows are exact copies"
    )
    named = ", ".join(pairs[:_NAMED_ROWS])
    return (
        f"{statement} of an earlier row in joint readings and measured values (row {named}{unlisted}). A copy is no "
        "further measurement and is counted once by calibrate. Remove these rows, or export the measurements again "
        "if they were repeated.",
    )


def _with_lines(suspicion: Suspicion, recording, lines: np.ndarray) -> str:
    """The sentence of a suspicion, and the rows of the table that hold the samples where numbers differ."""
    rows = np.array(suspicion.rows, int)
    if not len(rows) or (lines[rows] == recording.sample_ids[rows]).all():
        return suspicion.sentence
    # a row of the table with several reflectors makes several samples
    named = list(dict.fromkeys(lines[rows].astype(str).tolist()))
    if len(named) > _NAMED_ROWS:
        unlisted = [f"{len(named) - _NAMED_ROWS} more"]
    else:
        unlisted = []
    noun = "rows" if len(named) > 1 else "row"
    words = [*named[:_NAMED_ROWS], *unlisted]
    return f"{suspicion.sentence} In the file: {noun} {listed(words)}."


def _with_share(suspicion: Suspicion, best: CandidateFit | None) -> str:
    """The sentence of a suspicion; of a misfit that nothing explains, with the limit."""
    if best is None or suspicion.cause != "unexplained" or not best.share_words:
        return suspicion.sentence
    return f"{suspicion.sentence.removesuffix('.')}. The misfit is {best.share_words.removeprefix(', ')}."


def _sentence(robot: Robot, best: CandidateFit | None) -> str:
    if best is None:
        return (
            "The rows are too few to test units and conventions on the robot; compare the mapping with the files "
            "before you use the result."
        )
    return (
        f"The recording does not fit '{robot.name}' under any reading of its columns (best {best.words}"
        f"{best.share_words}); check that the robot is the right one, that joint and measured rows belong together, "
        "and the mapping."
    )


def _large_errors(robot: Robot, recording, best: CandidateFit) -> str:
    """What a misfit means that is larger than that of an accurate arm, and far below the scatter of the points."""
    return (
        f"The recording fits '{robot.name}' {LARGE_ERRORS} ({best.words}, {100 * best.share:.2g} % of the "
        f"scatter of the measured points; {good_scale(robot, recording):.2g} mm or less are usual). No mistake was "
        "found that explains them: the arm or the instrument may be this inaccurate. Check the robot file with its "
        "zero offsets, and that each row holds joints and measurement of one moment; a calibration says how much "
        "remains on poses that it was not fitted to."
    )


def _wrong_rotations(robot: Robot, recording) -> str:
    """A sentence where the positions of measured poses fit the robot, but not their rotations; "" otherwise."""
    if recording.measures != "external-pose":
        return ""
    positions = replace(recording, measures="external-point")
    compared = compare_readings(robot, [("positions", positions)])
    if not compared or not compared[0][1].is_good:
        return ""
    return (
        f"The positions fit '{robot.name}' to {compared[0][1].rms_mm:.2g} mm without the rotations, and not together "
        f"with them: {ROTATION_REMEDY}."
    )


def _far_geometry(robot: Robot, recording, trust_data: bool) -> tuple[str, ...]:
    """A sentence where lengths are far from nominal. Raises InputError where another robot of the library fits.

    trust_data: keep the robot that is named all the same.
    """
    found = find_far_geometry(robot, recording)
    if found is None:
        return ()
    if found.other is None:
        return (found.verdict,)
    if not trust_data:
        raise InputError(naming_option(found.verdict))
    return (accepted_by_option(found.verdict),)
