"""Do flange poses and measured poses of a target fit each other, and if not, which single mistake explains it?

The tests of images of a board (`review`), with the mistakes that are made in the poses of the target as well. What the
poses of the target scatter by alone is not known, so that only a scatter above that of a plausible arm is explained.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sensors.hand_eye.checks.alternatives import Alternative, moved_of
from sensors.hand_eye.checks.corner_noise import CornerNoise
from sensors.hand_eye.checks.half_turn import rotated_target_sentence, target_rotations_deg
from sensors.hand_eye.checks.mistakes import pose_readings
from sensors.hand_eye.checks.nouns import TARGET_POSES
from sensors.hand_eye.checks.pose_data import PoseData
from sensors.hand_eye.checks.pose_fit import approximate_misfit, fit_poses, robust_starts
from sensors.hand_eye.checks.review import Finding, Named, Review, review
from sensors.hand_eye.checks.session_alternatives import CorrectedData, session_alternatives
from workbench.core.rigid import inverse, transform

_UNKNOWN_NOISE = CornerNoise(0.0, 0, 0.0, 0.0, 0.0)
_REFINED = 3


def review_target_poses(flange: np.ndarray, data: PoseData, kind: str, names: list[str]) -> Review:
    """Compare flange poses (P, 4, 4) with the poses of the target in `data`; names (P,) of the rows."""
    named = Named(names, kind, TARGET_POSES)
    found = review(
        data,
        _UNKNOWN_NOISE,
        named,
        pose_readings(flange, TARGET_POSES),
        robust_starts(data),
        lambda recorded: [
            *_target_alternatives(recorded),
            *session_alternatives(recorded, _corrected(recorded, flange, named), names),
        ],
    )
    is_doubtful = bool(found.findings or found.outliers)
    rotated = target_rotations_deg(data) if is_doubtful else None
    if rotated is not None and rotated.any():
        finding = Finding("half-turn", rotated_target_sentence(rotated, names), True)
        return replace(found, findings=(finding,), outliers=())
    return found


def _corrected(data: PoseData, flange: np.ndarray, named: Named) -> Iterator[CorrectedData]:
    """All rows with each mistake of the flange poses, and of those of the target, undone."""
    for reading in pose_readings(flange, TARGET_POSES):
        moved = moved_of(reading.flange, named.kind)
        yield CorrectedData(reading.cause, reading.symptom, reading.do, replace(data, moved=moved))
    for cause, symptom, do, seen in _readings(data.seen[0]):
        yield CorrectedData(cause, symptom, do, replace(data, seen=seen[None]))


def _target_alternatives(data: PoseData) -> list[Alternative]:
    """Mistakes in the poses of the target, the closest fitted, the others counted."""
    tried = [
        (replace(data, seen=seen[None]), cause, symptom, do)
        for cause, symptom, do, seen in _readings(data.seen[0])
    ]
    tried.sort(key=lambda row: approximate_misfit(row[0]))
    found = []
    for place, (other, cause, symptom, do) in enumerate(tried):
        misfit = fit_poses(other).trimmed_rms if place < _REFINED else np.inf
        found.append(Alternative(cause, symptom, do, misfit))
    return found


def _readings(seen) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Cause, words, advice and the poses of the target (P, 4, 4) with one mistake undone."""
    from scipy.spatial.transform import Rotation

    yield (
        "target-inverse",
        "the poses of the target look inverted, T_target_sensor given for T_sensor_target",
        "write T_sensor_target",
        inverse(seen),
    )
    rotation, place = seen[:, :3, :3], seen[:, :3, 3]
    yield (
        "target-inverse-rotation",
        "the rotations of the target look inverted, and the positions do not",
        "transpose the rotation, or negate qx, qy and qz",
        transform(rotation.transpose(0, 2, 1), place),
    )
    recorded = Rotation.from_matrix(rotation).as_quat()
    for order, words in (
        ([3, 0, 1, 2], "qw … qz of the target look written in the order x, y, z, w"),
        ([1, 2, 3, 0], "qw … qz of the target look written with the scalar part in qx"),
    ):
        true = Rotation.from_quat(recorded[:, order]).as_matrix()
        yield "target-quaternion", words, "write the scalar part first", transform(true, place)
    yield from _position_readings(rotation, place)


def _position_readings(rotation, place) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """The same for positions of the target: reversed axes, and units of length."""
    for axis, signs in zip("xyz", 1 - 2 * np.eye(3)):
        yield (
            "target-axis",
            f"the column {axis}_mm of the target has the opposite sign: its positions are in a left-handed "
            "frame, or the axis of the sensor points the other way",
            f"negate {axis}_mm",
            transform(rotation, place * signs),
        )
        mirror = np.diag(signs)
        yield (
            "target-mirrored",
            f"the poses of the target look mirrored in {axis}, left-handed",
            "convert positions and orientations to a right-handed frame",
            transform(mirror @ rotation @ mirror, place * signs),
        )
    for unit, size in (("inches", 25.4), ("metres", 1000.0), ("centimetres", 10.0)):
        words = f"the positions of the target look given in {unit}"
        yield "target-unit", words, "convert them to mm", transform(rotation, size * place)
