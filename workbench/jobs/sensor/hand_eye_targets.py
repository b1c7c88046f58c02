"""Hand-eye of a camera whose program measured the poses of a board or marker (kind target-pose), at flange poses."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from sensors.hand_eye.checks.review import Review
from sensors.hand_eye.checks.target_review import review_target_poses
from sensors.hand_eye.result import HandEye
from sensors.hand_eye.target_poses import FEWEST, TargetPoses, hand_eye_from_target_poses
from workbench.core.errors import InputError
from workbench.files.images.flange import flange_poses
from workbench.files.images.target import stated_kind, target_poses


@dataclass(frozen=True)
class FromTargets:
    """`made`, with `flange` (P, 4, 4) of the poses `names` (P), and the `review` of the data."""

    made: HandEye
    flange: np.ndarray
    names: tuple[str, ...]
    review: Review


def from_target_poses(
    recording: Recording, kind: str | None, progress: Callable[[str], None], trust_data: bool
) -> FromTargets:
    """Hand-eye of a target-pose recording.

    kind: "in-hand" or "to-hand"; None: as the column fixed_to says, "in-hand" without it. trust_data: a mistake that
    explains what the data cannot is reported and does not refuse the recording. Raises InputError.
    """
    if recording.n < FEWEST:
        raise InputError(
            f"{recording.name}, samples.csv: expected at least {FEWEST} poses, found {recording.n}; take more, with "
            "rotations about two axes"
        )
    names = tuple(f"sample {number:g}" for number in recording.sample_ids)
    poses = TargetPoses(
        flange_poses(recording), target_poses(recording), kind or stated_kind(recording), names
    )
    progress("comparing flange poses and poses of the target")
    review = review_target_poses(poses.flange, poses.data, poses.kind, list(names))
    certain = next((finding for finding in review.findings if finding.certain), None)
    if certain is not None and not trust_data:
        raise InputError(
            f"recording '{recording.name}': expected flange poses and poses of the target that fit each other, found "
            f"that {certain.sentence}, or use --trust-data to calibrate with the data as they are"
        )
    progress(f"hand-eye from {len(names)} poses of the target")
    made = hand_eye_from_target_poses(poses, review)
    return FromTargets(made, poses.flange, names, review)
