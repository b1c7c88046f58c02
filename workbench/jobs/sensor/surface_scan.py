"""Profiles of a laser profiler or clouds of a 3-D camera, at flange poses: joined in the base frame, with balls."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.ball.fit import compared_with, fit_ball, with_radius_variance
from sensors.ball.result import BallFit
from sensors.ball.shared import Shared
from sensors.hand_eye.result import HandEye
from sensors.scanner.motion import Motion
from workbench.core.errors import InputError
from workbench.files.images.flange import flange_poses
from workbench.jobs.sensor.joined_scans import KnownHandEye, moved_by_robot, read_known
from workbench.jobs.sensor.scan import CLOUDS, Ball, Scan, Scans, figures, write_cloud

NAME = "all-poses"
_DRAWN = 4000
_MOVES = 3  # directions in which one pose can shift the ball


def join_surface(
    recording: Recording,
    hand_eye_file: Path | None,
    folder: Path,
    progress: Callable[[str], None],
) -> Scans:
    """One cloud of all poses of a ball-surface recording, in the base frame, and its balls.

    hand_eye_file: the hand-eye transform, None estimates it from the same points. folder: where the cloud goes, a PLY
    file. Raises InputError.
    """
    known, free = _hand_eye(recording, hand_eye_file, progress)
    pose = np.unique(recording.poses, return_inverse=True)[1]
    first = np.unique(pose, return_index=True)[1]
    motion = moved_by_robot(flange_poses(recording)[first], known)
    points = motion.points(recording.points.T, pose)
    (folder / CLOUDS).mkdir()
    file = f"{CLOUDS}/{NAME}.ply"
    write_cloud(folder / file, points[:, np.isfinite(points).all(0)])
    progress(f"balls in {points.shape[1]} points of {len(first)} poses")
    balls, outcome = _balls(recording, motion, points, pose, free)
    drawn_points = np.linspace(0, points.shape[1] - 1, min(points.shape[1], _DRAWN)).astype(int)
    accepted = figures(recording, {}, balls)
    scan = Scan(
        NAME,
        {},
        points.shape[1],
        file,
        points[:, drawn_points],
        {},
        balls,
        outcome,
        (),
        accepted,
        motion.frame,
    )
    return Scans(recording, None, None, [scan], folder.parent)


def _hand_eye(recording, hand_eye_file, progress) -> tuple[KnownHandEye, HandEye | None]:
    """The hand-eye transform; and that with a radius of its own, where both were estimated from the same profiles."""
    if hand_eye_file is not None:
        return read_known(hand_eye_file), None
    from workbench.jobs.sensor import hand_eye

    run = hand_eye.calibrate(recording, None, None, progress)
    hand_eye_run = run.made
    if not np.isfinite(np.diag(hand_eye_run.covariance)).all():
        raise InputError(
            f"{recording.name}: expected poses that determine the hand-eye transform, found that they do not "
            f"({'; '.join(hand_eye_run.undetermined)}); name one with --hand-eye FILE, or record more poses"
        )
    known = KnownHandEye(
        hand_eye_run.sensor,
        hand_eye_run.covariance,
        hand_eye_run.robot_sigma.get("position_mm", 0.0),
    )
    return known, run.free


def _balls(recording, motion: Motion, points, pose, free) -> tuple[tuple[Ball, ...], str]:
    fitted, failed = [], []
    for number in np.unique(recording.ball):
        is_on_ball = (recording.ball == number) & np.isfinite(points).all(0)
        found = recording.balls.get(int(number))
        radius = None if found is None else float(found[3])
        fit = _fit(motion, points[:, is_on_ball], pose[is_on_ball], radius)
        if fit:
            fit = _with_expected_scatter(motion, points[:, is_on_ball], pose[is_on_ball], fit)
            fit = _with_radius_errors(motion, points[:, is_on_ball], pose[is_on_ball], fit, free)
            fitted.append(
                _ball(motion, points[:, is_on_ball], pose[is_on_ball], fit, int(number), radius)
            )
        else:
            failed.append(f"ball {number}: {fit.outcome}")
    return tuple(fitted), "; ".join(failed)


def _fit(motion: Motion, points, pose, radius) -> BallFit:
    label = np.unique(pose, return_inverse=True)[1]
    moves = motion.own_moves(points, pose)
    covariance = np.kron(np.eye(label.max() + 1), motion.own_covariance)
    shared = Shared(label, moves, covariance)
    view = points - motion.poses[pose, :3, 3].T
    return fit_ball(points, radius=radius, view=view, shared=shared, ordered=False)


def _with_expected_scatter(motion: Motion, points, pose, fit: BallFit) -> BallFit:
    """The fit whose `sigma_scale` compares the distances with the noise within single poses and the stated errors of
    the flange poses together."""
    used = fit.inliers
    residual = fit.residual[used]
    pose_of_point = pose[used]
    outward = points[:, used] - fit.centre[:, None]
    outward = outward / np.linalg.norm(outward, axis=0)
    squares, degrees = 0.0, 0
    for sphere in np.unique(pose_of_point):
        rows = outward[:, pose_of_point == sphere].T
        remainder = residual[pose_of_point == sphere]
        remainder = remainder - rows @ np.linalg.lstsq(rows, remainder, rcond=1e-6)[0]
        squares = squares + float(remainder @ remainder)
        degrees = degrees + len(remainder) - _MOVES
    noise = squares / max(degrees, 1)
    normal_moves = np.einsum(
        "in,kin->kn", outward, motion.own_moves(points[:, used], pose_of_point)
    )
    stated = np.einsum("kn,kl,ln->n", normal_moves, motion.own_covariance, normal_moves).mean()
    sigma_scale = fit.rms / max(np.sqrt(noise + stated), 1e-9)
    return replace(fit, sigma_scale=sigma_scale)


def _with_radius_errors(
    motion: Motion, points, pose, fit: BallFit, free: HandEye | None
) -> BallFit:
    """The fit whose radius has the errors of the hand-eye transform, too.

    free: estimated from the same points as the transform, with a radius of its own. A transform of the certified radius
    lays the points on a ball of that radius, so that they show no other one; this estimate does.
    """
    std = None if free is None else free.std.get("target.radius")
    if std is not None and np.isfinite(std) and fit.free is not None:
        covariance = fit.free.covariance.copy()
        covariance[:3, :3] = free.target_covariance[:3, :3]
        covariance[3] = covariance[:, 3] = 0.0
        covariance[3, 3] = std**2
        centre = free.target[:3, 3]
        return compared_with(
            fit, replace(fit.free, centre=centre, radius=free.radius, covariance=covariance)
        )
    used = fit.inliers
    outward = points[:, used] - fit.centre[:, None]
    outward = outward / np.linalg.norm(outward, axis=0)
    variance = motion.common_of_radius(points[:, used], pose[used], outward)
    return with_radius_variance(fit, variance)


def _ball(motion: Motion, points, pose, fit: BallFit, number: int, radius) -> Ball:
    """A ball with what errors of the hand-eye transform, common to all poses, add to its covariance."""
    used = fit.inliers
    outward = points[:, used] - fit.centre[:, None]
    outward = outward / np.linalg.norm(outward, axis=0)
    common = motion.common_of_centre(points[:, used], pose[used], outward)
    pixels = np.full((2, points.shape[1]), np.nan)
    other = fit.free or fit
    return Ball(number, radius, fit, other, points, pixels, False, None, motion.frame, common)
