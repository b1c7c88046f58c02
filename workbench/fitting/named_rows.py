"""Rows that the plausibility check names as wrong: a calibration starts from this list and leaves them out."""

from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from robot_model.measurements.ball_scan import FILE_KIND
from robot_model.robot import Robot
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.suspicion import Suspicion

MAX_SHARE = 0.25
"""Share of the rows that may be left out; where more are wrong, the recording as a whole is in doubt."""
_ROUNDS = 3
_LEAST_ROWS = 4
"""Rows of each ball or reflector that remain, so that its place stays determined."""
_TARGETS = ("ball", "reflector")
_LEFT_OUT = "This calibration leaves them out; with --trust-data it keeps them."


@dataclass(frozen=True)
class NamedRows:
    """`suspicions` about the rows that remain, `numbers` of the samples that are left out, and `sentences` on them."""

    suspicions: tuple[Suspicion, ...]
    numbers: tuple[int, ...] = ()
    sentences: tuple[str, ...] = ()


def without_named_rows(robot: Robot, recording: Recording) -> NamedRows:
    """The check of a recording, repeated without the rows that it names.

    Gross rows hide smaller ones. If more than `MAX_SHARE` of the rows would be left out, or all rows of a target,
    none is: `suspicions` are then those of all rows.
    """
    first = found = check_plausibility(robot, recording)
    if recording.measures == FILE_KIND:
        return NamedRows(first)  # rows are points of scans, which are chosen within each scan
    keep = np.ones(recording.n, bool)
    sentences = []
    for _ in range(_ROUNDS):
        named = [suspicion for suspicion in found if suspicion.rows]
        if not named or any(suspicion.certain for suspicion in found):
            break
        rows = np.flatnonzero(keep)[sorted({row for suspicion in named for row in suspicion.rows})]
        keep[rows] = False
        if not _is_enough(recording, keep):
            return NamedRows(first)
        sentences += [f"{suspicion.sentence} {_LEFT_OUT}" for suspicion in named]
        found = check_plausibility(robot, recording.select(keep))
    remaining = tuple(suspicion for suspicion in found if not suspicion.rows)
    if any(suspicion.rows for suspicion in found):
        remaining = found  # rows of a further round stay in, and in doubt
    numbers = tuple(int(number) for number in recording.sample_ids[~keep])
    return NamedRows(remaining, numbers, tuple(sentences))


def _is_enough(recording: Recording, keep: np.ndarray) -> bool:
    """Whether the rows to keep (n,) bool are most of all, and some of each target."""
    if keep.mean() < 1 - MAX_SHARE:
        return False
    for label in _TARGETS:
        for number in np.unique(recording.columns.get(label, [])):
            is_target = recording.columns[label] == number
            if (is_target & keep).sum() < min(_LEAST_ROWS, is_target.sum()):
                return False
    return True
