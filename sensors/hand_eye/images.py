"""Hand-eye from images of a board: where the camera sits on the flange, or next to the robot.

`hand_eye_from_views` starts from OpenCV's closed forms and ends in a maximum-likelihood adjustment
of pixels in which the robot's own poses are measured with error. The error of a set of images
is stated as the field does: by how much the board, which never moved, seems to move.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensors.boards.circles import centre_shift, lens_shift
from sensors.boards.detection import relabelled
from sensors.camera.model import Camera, StatedCamera
from sensors.hand_eye.adjust import Variances, adjust, find_blunders, with_held_camera
from sensors.hand_eye.chain import BoardChain
from sensors.hand_eye.checks.alternatives import moved_of
from sensors.hand_eye.checks.camera_dependence import Conditions, camera_dependence
from sensors.hand_eye.checks.corner_noise import board_corners, corner_noise
from sensors.hand_eye.checks.mistakes import Reading, pose_readings
from sensors.hand_eye.checks.pose_data import PoseData
from sensors.hand_eye.checks.pose_fit import robust_starts
from sensors.hand_eye.checks.review import Named, Review, review
from sensors.hand_eye.checks.scatter import held_least, held_scatter, least_scatter, scatter
from sensors.hand_eye.motion import motion
from sensors.hand_eye.poses import check_pixels, checked_flange
from sensors.hand_eye.result import HandEye, PoseRow, held_row, of_block, placement, rms
from sensors.hand_eye.start import board_poses, nearest_labelling, start_from_boards
from sensors.hand_eye.uncertainty.flange_variance import flange_variance
from sensors.hand_eye.uncertainty.misfit import image_misfit, with_misfit
from sensors.hand_eye.uncertainty.parameter_covariance import parameter_covariance
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import symmetric_eigen

__all__ = ["HandEye", "PoseRow", "hand_eye_from_views"]
KINDS = ("in-hand", "to-hand")
_SCALE = "target.scale"
# Standard deviations of a camera from the same images, as a multiple of its own: the images enter the adjustment once.
_SHARED_IMAGES_FACTOR = 10.0
_SURE = 2.0  # sigmas from one before the board's scale is tried
_CERTAIN = 3.0  # sigmas from one that keep the scale where the other poses do not contradict it
_PAIRED_T = 2.0  # of the reduction of the squared held-out error, paired over the poses


def hand_eye_from_views(
    views,
    board,
    camera,
    flange,
    kind="in-hand",
    camera_covariance=None,
    pivot="board",
    reviewed: Review | None = None,
    conditions: Conditions | None = None,
) -> HandEye:
    """Hand-eye, board and robot's pose error from views of one board.

    views: of each pose one with `index` (k,) and `pixels` (2, k); board: with `points` (3, N) mm;
    camera: Camera, a StatedCamera, whose values are held and whose covariance is propagated to the
    transform, or a calibration with `camera`, `covariance` and the board's `bow`, which is then
    taken over; flange: (P, 4, 4) T_base_flange; kind: "in-hand", the camera on the flange and the board
    fixed in the base, or "to-hand", the board on the flange. camera_covariance (V, V) of
    `camera.values`: the camera is adjusted too, with this as prior; None: that of the calibration, or
    the camera is held. pivot: where the robot's errors of position and of rotation are taken as
    independent, "board": at the middle of the board, which makes the most likely hand-eye that of the
    least board scatter, or "flange"; errors that are independent at the flange, and taken at
    the board, half a metre away, leave errors of 0.6 to 1.2 sigmas (RMS, by direction, over 100 sets).
    The board's scale is estimated, with a prior of 0.001, where it differs from one by more than two sigmas and lowers
    the error of poses that the solve did not see.
    reviewed: what `review_views` found, None looks for mistakes in the flange poses here. conditions of the poses, on
    which the camera may depend; None does not test it.
    InputError for fewer than three poses, poses that are none, or numbers of poses and views that differ.
    """
    stated, camera = _stated(camera)
    flange = _checked(views, flange, kind)
    points = _shape(board, camera)
    from_same_images = camera_covariance is None and hasattr(camera, "covariance")
    camera, covariance = _camera(camera, camera_covariance)
    views = _same_way_round(views, board, points, camera, flange, kind)
    if from_same_images:
        covariance = _SHARED_IMAGES_FACTOR**2 * covariance
    chain = _chain(views, points, camera, flange, kind, covariance)
    seen = board_poses(chain.board, chain.pixels, chain.pose, camera)
    start, misfit = start_from_boards(flange, seen, points, kind)
    chain = replace(chain, pivot=_pivot(pivot, chain, start, points))
    values = np.concatenate([start, np.zeros(1 + chain.modes.shape[1])])
    parameters = replace(chain.parameters, values=values).free("*").fix(_SCALE)
    first = Variances(_noise(chain, seen), np.array([misfit, misfit / _reach(seen)]))
    reviewed = reviewed or review_views(views, board, (camera, points), flange, kind)
    suspicions = reviewed.sentences
    max_blunders = (
        0 if reviewed.certain else len(flange) // 4
    )  # poses read wrongly are not to be taken for blunders
    found, notes = _best(chain, parameters, first, max_blunders, not suspicions)
    dependence = None if conditions is None else camera_dependence(found[0], conditions)
    misfit = image_misfit(found[0], camera.size, from_same_images)
    if stated is not None:  # first: the sensitivity to the camera is that of the adjustment alone
        found = (with_held_camera(found[0], _root(stated)), *found[1:])
    if misfit.significant:
        found = (with_misfit(found[0], misfit), *found[1:])
        notes = notes if misfit.is_relevant else (*notes, misfit.note)
    made = _result(chain, points, found, suspicions, notes)
    return replace(made, misfit=misfit, dependence=dependence)


def _best(chain, parameters, first, max_blunders, is_scale_tried):
    """The better result of `find_blunders`, with or without the board's scale, and the sentences on it."""
    without_scale = find_blunders(chain, parameters, first, max_blunders)
    adjusted = without_scale[0]
    if (
        not is_scale_tried
        or motion(chain.flange, chain.kind, adjusted.variances.spread[1]).sentences
    ):
        return without_scale, ()
    with_scale = adjust(adjusted.chain, adjusted.parameters.free(_SCALE), adjusted.variances)
    if abs(with_scale.parameters[_SCALE]) < _SURE * _scale_sigma(with_scale):
        return without_scale, ()
    scaled = find_blunders(
        chain, with_scale.parameters.free(_SCALE), with_scale.variances, max_blunders
    )
    before = _predicted(chain, without_scale)
    after = _predicted(chain, scaled)
    scale = scaled[0].parameters[_SCALE]
    sigma = _scale_sigma(scaled[0])
    is_kept = _is_reduced(before, after, abs(scale) > _CERTAIN * sigma)
    rms = [float(np.sqrt(np.nanmean(squares))) for squares in (before, after)]
    words = f"scale of the board {scale:+.2%} (sigma {sigma:.2%}): held-out {rms[0]:.3g} -> {rms[1]:.3g} px"
    return (
        (scaled, (f"{words}, kept",))
        if is_kept
        else (without_scale, (f"{words}, not retained by cross-validation",))
    )


def _scale_sigma(adjusted) -> float:
    """Standard deviation of the board's scale."""
    place = adjusted.parameters.keys.index(_SCALE)
    place = int(adjusted.parameters.mask[:place].sum())
    return float(np.sqrt(max(adjusted.linear.covariance[place, place], 0.0)))


def _is_reduced(before: np.ndarray, after: np.ndarray, is_certain: bool) -> bool:
    """Whether a parameter lowers the squared held-out errors (P,) by more than chance; nan for poses left out.

    A paired t test over the poses; is_certain: its size alone excludes chance, so that any reduction is enough.
    """
    gain = before - after
    gain = gain[np.isfinite(gain)]
    if not gain.sum() > 0:
        return False
    return is_certain or gain.mean() > _PAIRED_T * gain.std(ddof=1) / np.sqrt(len(gain))


def _predicted(chain, adjustment) -> np.ndarray:
    """(P,) px^2, mean square of each pose predicted from the others; nan for those that were left out for good."""
    squares = np.full(len(chain.flange), np.nan)
    _, pose_fits, left_out = adjustment
    for k, fit in pose_fits.items():
        if k in left_out:
            continue
        of_pose = chain.at(np.flatnonzero(chain.pose == k))
        residual = of_pose.evaluate(fit.values).residual
        squares[k] = (residual**2).sum(0).mean()
    return squares


def review_views(
    views, board, camera, flange, kind="in-hand", readings: Sequence[Reading] | None = None
) -> Review:
    """Whether flange poses and images fit each other, and which mistake explains it if they do not.

    Arguments as in `hand_eye_from_views`; camera may also be a pair (Camera, board points (3, N) mm). readings: other
    readings of the flange poses to try; None tries those of `mistakes.pose_readings`.
    """
    flange = _checked(views, flange, kind)
    view_camera, points = (
        camera if isinstance(camera, tuple) else (_camera(camera, None)[0], _shape(board, camera))
    )
    labellings = range(getattr(board, "rotational_symmetry", 1))
    labelled_views = [
        [relabelled(view, board, labelling) for view in views] if labelling else views
        for labelling in labellings
    ]
    chains = [
        _chain(labelled, points, view_camera, flange, kind, None) for labelled in labelled_views
    ]
    seen = np.array(
        [board_poses(chain.board, chain.pixels, chain.pose, view_camera) for chain in chains]
    )
    corners = board_corners(points)
    noise = corner_noise(chains[0], seen[0], corners)
    names = [getattr(view, "image", "") or f"pose {k}" for k, view in enumerate(views)]
    data = PoseData(moved_of(flange, kind), seen, corners)
    readings = pose_readings(flange) if readings is None else readings
    return review(data, noise, Named(names, kind), readings, robust_starts(data))


def _checked(views, flange, kind):
    if kind not in KINDS:
        raise InputError(
            f"hand-eye: expected kind in-hand or to-hand, found '{kind}'; write one of them"
        )
    flange = checked_flange(flange, "hand-eye")
    if len(flange) != len(views):
        raise InputError(
            f"hand-eye: expected one flange pose a image, found {len(flange)} poses and "
            f"{len(views)} images; take out what has no partner"
        )
    if len(flange) < 3:
        raise InputError(
            f"hand-eye: expected at least 3 poses, found {len(flange)}; take more, with turns about "
            "two axes"
        )
    check_pixels(views)
    return flange


def _shape(board, camera):
    """(3, N) mm of the board's points, with the bow that the camera's calibration found."""
    bow = getattr(camera, "bow", None)
    if (
        bow is None or getattr(board, "rotational_symmetry", 1) > 2
    ):  # after a rotation by 90 deg the bow would be another
        return board.points
    x, y = ((board.points - board.middle[:, None]) / board.half_diagonal)[:2]
    height = [bow.parameters[name] for name in ("xx", "yy", "xy")] @ np.stack([x * x, y * y, x * y])
    return board.points + np.stack([0 * x, 0 * x, height])


def _stated(camera):
    """Covariance (V, V) of a held camera, None without one, and the camera."""
    if not isinstance(camera, StatedCamera):
        return None, camera
    return camera.covariance, camera.camera


def _camera(camera, covariance):
    """The camera, and its covariance or None."""
    view_camera = camera if isinstance(camera, Camera) else camera.camera
    known = getattr(camera, "covariance", None) if covariance is None else covariance
    if known is None:
        return view_camera, None
    known = np.asarray(known, float)[: len(view_camera.values), : len(view_camera.values)]
    if not np.isfinite(known).all():
        raise InputError(
            "hand-eye: expected a camera whose covariance is finite, found one that its images do not "
            "determine; name a camera.toml, or take images with the board tilted"
        )
    return view_camera, known


def _chain(views, points, camera, flange, kind, covariance):
    pose = np.concatenate([np.full(len(view.index), k) for k, view in enumerate(views)])
    points = np.concatenate([points[:, view.index] for view in views], 1)
    pixels = np.concatenate([view.pixels for view in views], 1).astype(float)
    board_shift, lens = _shifts(views, points, pixels, pose, camera)
    printed = points
    points, pixels = points + board_shift, pixels - lens
    modes = np.zeros((len(camera.values), 0)) if covariance is None else _root(covariance)
    return BoardChain(
        kind,
        camera,
        points,
        pixels,
        flange,
        pose,
        np.zeros((len(flange), 6)),
        modes,
        np.zeros((len(flange), 3)),
        printed=printed,
    )


def _shifts(views, points, pixels, pose, camera):
    """(3, n) mm on the board and (2, n) px: an ellipse's centre is not where the disc's centre projects."""
    radius = np.array([getattr(view, "radius_mm", 0.0) for view in views])[pose]
    if not radius.any():
        return np.zeros_like(points), np.zeros_like(pixels)
    found = board_poses(points, pixels, pose, camera)
    placed = np.einsum("nij,jn->in", found[pose, :3, :3], points) + found[pose, :3, 3].T
    normals = found[pose, :3, 2].T
    shift = centre_shift(placed, normals, radius)
    lens = lens_shift(camera, placed + shift, normals, radius)
    return np.einsum("nji,jn->in", found[pose, :3, :3], shift), lens


def _same_way_round(views, board, points, camera, flange, kind):
    """Views of a board that looks the same after a rotation, relabelled so that it stands still in the base.

    The first start trusts the labels of most images; those that then lie nearer when rotated, are.
    """
    labellings = getattr(board, "rotational_symmetry", 1)
    if labellings == 1:
        return views
    labelled_views = [
        [relabelled(view, board, labelling) for view in views] for labelling in range(labellings)
    ]
    chains = [_chain(labelled, points, camera, flange, kind, None) for labelled in labelled_views]
    seen = np.array([board_poses(c.board, c.pixels, c.pose, camera) for c in chains])
    best = nearest_labelling(flange, seen, points, kind)
    return [labelled_views[labelling][k] for k, labelling in enumerate(best)]


def _pivot(pivot, chain, start, points):
    """(P, 3) mm, of every pose, in the base; on the flange for "to-hand"."""
    count = len(chain.flange)
    if pivot == "flange":
        return chain.flange[:, :3, 3] if chain.kind == "in-hand" else np.zeros((count, 3))
    board = placement(start[6:])
    board_middle = board[:3, :3] @ points.mean(1) + board[:3, 3]
    return np.tile(board_middle, (count, 1))


def _root(covariance):
    """(V, M) with root root' = covariance, without the directions that are known exactly."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(scale, scale)
    values, vectors = symmetric_eigen(correlation)
    is_uncertain = values > 1e-12
    return scale[:, None] * vectors[:, is_uncertain] * np.sqrt(values[is_uncertain])


def _noise(chain, seen):
    """px, of one coordinate, by which each board misses its own image."""
    board_pose = seen[chain.pose]
    rotated = np.einsum("nij,jn->in", board_pose[:, :3, :3], chain.board)
    corners = rotated + board_pose[:, :3, 3].T
    error = chain.camera.project(corners) - chain.pixels
    return max(float(np.sqrt(np.mean(error**2))), 1e-4)


def _reach(seen):
    return float(np.median(np.linalg.norm(seen[:, :3, 3], axis=1)))


def _result(chain, points, found, suspicions, notes):
    adjusted, left_out, blunders = found
    values = adjusted.parameters.values
    count = len(chain.flange)
    used = ~np.isin(np.arange(count), blunders)
    exact = chain.evaluate(values).residual
    free = chain.with_families({"pose": adjusted.errors}).evaluate(values).residual
    held_out = np.empty_like(exact)
    for k in range(count):
        held_out[:, chain.pose == k] = (
            chain.at(np.flatnonzero(chain.pose == k)).evaluate(left_out[k].values).residual
        )
    shift, spin = (0.0, 0.0) if suspicions else adjusted.variances.spread
    known = parameter_covariance(adjusted, motion(chain.flange[used], chain.kind, spin, shift))
    at_flange = flange_variance(adjusted, _pivot("flange", chain, None, None))
    return HandEye(
        kind=chain.kind,
        sensor=placement(values[:6]),
        covariance=of_block(adjusted, known, "sensor"),
        target=placement(values[6:12]),
        target_covariance=of_block(adjusted, known, "target"),
        camera=chain.camera_at(values),
        parameters=adjusted.parameters,
        std=_std(chain, known),
        noise=adjusted.variances.noise,
        unit="px",
        robot_sigma={**_at_board(adjusted), **at_flange.as_keys()},
        fit={
            "rms_px": rms(exact, used[chain.pose]),
            "sensor_rms_px": rms(free, used[chain.pose]),
            **scatter(chain, points, values, used),
            **least_scatter(chain, points, values, used),
        },
        held_out={
            "rms_px": rms(held_out, used[chain.pose]),
            "folds": int(used.sum()),
            **held_scatter(chain, points, left_out, used),
            **held_least(chain, points, values, used),
        },
        poses=tuple(
            held_row(k, chain, at_flange, exact, held_out, left_out[k], k in blunders)
            for k in range(count)
        ),
        undetermined=known.sentences,
        suspicions=suspicions,
        outcome=adjusted.outcome,
        converged=adjusted.converged,
        history=adjusted.history,
        notes=notes,
    )


def _at_board(adjusted) -> dict[str, float]:
    """1 sigma of the pose errors at the middle of the board."""
    position, rotation = adjusted.variances.spread
    return {"position_mm": float(position), "rotation_deg": float(np.degrees(rotation))}


def _std(chain, known):
    """1 sigma by key; the camera's by its own values, in place of the components of its covariance."""
    table = {key: value for key, value in known.std().items() if not key.startswith("camera.")}
    places = [k for k, key in enumerate(known.keys) if key.startswith("camera.")]
    if not places:
        return table
    square = np.diag(chain.modes @ known.covariance[np.ix_(places, places)] @ chain.modes.T)
    spread = np.sqrt(np.maximum(square, 0.0))
    return {
        **table,
        **dict(zip((f"camera.{name}" for name in chain.camera.names), spread.tolist())),
    }
