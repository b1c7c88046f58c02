"""From images of a board, or profiles of a ball, at flange poses to the hand-eye transform: contract and file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.boards.board import Board
from sensors.boards.detection import Rejected, View, detect_all
from sensors.camera.calibration import CameraCalibration, calibrate_camera
from sensors.camera.model import Camera, StatedCamera, camera_from_keys
from sensors.camera.model_choice import AUTO
from sensors.hand_eye.checks.camera_dependence import Conditions
from sensors.hand_eye.checks.relative_motions import (
    EQUAL_REMEDY,
    equal_poses_sentence,
    wrong_equal_poses,
)
from sensors.hand_eye.checks.review import Review
from sensors.hand_eye.result import HandEye
from sensors.trust import Trust
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_vector, rotation_vector_std
from workbench.files.images.columns import recorded_columns
from workbench.files.images.flange import flange_poses, rows_of_samples
from workbench.files.images.images import by_role, check_size
from workbench.files.provenance import provenance
from workbench.fitting.verdicts.hand_eye_verdict import (
    handeye_verdict,
    handeye_warnings,
    is_refused_by,
    robot_sigma,
    suspicions,
    undetermined,
)
from workbench.fitting.verdicts.verdict import Tolerance
from workbench.jobs.sensor import camera as cameras
from workbench.jobs.sensor import hand_eye_clouds, hand_eye_targets
from workbench.machine.progress import paced

FILE = "hand-eye.toml"
IN_HAND, TO_HAND = "in-hand", "to-hand"
_COMMENT = """\
# matrix: 4x4 in mm; p = matrix [p_sensor; 1] takes a point from the frame of the sensor to that of the flange
# (T_flange_sensor) or of the base (T_base_sensor). rotvec_deg: rotation vector, its length is the angle.
# covariance: 6x6 of x y z (mm) and a small rotation about the x, y and z axes of the flange or base (rad), left-
# multiplied; std_mm and std_deg are the roots of its diagonal.
"""
FEWEST = 3
"""Images that a hand-eye transform needs."""
_CONDITIONS = ("time", "temperature")
DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity in the base where no robot states it."""
FIXED_GUESS = "the recording's own guess, held"
SCANNER = "the scanner's"


@dataclass(frozen=True)
class HandEyeRun:
    """A recording's hand-eye: `made`, and `flange` (P, 4, 4) T_base_flange of its poses, called `names` (P).

    Of images: the `board`, its `views`, those `rejected`, and the `camera` calibration where it was made here. Of
    profiles of a ball whose radius is certified: `free`, the same with a radius that the profiles tell themselves.
    `review`: whether flange poses and images fit each other.
    """

    recording: Recording
    made: HandEye
    flange: np.ndarray
    names: tuple[str, ...]
    camera: Camera | None = None
    calibration: CameraCalibration | None = None
    board: Board | None = None
    views: tuple[View, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    source: str = ""
    free: HandEye | None = None
    review: Review | None = None
    camera_trust: Trust | None = None

    @property
    def stated_radius(self) -> float | None:
        """Radius of the ball, mm; None for boards, and for measured centres and points, which do not depend on it."""
        is_measured = self.recording.measures in ("ball-centre", "external-point")
        return None if is_measured else self.made.radius

    @property
    def is_of_target_poses(self) -> bool:
        """Whether another program measured the poses of the target: their errors are not those of the flange alone."""
        return self.recording.measures == "target-pose"

    @property
    def is_of_external_points(self) -> bool:
        """Whether a stationary instrument measured points on the flange."""
        return self.recording.measures == "external-point"


def calibrate(
    recording: Recording,
    sensor: Path | Camera | None,
    kind: str | None,
    progress: Callable[[str], None],
    trust_data: bool = False,
) -> HandEyeRun:
    """The hand-eye of a recording with flange poses or joint readings.

    sensor: a camera.toml or a scanner.toml, whose camera is held and whose covariance is propagated to that of the
    transform; a camera, to which the transform and its covariance are conditional; None calibrates the camera from the
    same images. kind: "in-hand" or "to-hand", None as the recording's [board] says. trust_data: a mistake in the data
    that explains what the data cannot is reported and does not refuse the recording. Raises InputError.
    """
    if recording.measures == "target-pose":
        return _from_targets(recording, kind, progress, trust_data)
    if recording.measures in _OF_POINTS:
        return _OF_POINTS[recording.measures](recording, kind, progress)
    by_role(recording, "board")
    kind = kind or (TO_HAND if (recording.board or {}).get("fixed_to") == "tool" else IN_HAND)
    flange = flange_poses(recording)
    found, views = _detected(recording, progress)
    camera, source = _camera(recording, sensor, found, progress)
    known = camera.camera if isinstance(camera, StatedCamera) else camera
    from sensors.hand_eye.images import hand_eye_from_views
    from workbench.fitting.verdicts.hand_eye_review import Observed, refuse, review_recording

    rows = rows_of_samples(recording, [view.row["sample"] for view in views])
    poses = flange[rows]
    progress(f"hand-eye from {len(views)} images")
    if not trust_data:
        _check_equal_poses(recording, views, poses)
    is_made = source != FIXED_GUESS and sensor is None
    observed = Observed(recording, found, views, known, is_made, poses, rows, kind)
    review = review_recording(observed, progress)
    calibration = camera if isinstance(camera, CameraCalibration) else None
    if not trust_data and is_refused_by(review, calibration):
        refuse(recording, review)
    hand_eye = hand_eye_from_views(
        views,
        found.board,
        camera,
        poses,
        kind,
        reviewed=review,
        conditions=_conditions(recording, views, rows),
    )
    notes = (*hand_eye.notes, *_on_camera(camera, source))
    hand_eye = replace(hand_eye, notes=notes)
    return HandEyeRun(
        recording,
        hand_eye,
        poses,
        tuple(view.image for view in views),
        hand_eye.camera,
        calibration,
        found.board,
        views,
        found.rejected,
        source,
        review=review,
        camera_trust=cameras.read_trust(sensor) if isinstance(sensor, Path) else None,
    )


def _detected(recording, progress) -> tuple:
    """Boards in the images, and those views that name a sample. InputError where they are too few."""
    tick = paced(progress, "board in image")
    found = detect_all(recording, lambda done, total, name: tick(done, total))
    views = tuple(view for view in found.views if "sample" in view.row)
    if not views:
        raise InputError(
            f"{recording.name}, images.csv, column sample: expected the row of samples.csv that each board "
            "image was taken at, found none; add the column"
        )
    _check_enough(recording, views, found)
    return found, views


def _conditions(recording, views, rows) -> Conditions:
    """Time, temperatures and direction of gravity, on which the camera may depend, at each image."""
    columns = {name: column[rows] for name, column in recording.columns.items()}
    of_images = recorded_columns([view.row for view in views])
    columns |= {name: np.array([view.row[name] for view in views], float) for name in of_images}
    covariates = {
        name: np.asarray(column, float)
        for name, column in columns.items()
        if name.startswith(_CONDITIONS) and np.isfinite(column).all()
    }
    gravity = np.asarray(recording.robot.get("gravity", DOWN), float)
    return Conditions(covariates, gravity / np.linalg.norm(gravity))


def _check_equal_poses(recording, views, poses) -> None:
    """InputError where images in which the board moved have one and the same flange pose."""
    wrong = wrong_equal_poses(poses, views)
    if wrong:
        sentence = equal_poses_sentence(wrong, [view.image for view in views])
        raise InputError(
            f"recording '{recording.name}': expected the flange pose of each image, found that {sentence}; "
            f"{EQUAL_REMEDY}, or use --trust-data to calibrate with the data as they are"
        )


def _check_enough(recording, views, found) -> None:
    """InputError where the board was found in too few images, with the reason of the first that was rejected."""
    if len(views) >= FEWEST or not found.rejected:
        return
    raise InputError(
        f"{recording.name}/recording.toml, [board]: expected the {found.board.title} in at least {FEWEST} images that "
        f"name a sample, found it in {len(views)} of {len(views) + len(found.rejected)} ({found.rejected[0]}); correct "
        "kind, columns and rows, or take the images again"
    )


def _camera(recording, sensor, found, progress):
    """The camera, and where it comes from: the file named, the recording's own guess, or the same images."""
    if isinstance(sensor, Camera):
        return sensor, SCANNER
    if sensor is not None:
        camera, covariance = cameras.read_stated(sensor)
        check_size(camera, found.size, recording.name, str(sensor))
        stated = camera if covariance is None else StatedCamera(camera, covariance)
        return stated, f"read from {sensor}"
    guess = recording.guess.get("camera")
    try:
        return (
            calibrate_camera(
                found.views, found.board, found.size, AUTO, folds=0, progress=progress
            ),
            "calibrated from the same images",
        )
    except InputError:
        if guess is None:
            raise
    keys = {"width_px": found.size[0], "height_px": found.size[1], **guess}
    return camera_from_keys(keys, f"{recording.name}, guess.camera"), FIXED_GUESS


def _on_camera(camera, source: str) -> tuple[str, ...]:
    """A note where the uncertainty of a held camera is not known, so that it is not in that of the transform."""
    if not isinstance(camera, Camera) or source == SCANNER:
        return ()
    return (
        f"camera {source}: no covariance is stated, so that the stated uncertainty of the transform does not include "
        "that of the camera; calibrate the camera with this version to include it",
    )


def _from_targets(recording, kind, progress, trust_data) -> HandEyeRun:
    found = hand_eye_targets.from_target_poses(recording, kind, progress, trust_data)
    return HandEyeRun(recording, found.made, found.flange, found.names, review=found.review)


def _from_centres(recording, kind, progress) -> HandEyeRun:
    _check_in_hand(recording, kind)
    flange = flange_poses(recording)
    hand_eye, poses, names = hand_eye_clouds.from_ball_centres(recording, flange, progress)
    return HandEyeRun(recording, hand_eye, poses, names)


def _from_external_points(recording, kind, progress) -> HandEyeRun:
    """From points on the flange that a stationary instrument measured, at recorded flange poses."""
    if recording.flange is None:
        raise InputError(
            f"{recording.name}, samples.csv: expected flange poses (flange_x_mm … flange_qz) next to the measured "
            "points, found none; `workbench calibrate` estimates base, tool and arm from joint readings"
        )
    if kind == IN_HAND:
        raise InputError(
            f"{recording.name}: expected a stationary instrument that measures points on the flange, found --kind "
            'in-hand; leave the option out, or state measures = "ball-centre" for a sensor on the flange'
        )
    made = hand_eye_clouds.from_external_points(recording, recording.flange, progress)
    return HandEyeRun(recording, *made)


def _from_surface(recording, kind, progress) -> HandEyeRun:
    """From points on one ball: clouds of a 3-D camera, or profiles of a laser profiler in its plane y = 0."""
    if not hand_eye_clouds.is_cloud(recording):
        return _from_profiles(recording, kind, progress)
    _check_in_hand(recording, kind)
    balls = np.unique(recording.ball)
    if len(balls) > 1:
        raise InputError(
            f"{recording.name}, samples.csv, column ball: expected clouds of one ball, found {len(balls)}; "
            "split the recording, one ball each"
        )
    flange = flange_poses(recording)
    hand_eye, poses, names = hand_eye_clouds.from_clouds(recording, flange, progress)
    return HandEyeRun(recording, hand_eye, poses, names)


def _check_in_hand(recording, kind) -> None:
    if kind == TO_HAND:
        raise InputError(
            f"{recording.name}: expected a sensor on the flange that measures a ball, found --kind to-hand; leave the "
            "option out"
        )


def _from_profiles(recording, kind, progress) -> HandEyeRun:
    from sensors.hand_eye.profiles import hand_eye_from_profiles

    if kind == TO_HAND:
        raise InputError(
            f"{recording.name}: expected a profiler on the flange for profiles of a ball, found --kind to-hand; "
            "leave the option out"
        )
    balls = np.unique(recording.ball)
    if len(balls) > 1:
        raise InputError(
            f"{recording.name}, samples.csv, column ball: expected profiles of one ball, found {len(balls)}; "
            "split the recording, one ball each"
        )
    labels, first, pose = np.unique(recording.poses, return_index=True, return_inverse=True)
    progress(f"hand-eye from {len(labels)} profiles of a ball")
    ball = recording.balls.get(int(balls[0]))
    hand_eye_clouds.check_unit(
        recording, recording.points[pose == 0].T, None if ball is None else float(ball[3])
    )
    flange = flange_poses(recording)[first]
    named = recording.columns.get("pose", labels)
    names = tuple(f"pose {named[row]:g}" for row in first)
    radius = None if ball is None else ball[3]
    hand_eye = hand_eye_from_profiles(recording.points.T, pose, flange, radius, names=names)
    free = None
    if ball is not None:
        progress("the same with a radius of its own")
        free = hand_eye_from_profiles(recording.points.T, pose, flange, None, names=names)
    return HandEyeRun(recording, hand_eye, flange, names, free=free)


_OF_POINTS = {
    "ball-surface": _from_surface,
    "ball-centre": _from_centres,
    "external-point": _from_external_points,
}
"""By kind of measurement: the hand-eye from points and flange poses."""


def as_json(run: HandEyeRun, tolerances: Sequence[Tolerance] = ()) -> dict:
    """The answer of `workbench handeye`; tolerances: what its verdict is judged by."""
    hand_eye = run.made
    return {
        "measures": run.recording.measures,
        "kind": hand_eye.kind,
        "transform": "T_base_sensor" if hand_eye.kind == TO_HAND else "T_flange_sensor",
        "poses": len(run.flange),
        "poses_used": len(run.flange) - len(hand_eye.outliers),
        "hand_eye": placed_json(hand_eye.sensor, hand_eye.covariance),
        "target": target_json(hand_eye),
        "noise": hand_eye.noise,
        "noise_unit": hand_eye.unit,
        "robot_sigma": robot_sigma(run),
        "fit": dict(hand_eye.fit),
        "held_out": dict(hand_eye.held_out),
        "errors": [
            {
                "name": name,
                "residual": row.residual,
                "held_out": row.held_out,
                "unit": hand_eye.unit,
                "moved_mm": row.moved_mm,
                "turned_deg": row.rotation_deg,
                "outlier": row.outlier,
                "why": row.why,
            }
            for name, row in zip(run.names, hand_eye.poses)
        ],
        "radius_mm": run.stated_radius,
        "radius_std_mm": hand_eye.std.get("target.radius"),
        **profiler_json(run),
        "camera": None
        if run.camera is None
        else {**cameras.camera_json(run.camera, hand_eye.std), "source": run.source},
        "rejected": [
            {"image": rejection.image, "why": rejection.why} for rejection in run.rejected
        ],
        "camera_dependence": dependence_json(hand_eye.dependence),
        "undetermined": undetermined(run),
        "suspicions": list(suspicions(run)),
        "warnings": handeye_warnings(run),
        "verdict": handeye_verdict(run, tolerances).as_json(),
        "notes": list(hand_eye.notes),
        "outcome": hand_eye.outcome,
        "converged": hand_eye.converged,
        "provenance": provenance(run.recording),
    }


def dependence_json(dependence) -> dict | None:
    """Dependence of the camera on gravity or a recorded column, None without a significant one."""
    if dependence is None:
        return None
    return {
        "parameter": dependence.parameter,
        "covariate": dependence.covariate,
        "size_px": dependence.size_px,
        "std_px": dependence.std_px,
        "p_value": dependence.p_value,
        "direction": None if dependence.direction is None else dependence.direction.tolist(),
        "sentence": dependence.sentence,
    }


def profiler_json(run: HandEyeRun) -> dict:
    """Of profiles: the scale error s of the profiler's z and the ball's radius where it is fitted.

    Measured z = (1 + s) true z, as in the effect range-scale. Sigmas are None where a number is held."""
    hand_eye = run.made
    free = run.made if run.free is None else run.free
    if hand_eye.radius is None:
        return {}
    return {
        "range_scale": hand_eye.range_scale,
        "range_scale_std": hand_eye.std.get("sensor.range_scale"),
        "free_radius_mm": free.radius,
        "free_radius_std_mm": free.std.get("target.radius"),
        "free_radius_range_scale": free.range_scale,
        "free_radius_range_scale_std": free.std.get("sensor.range_scale"),
        "free_radius_rms_mm": free.fit["rms_mm"],
    }


def placed_json(matrix: np.ndarray, covariance: np.ndarray) -> dict:
    """A transform as place and rotation vector with 1 sigma each (inf: not determined), and as a matrix.

    `std_deg` is that of a small rotation about the axes of the frame, `rotvec_std_deg` that of the rotation vector.
    """
    std = np.sqrt(np.diag(covariance))
    rotvec = rotation_vector(matrix[:3, :3])
    return {
        "xyz_mm": matrix[:3, 3].tolist(),
        "rotvec_deg": np.rad2deg(rotvec).tolist(),
        "rotvec_std_deg": np.rad2deg(rotation_vector_std(rotvec, covariance[3:, 3:])).tolist(),
        "std_mm": std[:3].tolist(),
        "std_deg": np.rad2deg(std[3:]).tolist(),
        "matrix": matrix.tolist(),
    }


def target_json(hand_eye: HandEye) -> dict:
    """Pose of the board or position of the ball."""
    if hand_eye.radius is None:
        return {
            "transform": "T_flange_board" if hand_eye.kind == TO_HAND else "T_base_board",
            **placed_json(hand_eye.target, hand_eye.target_covariance),
        }
    return {
        "transform": "measured point in the frame of the flange"
        if hand_eye.kind == TO_HAND
        else "centre of the ball in the base",
        "xyz_mm": hand_eye.centre.tolist(),
        "std_mm": np.sqrt(np.diag(hand_eye.target_covariance)).tolist(),
    }


def save(run: HandEyeRun, folder: Path) -> None:
    """Write hand-eye.toml into `folder`: the transform with its sigma, and where it comes from."""
    import tomli_w

    result = as_json(run)
    text = {
        "format": "hand-eye/1",
        "kind": result["kind"],
        "transform": result["transform"],
        **result["hand_eye"],
        "covariance": run.made.covariance.tolist(),
        "robot_sigma": {
            key: value for key, value in result["robot_sigma"].items() if value is not None
        },
        "undetermined": result["undetermined"],
        "suspicions": result["suspicions"],
        "provenance": {key: value for key, value in result["provenance"].items() if value},
    }
    (folder / FILE).write_text(f"{_COMMENT}{tomli_w.dumps(text)}", encoding="utf-8")
