"""Fit of board poses to each possible reading of the flange poses.

One transform from flange to camera must explain all board poses (robust linear start on SO(3) from many rotations;
`robot_model.measurements.multistart`).
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import Frames
from robot_model.measurements.external_pose import ExternalPose
from robot_model.measurements.multistart import MODEL_ERROR_MM, lever_arm
from workbench.core.rigid import inverse
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.interpretation.orientation_misfits import (
    least_misfits,
    rotation_misfits,
)

_KEPT = 0.9
_GOOD_SHARE, _LEAST_GOOD_MM, _GOOD_DEG = 0.05, 3.0, 3.0
_HOPELESS_RAD, _SHOWN = np.deg2rad(10.0), 8
_REFINED = 12  # readings that are fitted well
_SWEEPS, _MOST_GAP_RAD = 10, np.deg2rad(20.0)
"""A wrong board pose does not decide the labels of the other images."""


@dataclass(frozen=True)
class BoardViews:
    """Board poses `seen` (T, k, 4, 4) T_camera_board of the rows `rows` (k,) of the table.

    T: in how many ways the board can be labelled, 1 unless it looks the same after a rotation. `found`: the detection
    with the views, and `camera` the calibration from them.
    """

    seen: np.ndarray
    rows: np.ndarray
    found: object = None
    camera: object = None


def compare_readings(readings, views: BoardViews, kind: str) -> list[tuple[int, CandidateFit]]:
    """Index and fit of the readings, the most probable first."""
    measured = inverse(views.seen) if kind == "in-hand" else views.seen
    turns = np.array([poses[views.rows][:, :3, :3] for _, _, poses in readings])
    labels = [agreeing_labels(measured[..., :3, :3], turned) for turned in turns]
    all_rows = np.arange(len(views.rows))
    chosen = [measured[labelling, all_rows] for labelling in labels]
    misfits = np.array(
        [
            rotation_misfits(motions[:, :3, :3], [turned])[0]
            for motions, turned in zip(chosen, turns)
        ]
    )
    retained = least_misfits(misfits, len(turns))
    if misfits[retained[0]] > _HOPELESS_RAD:
        retained = retained[
            :_SHOWN
        ]  # no transform can explain other angles between the poses; fits are for the message
    if len(retained) > _REFINED:
        quick = {k: _quick_misfit(readings[k][2][views.rows], chosen[k]) for k in retained}
        retained = sorted(retained, key=quick.get)[:_REFINED]
    fits = []
    for k in retained:
        fits.append((k, _fit(readings[k][0], readings[k][2][views.rows], chosen[k])))
    return sorted(fits, key=lambda item: item[1].improbability)


def _quick_misfit(poses: np.ndarray, measured: np.ndarray) -> float:
    """RMS gap of most poses (k, 4, 4) at a rough fit, in units of the rows."""
    frames, target = as_instrument_poses(poses, measured)
    gaps = np.sort(target.system(frames).quick_distances())
    return _rms(gaps[: int(np.ceil(_KEPT * len(gaps)))])


def agreeing_labels(measured: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """(k,) in 0..T-1: the labelling of the board in each image under which its rotations agree best with the arm's.

    measured (T, k, 3, 3): rotations of the board under each labelling; turned (k, 3, 3): of the flange. Between two
    images both rotate by the same angle, whatever the hand-eye transform (Chen, CVPR 1991). The first image keeps its
    label, because a rotation of all labels is another board frame only.
    """
    ways, count = measured.shape[:2]
    labels = np.zeros(count, int)
    if ways == 1:
        return labels
    wanted = _angles_between(turned, turned)
    angle = _angles_between(measured.reshape(-1, 3, 3), measured.reshape(-1, 3, 3))
    gaps = np.abs(angle.reshape(ways, count, ways, count) - wanted[None, :, None, :])
    labels[1:] = gaps[0, 0, :, 1:].argmin(0)
    for _ in range(_SWEEPS):
        before = labels.copy()
        for image in range(1, count):
            others = np.arange(count) != image
            costs = np.minimum(gaps[:, image, labels, np.arange(count)], _MOST_GAP_RAD)
            labels[image] = int(costs[:, others].sum(1).argmin())
        if (labels == before).all():
            break
    return labels


def _angles_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(a, b) rad between rotations (a, 3, 3) and (b, 3, 3)."""
    trace = np.einsum("aij,bij->ab", first, second)
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _fit(title: str, poses: np.ndarray, measured: np.ndarray) -> CandidateFit:
    """One transform from flange to target, and one from base to camera or board, for all poses (k, 4, 4)."""
    places = measured[:, :3, 3]
    place, turn, lever_mm = _gaps(poses, measured)
    total_gap = np.hypot(place, turn)
    # the best of them: a wrong board pose or two must not decide between the readings
    best = np.argsort(total_gap)[: int(np.ceil(_KEPT * len(total_gap)))]
    scale = _rms(total_gap[best])
    rms_mm = _rms(place[best])
    rms_deg = float(np.rad2deg(_rms(turn[best]) / lever_mm))
    spread = float(np.linalg.norm(np.ptp(places, axis=0)))
    good_mm = max(_LEAST_GOOD_MM, _GOOD_SHARE * spread)
    is_good = rms_mm <= good_mm and rms_deg <= _GOOD_DEG
    degrees = max(6 * len(total_gap) - 12, 6)
    improbability = degrees * np.log(max(scale, 1e-3))
    return CandidateFit(title, rms_mm, rms_deg, scale, improbability, is_good)


def _rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt((values**2).mean()))


def _gaps(poses: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Gaps (k,) mm of place and of rotation at the linear solution, and the lever of the latter in mm."""
    frames, target = as_instrument_poses(poses, measured)
    system = target.system(frames)
    start = system.starts()[0]
    gap = system.rotation_rows @ start.rotations.ravel()
    gap = gap + system.translation_rows @ start.translations - system.right
    place = np.linalg.norm(gap[:, :3], axis=1) * MODEL_ERROR_MM
    turn = np.linalg.norm(gap[:, 3:], axis=1) * MODEL_ERROR_MM
    return place, turn, lever_arm(frames.end_origin)


def as_instrument_poses(poses: np.ndarray, measured: np.ndarray) -> tuple[Frames, ExternalPose]:
    """Flange poses and target poses (k, 4, 4) as the frames of an arm and the measurements of an instrument."""
    columns = tuple(np.ascontiguousarray(poses[:, :3, c].T) for c in range(3))
    origin = np.ascontiguousarray(poses[:, :3, 3].T)
    frames = Frames((), (), None, None, None, None, columns, origin)
    target = ExternalPose(np.ascontiguousarray(measured[:, :3, 3].T), measured[:, :3, :3])
    return frames, target
