"""The recording of a table of flange poses and poses of a target."""

from dataclasses import replace

import numpy as np

from datasets.importers.mapping.conversion import complete_rows, other_columns
from datasets.importers.mapping.rotations import quaternion_columns
from datasets.importers.source import RawTable
from datasets.recording import Recording
from sensors.hand_eye.checks.half_turn import rotated_target_sentence, target_rotations_deg
from sensors.hand_eye.checks.nouns import TARGET_POSES
from sensors.hand_eye.checks.outlier_message import outlier_sentence
from sensors.hand_eye.checks.review import UNEXPLAINED, rotation_disagreement
from sensors.hand_eye.checks.target_review import review_target_poses
from sensors.hand_eye.motion import motion
from workbench.core.errors import InputError
from workbench.recordings.importing.board_images.pose_readings import pose_columns
from workbench.recordings.importing.interpretation.decisions import choose_reading, close_fits
from workbench.recordings.importing.measured_robot import Made
from workbench.recordings.importing.target_poses.motion_gaps import named_gaps
from workbench.recordings.importing.target_poses.readings import (
    FIXED_TO,
    TargetReading,
    compared_readings,
    most_consistent,
    usual_readings,
)


class UnexplainedPoses(InputError):
    """Poses whose rotations agree and whose positions do not, which no mistake explains; `reason` in words."""

    def __init__(self, sentence: str, reason: str):
        super().__init__(sentence)
        self.reason = reason


_FEWEST = 4
_SAME_MODEL = 1.5
"""Ratio of the misfits of the same model with target poses as written, and inverted, below which noise decides."""
_COMPUTED_MM = 1e-3  # no camera sees a target better: of computed poses, what is left is rounding
_GAP_DEG = 1.0  # more than an arm of any quality makes
_KINDS = ("target-pose", "external-pose", "external-point", None)
_REMEDY = (
    "check that each row holds the flange pose and the pose of the target of one moment, and the columns of the "
    "mapping"
)


def import_target_poses(found, options, progress) -> Made | None:
    """Recording, mapping and fits of flange poses and target poses in one table; None for any other table.

    found, options: as of `import_table`. Raises InputError where no reading fits, `UnexplainedPoses` where nothing
    explains it, and where several fit and nobody can be asked.
    """
    mapping = found.mapping
    groups = (mapping.flange_point, mapping.flange_rotation, mapping.point, mapping.rotation)
    if mapping.joints is not None or None in groups or mapping.measures not in _KINDS:
        return None
    if found.timed is not None or found.table is None or found.sessions:
        return None
    mapping = replace(mapping, measures="target-pose", axis=None)
    rows, notes = complete_rows(found.table, mapping)
    if rows.n < _FEWEST:
        raise InputError(
            f"{rows.file}: expected flange poses and poses of the target in {_FEWEST} rows or more to test units and "
            f"rotation conventions, found {rows.n}; add poses, with rotations about two axes."
        )
    progress("testing readings of flange poses and target poses")
    readings, compared = compared_readings(rows, mapping)
    fits = [item for item in compared if not _is_same_model(item, compared, readings)]
    if not fits[0][1].is_good and not options.trust_data:
        _check_usual(rows, mapping, readings)
    elif not options.trust_data:
        _refuse_explained(rows, [readings[place] for place, _ in close_fits(compared)])
    lines = [reading.line for reading in readings]
    with named_gaps(rows.file, fits, lambda place: readings[place].poses.flange):
        chosen = choose_reading(lines, fits, f"{rows.file}, poses", options.ask, _REMEDY)
    reading = readings[chosen]
    suspicions = tuple(_suspicions(rows, reading))
    recording = _recording(rows, reading, other_columns(rows, mapping), options)
    board = {**(mapping.board or {}), "fixed_to": FIXED_TO[reading.poses.kind]}
    mapping = replace(reading.mapping, board=board)
    notes = (*notes, *_assumptions(rows, reading), *suspicions)
    fits += [item for item in compared if item not in fits]
    return Made(recording, mapping, tuple(fit for _, fit in fits), notes, suspicions=suspicions)


def _is_same_model(item, compared, readings: list[TargetReading]) -> bool:
    """Whether a reading of inverted target poses is the model of one that is not inverted, which fits hardly worse.

    With T inverted and the camera at the other place, F X T = W has the same solutions; only what the noise of the
    poses does to the target distinguishes them. Programs write the target in the frame of the camera.
    """
    place, fit = item
    reading = readings[place]
    if not reading.inverted:
        return False
    return any(
        other.mapping == reading.mapping
        and not other.inverted
        and other.poses.kind != reading.poses.kind
        and other_fit.rms_mm <= _SAME_MODEL * max(fit.rms_mm, _COMPUTED_MM)
        for other, other_fit in ((readings[k], other_fit) for k, other_fit in compared)
    )


def _check_usual(rows: RawTable, mapping, readings: list[TargetReading]) -> None:
    """Raise InputError where no reading fits: with the mistake that the most consistent usual convention shows."""
    usual = usual_readings(rows, mapping)
    for reading in usual:
        rotated = target_rotations_deg(reading.poses.data)
        if rotated is not None and rotated.any():
            sentence = rotated_target_sentence(rotated, reading.poses.names)
            raise InputError(
                f"{rows.file}: expected poses of one target, found that {sentence} "
                f"(read as {reading.title})."
            )
    if not usual:
        return
    closest = most_consistent(usual[0], readings, rows)
    review = _review(closest)
    is_explained = review.certain and review.findings[0].cause != UNEXPLAINED
    reason = review.sentences[0] if is_explained else _disagreement(closest, review)
    sentence = (
        f"{rows.file}: expected flange poses that one hand-eye transform connects with the poses of the target, found "
        f"none under any reading. Read as {closest.title}: {reason}; {_REMEDY}, or repeat with --trust-data."
    )
    if is_explained or reason != _scatter(review):
        raise InputError(sentence)
    raise UnexplainedPoses(sentence, reason)


def _refuse_explained(rows: RawTable, close: list[TargetReading]) -> None:
    """Raise InputError where one mistake explains why the data do not decide between the readings that fit best."""
    if len(close) < 2:
        return
    reviewed = [(_review(reading), reading) for reading in close]
    explained = [
        (review.findings[0].corrected_mm, place)
        for place, (review, _) in enumerate(reviewed)
        if review.certain and np.isfinite(review.findings[0].corrected_mm)
    ]
    if not explained:
        return
    review, reading = reviewed[min(explained)[1]]
    raise InputError(
        f"{rows.file}: expected flange poses that one hand-eye transform connects with the poses of the target, found, "
        f"read as {reading.title}, that {review.sentences[0]}; {_REMEDY}, or repeat with --trust-data."
    )


def _disagreement(reading: TargetReading, review) -> str:
    """What in poses that no mistake explains disagrees."""
    gap = rotation_disagreement(reading.poses.data, review.fit.labels)
    if gap > _GAP_DEG:
        words = "flange and target rotate by different angles between the same two poses"
        return f"{words}, by {gap:.1f} deg in the median"
    return _scatter(review)


def _scatter(review) -> str:
    return f"the rotations agree, and the positions scatter by {review.trimmed_mm:.3g} mm"


def _review(reading: TargetReading):
    poses = reading.poses
    return review_target_poses(poses.flange, poses.data, poses.kind, list(poses.names))


def _suspicions(rows: RawTable, reading: TargetReading):
    """Sentences on mistakes in single rows, and on what the poses do not determine."""
    poses = reading.poses
    gaps = motion(poses.flange, poses.kind).sentences
    if gaps:
        yield from (f"The flange poses do not determine everything: {gap}." for gap in gaps)
        return
    review = _review(reading)
    wrong = outlier_sentence(review, list(poses.names), TARGET_POSES)
    if wrong is not None:
        yield f"{rows.file}: {wrong}."
    yield from (f"{rows.file}: {sentence}." for sentence in review.sentences)


def _assumptions(rows: RawTable, reading: TargetReading):
    """What the data alone cannot tell: which of two sets of poses is the flange's, and the unit that both share."""
    flange, target = reading.mapping.flange_point, reading.mapping.point
    camera = (
        "camera on the flange, target fixed"
        if reading.poses.kind == "in-hand"
        else ("target on the flange, camera fixed")
    )
    yield (
        f"{rows.file}: {flange.columns[0]} ... are read as poses of the flange in the base, {target.columns[0]} ... as "
        f"poses of the target in the camera{', inverted' if reading.inverted else ''}; {camera}. Exchanged or inverted "
        "flange poses would give another transform that fits as well, and so would poses of the camera in the target "
        "with the camera at the other place: make sure of them."
    )


def _recording(rows: RawTable, reading: TargetReading, others, options) -> Recording:
    poses = reading.poses
    columns = {"sample": np.arange(1.0, rows.n + 1)}
    columns |= pose_columns(rows, reading.mapping, {})
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), poses.seen[:, :3, 3].T))
    columns |= quaternion_columns(poses.seen[:, :3, :3])
    columns["fixed_to"] = np.full(rows.n, FIXED_TO[poses.kind])
    columns |= {name: cells for name, cells in others.items() if cells.dtype.kind == "f"}
    return Recording(
        measures="target-pose",
        columns=columns,
        robot={},
        sigma_mm=options.sigma_mm,
        name=options.name,
    )
