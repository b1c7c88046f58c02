"""Groups of rows that fit under a correction of whole columns: files with different conventions were joined."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from datasets.samples.columns import POINT
from workbench.fitting.plausibility.fitting import FAILURES, Fit, row_mismatch
from workbench.fitting.plausibility.hypotheses.corrections import (
    Correction,
    column_correction,
    has_orientation,
    join,
)
from workbench.fitting.plausibility.hypotheses.coupling_corrections import coupling_corrections
from workbench.fitting.plausibility.hypotheses.joint_corrections import joint_corrections
from workbench.fitting.plausibility.hypotheses.point_corrections import pose_corrections
from workbench.fitting.plausibility.rows.row_groups import MIN_SHARE, Reason

LEAST_ROWS = 3
"""Rows of a group with a mistake in common."""
_CLOSE = 1.5
_NAMED = 8
_LABELS = ("ball", "reflector")
_MIRRORED = {"x_mm": ("qy", "qz"), "y_mm": ("qx", "qz"), "z_mm": ("qx", "qy")}
"""Components of a quaternion that change sign with a coordinate if the frame is mirrored."""


def corrected_columns(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The rows fit under the correction of one or two columns, or of poses.

    rows: numbers of the outlying rows. limit: mismatch in mm below which a row fits.
    """
    if len(rows) < LEAST_ROWS:
        return None
    selection = RowsWithTargets.of(recording, rows)
    fitting = [
        (correction, float(np.median(mismatch)))
        for correction in _corrections(robot, selection.recording)
        if (mismatch := selection.mismatch(robot, correction, fit)) is not None
        and (mismatch < limit).mean() > MIN_SHARE
    ]
    if not fitting:
        return None
    largest_size = max(_CLOSE * min(size for _, size in fitting), limit / 2)
    best = min(
        (pair for pair in fitting if pair[1] <= largest_size),
        key=lambda pair: pair[0].mistake_count,
    )[0]
    return Reason(
        f"they fit if in them {best.claim}: files with different conventions were joined",
        best.cause,
    )


@dataclass(frozen=True)
class RowsWithTargets:
    """Some rows of a recording, and one row of every other target, for a fit has the parameters of every target.

    `is_asked` (n,): True for the rows that are asked for.
    """

    recording: object
    is_asked: np.ndarray

    @classmethod
    def of(cls, recording, rows) -> "RowsWithTargets":
        """rows: numbers of the rows that are asked for."""
        firsts = [
            np.unique(recording.columns[name], return_index=True)[1]
            for name in _LABELS
            if name in recording.columns
        ]
        chosen = np.union1d(rows, np.concatenate([np.zeros(0, int), *firsts])).astype(int)
        return cls(recording.select(chosen), np.isin(chosen, rows))

    def mismatch(self, robot, correction: Correction, fit: Fit) -> np.ndarray | None:
        """(k,) mm of the rows that are asked for, under a correction and the values of a fit; None where it fails."""
        try:
            arm, corrected = correction.apply(robot, self.recording)
            return row_mismatch(arm, corrected, fit)[self.is_asked]
        except FAILURES:
            return None


def _corrections(robot, recording) -> Iterator[Correction]:
    """Single corrections of columns, and the zeros of two joints."""
    of_joints = list(joint_corrections(robot, recording))
    yield from of_joints
    yield from _offset_pairs(robot, recording, of_joints)
    yield from coupling_corrections(robot)
    if has_orientation(recording):
        yield from pose_corrections()
    yield from _mirrored_frames(recording)


def _offset_pairs(robot, recording, singles) -> Iterator[Correction]:
    """The zeros of two joints: where the links of an arm point at zero is a matter of its maker."""
    offsets = [correction for correction in singles if correction.cause == "joint-offset"]
    for first, second in combinations(offsets, 2):
        if not first.touches & second.touches:
            yield join([first, second])


def _mirrored_frames(recording) -> Iterator[Correction]:
    """Positions, with their orientation where it is measured, in a frame with one axis reversed."""
    if not has_orientation(recording):
        return  # of points alone the sign of a coordinate is all
    for name, components in _MIRRORED.items():
        names = (name, *components)
        yield column_correction(
            "left-handed",
            f"the measurements in columns {', '.join(POINT)} with their orientation",
            f"are in a left-handed frame, mirrored in {name}",
            f"negate {', '.join(names)}",
            lambda columns, names=names: {n: -columns[n] for n in names},
            names,
        )


def copied_readings(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The joint readings of the rows are exactly those of rows of the same target, which fit: a block was pasted twice.

    limit is not read: equal numbers with all their digits are no chance.
    """
    labels = [recording.columns[name] for name in _LABELS if name in recording.columns]
    joints = np.column_stack([np.round(recording.joints, 12), *labels])
    others = np.setdiff1d(np.arange(recording.n), rows)
    places = {tuple(joints[k]): k for k in others[::-1]}
    sources = np.array([places.get(tuple(joints[k]), -1) for k in rows])
    is_copy = sources >= 0
    poses = {tuple(joints[k]) for k in rows[is_copy]}
    if is_copy.mean() <= MIN_SHARE or len(poses) < LEAST_ROWS:
        return None
    ids = recording.sample_ids
    copies = ids[rows[is_copy]]
    originals = ids[sources[is_copy]]
    return Reason(
        f"samples {copies[0]} to {copies[-1]} hold the joint readings of samples {originals[0]} to {originals[-1]}, "
        "with other measurements: a block of readings was pasted twice",
        "copied-rows",
    )


def held_measurements(robot, recording, fit: Fit, rows, limit: float) -> Reason | None:
    """The measured values of the rows are exactly those of an earlier row with other joint readings."""
    if not set(POINT) <= set(recording.columns):
        return None
    names = [name for name in (*POINT, "qw", "qx", "qy", "qz") if name in recording.columns]
    values = np.stack([recording.columns[name] for name in names], axis=1)
    earlier: dict[tuple, int] = {}
    sources = np.full(recording.n, -1)
    for k, row in enumerate(map(tuple, values)):
        sources[k] = earlier.get(row, -1)
        earlier.setdefault(row, k)
    repeating = rows[sources[rows] >= 0]
    joints = recording.joints
    repeating = repeating[np.any(joints[repeating] != joints[sources[repeating]], axis=1)]
    if len(repeating) < 2 or len(repeating) <= MIN_SHARE * len(rows):
        return None
    ids = recording.sample_ids
    pairs = [f"{ids[k]} (that of {ids[sources[k]]})" for k in repeating[:_NAMED]]
    if len(repeating) > _NAMED:
        remainder = f" and {len(repeating) - _NAMED} more"
    else:
        remainder = ""
    return Reason(
        f"they repeat an earlier measurement digit for digit, at other joint readings: samples {', '.join(pairs)}"
        f"{remainder}; the instrument held its last value, or cells were copied",
        "held-measurements",
    )
