"""Checks before a hand-eye transform is computed: flange poses, joint readings, camera and board."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from sensors.boards.detection import Detection, View
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model_choice import AUTO
from sensors.hand_eye.checks.mistakes import pose_readings
from sensors.hand_eye.checks.review import UNEXPLAINED, Finding, Review
from sensors.hand_eye.images import review_views
from workbench.core.errors import InputError
from workbench.fitting.hand_eye_joints import joint_readings

_FALLS = 3.0
_LEAST_PX = 0.2
_NOISY = 4.0
OVERRIDE = "--trust-data"


@dataclass(frozen=True)
class Observed:
    """Input of a hand-eye solve: `views` of the board of `found`, the `camera` and whether it was `made` from
    these images, flange `poses` (P, 4, 4) at `rows` (P,) of samples.csv, and the `kind`."""

    recording: Recording
    found: Detection
    views: tuple[View, ...]
    camera: object
    made: bool
    poses: np.ndarray
    rows: np.ndarray
    kind: str


def review_recording(seen: Observed, progress: Callable[[str], None]) -> Review:
    """Whether the recorded data fit each other, with the most likely mistake where they do not. Raises InputError."""
    progress("comparing flange poses and images")
    by_given_camera = _review(seen, seen.camera)
    if seen.made or not _may_be_the_camera(by_given_camera, seen.views):
        other = None
    else:
        other = _own_camera(seen, progress)
    if other is None:
        return by_given_camera
    finding = _camera_finding(by_given_camera, _review(seen, other))
    if finding is None:
        return by_given_camera
    return replace(by_given_camera, findings=(finding, *by_given_camera.findings))


def refuse(recording: Recording, review: Review) -> None:
    """Raise InputError where one mistake explains what the recorded data cannot."""
    finding = next((finding for finding in review.findings if finding.certain), None)
    if finding is not None:
        raise InputError(
            f"recording '{recording.name}': expected flange poses and images that fit each other, found that "
            f"{finding.sentence}, or use {OVERRIDE} to calibrate with the data as they are"
        )


def _review(seen: Observed, camera) -> Review:
    readings = pose_readings(seen.poses)
    if seen.recording.flange is None:
        readings = joint_readings(seen.recording, seen.rows)
    elif seen.recording.joints.shape[1] and seen.recording.robot:
        readings = itertools.chain(readings, _from_joints(seen))
    return review_views(seen.views, seen.found.board, camera, seen.poses, seen.kind, readings)


def _from_joints(seen):
    """The poses that the joint readings give, where the recording has both."""
    from sensors.hand_eye.checks.mistakes import Reading
    from workbench.files.images.flange import flange_poses

    columns = {
        name: values
        for name, values in seen.recording.columns.items()
        if not name.startswith("flange_")
    }
    try:
        poses = flange_poses(replace(seen.recording, columns=columns))[seen.rows]
    except InputError:
        return
    yield Reading(
        "flange-columns",
        "the flange columns look wrong, the joint readings right",
        "leave the flange columns out, or correct them",
        poses,
    )


def _may_be_the_camera(review: Review, views) -> bool:
    """Whether the images alone, or their poses, leave more than a right camera would, and no mistake explains it."""
    detected = float(np.median(np.concatenate([view.sigma for view in views])))
    if review.noise_px > max(_FALLS * detected, _LEAST_PX):
        return True
    explained = any(finding.cause != UNEXPLAINED for finding in review.findings)
    return not explained and review.scatter_mm > _NOISY * review.expected_mm


def _own_camera(seen, progress):
    try:
        return calibrate_camera(
            seen.found.views, seen.found.board, seen.found.size, AUTO, folds=0, progress=progress
        )
    except InputError:  # too few images to calibrate from
        return None


def _camera_finding(given: Review, by_own_camera: Review) -> Finding | None:
    """The camera file is wrong where the camera from the same images fits them, or the poses, several times better."""
    by_images = given.noise_px > _FALLS * by_own_camera.noise_px and given.noise_px > _LEAST_PX
    by_poses = given.trimmed_mm > _FALLS * by_own_camera.trimmed_mm and not by_own_camera.findings
    if not by_images and not by_poses:
        return None
    sentence = (
        "the camera that was named does not belong to these images (other lens, focus, zoom or image size): corners "
        f"miss by {given.noise_px:.2g} px and the board scatters by {given.scatter_mm:.3g} mm, with a camera "
        f"calibrated from the same images by {by_own_camera.noise_px:.2g} px and "
        f"{by_own_camera.scatter_mm:.2g} mm; leave --camera out or name the right file"
    )
    return Finding(
        "camera", sentence, by_images and given.scatter_mm > _FALLS * by_own_camera.scatter_mm
    )
