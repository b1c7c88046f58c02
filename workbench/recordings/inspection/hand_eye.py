"""Plausibility of a hand-eye recording before the transform is estimated: relative motions, equal poses, mistakes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from sensors.hand_eye.checks.nouns import BOARD_IMAGES, TARGET_POSES, Nouns
from sensors.hand_eye.checks.relative_motions import (
    EQUAL_REMEDY,
    RelativeMotions,
    equal_poses,
    equal_poses_sentence,
    relative_motions,
    scale_gap,
    wrong_equal_poses,
)
from workbench.core.errors import InputError
from workbench.core.rigid import transform
from workbench.files.images.flange import flange_poses, rows_of_samples
from workbench.files.images.target import stated_kind, target_poses

_GAP_DEG = 1.0  # more than an arm of any quality makes
_FEWEST = 3


@dataclass(frozen=True)
class HandEyePlausibility:
    """Faults and missing data, (what, action, is_certain) each, and the `motions`, None if uninformative."""

    findings: tuple[tuple[str, str, bool], ...]
    motions: RelativeMotions | None = None

    def as_json(self) -> dict | None:
        """`hand_eye` of the answer of `check`."""
        return None if self.motions is None else self.motions.as_json()


def inspect_hand_eye(recording: Recording, detection, progress) -> HandEyePlausibility:
    """Test images with flange poses or joint readings; empty where the recording has neither.

    detection: `sensors.boards.detection.Detection` of the images.
    """
    views = [view for view in detection.views if "sample" in view.row]
    if len(views) < _FEWEST:
        return HandEyePlausibility(())
    try:
        rows = rows_of_samples(recording, [view.row["sample"] for view in views])
        flange = flange_poses(recording)[rows]
    except InputError as problem:
        findings = ((str(problem).rstrip("."), "correct the recording", True),)
        return HandEyePlausibility(findings)
    names = [view.image for view in views]
    early = [*_equal(flange, views, names), *_rotations(flange, _kind(recording))]
    if any(certain for _, _, certain in early):
        return HandEyePlausibility(tuple(early))
    return _with_camera(recording, detection, (views, flange, rows), early, progress)


def inspect_target_poses(recording: Recording) -> HandEyePlausibility:
    """Test flange poses and measured poses of a target; empty where there are too few."""
    from sensors.hand_eye.checks.target_review import review_target_poses
    from sensors.hand_eye.target_poses import TargetPoses

    if recording.n < _FEWEST:
        return HandEyePlausibility(())
    names = [f"sample {number:g}" for number in recording.sample_ids]
    try:
        kind = stated_kind(recording)
        poses = TargetPoses(flange_poses(recording), target_poses(recording), kind, names)
    except InputError as problem:
        return HandEyePlausibility(((str(problem).rstrip("."), "correct the recording", True),))
    review = review_target_poses(poses.flange, poses.data, kind, names)
    found = [*_rotations(poses.flange, kind), *_outliers(review, names, TARGET_POSES)]
    findings = (*found, *(_finding(finding) for finding in review.findings))
    return HandEyePlausibility(findings)


def _kind(recording: Recording) -> str:
    if (recording.board or {}).get("fixed_to") == "tool":
        return "to-hand"
    return "in-hand"


def _equal(flange: np.ndarray, views: Sequence, names: Sequence[str]) -> Iterator[tuple]:
    wrong = wrong_equal_poses(flange, views)
    if wrong:
        yield equal_poses_sentence(wrong, names), EQUAL_REMEDY, True
    repeated = equal_poses(flange)
    if repeated and not wrong:
        first, later = repeated[0]
        statement = f"{len(repeated)} images repeat a flange pose, such as {names[later]} that of {names[first]}"
        yield (
            statement,
            "take images at other poses: a repeated pose adds nothing to the transform",
            False,
        )


def _rotations(flange: np.ndarray, kind: str) -> Iterator[tuple]:
    from sensors.hand_eye.motion import motion  # an arm's recording need not load the hand-eye

    for sentence in motion(flange, kind).sentences:
        statement, _, action = sentence.rpartition("; ")
        yield statement, action, True


def _with_camera(recording, detection, linked, early, progress) -> HandEyePlausibility:
    """The tests that need board poses: relative motions, and the mistakes that `handeye` refuses."""
    from sensors.camera.calibration import calibrate_camera
    from sensors.camera.model_choice import AUTO
    from workbench.fitting.verdicts.hand_eye_review import Observed, review_recording

    views, flange, rows = linked
    names = [view.image for view in views]
    try:
        camera = calibrate_camera(
            detection.views, detection.board, detection.size, AUTO, folds=0, progress=progress
        )
        seen = Observed(
            recording, detection, tuple(views), camera, True, flange, rows, _kind(recording)
        )
        review = review_recording(seen, progress)
    except InputError as problem:
        findings = (*early, (str(problem).rstrip("."), "correct it", False))
        return HandEyePlausibility(findings)
    board_seen = _board_poses(views, detection.board, camera.camera, flange, _kind(recording))
    at_middle = board_seen @ transform(np.eye(3), detection.board.middle)
    motions = relative_motions(flange, at_middle, _kind(recording))
    early = [*early, *_outliers(review, names)]
    named = [_finding(finding) for finding in review.findings]
    if named:
        found = [*early, *named]
    else:
        found = [*early, *_disagreements(motions)]
    return HandEyePlausibility(tuple(found), motions)


def _outliers(review, names: Sequence[str], nouns: Nouns = BOARD_IMAGES) -> Iterator[tuple]:
    from sensors.hand_eye.checks.outlier_message import outlier_sentence

    sentence = outlier_sentence(review, names, nouns)
    if sentence is not None:
        statement, _, action = sentence.rpartition("; ")
        yield statement, action, False


def _finding(finding) -> tuple[str, str, bool]:
    """A finding of the review, required like the verdict of `handeye`, which fails with any of them."""
    statement, _, action = finding.sentence.rpartition("; ")
    return statement or action, action if statement else "check them", True


def _board_poses(views, board, camera, flange, kind) -> np.ndarray:
    """(P, 4, 4) T_camera_board; a symmetric board labelled in each image as it agrees with the flange."""
    from sensors.boards.detection import relabelled
    from sensors.hand_eye.start import board_poses
    from workbench.recordings.importing.board_images.reading_fits import agreeing_labels

    seen = []
    for rotation in range(board.rotational_symmetry):
        labelled = [relabelled(view, board, rotation) for view in views]
        poses = [
            board_poses(board.points[:, v.index], v.pixels, np.zeros(len(v.index), int), camera)[0]
            for v in labelled
        ]
        seen.append(poses)
    seen = np.array(seen)
    if kind == "in-hand":
        rotations = np.swapaxes(seen[..., :3, :3], -1, -2)
    else:
        rotations = seen[..., :3, :3]
    chosen = agreeing_labels(rotations, flange[:, :3, :3])
    return seen[chosen, np.arange(len(views))]


def _disagreements(motions: RelativeMotions) -> Iterator[tuple]:
    """Disagreements of relative motions that no named mistake explains."""
    if motions.angle_gap_deg > _GAP_DEG:
        statement = (
            f"flange and camera rotate by different angles between the same two images, by {motions.angle_gap_deg:.1f} "
            "deg in the median"
        )
        yield (
            statement,
            "check which pose belongs to which image, and order and unit of the angles",
            True,
        )
        return
    gap = scale_gap(motions)
    if gap is not None:
        yield *gap, True
