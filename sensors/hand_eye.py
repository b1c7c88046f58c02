"""Hand-eye from pictures of a board: where the camera sits on the flange, or beside the robot.

`hand_eye_from_views` starts from OpenCV's closed forms and ends in a maximum-likelihood adjustment
of pixels in which the robot's own poses are measured with error. The error of a set of pictures
is stated as the field does: by how much the board, which never moved, seems to move.
"""

from dataclasses import replace

import numpy as np

from sensors.boards import relabelled
from sensors.camera import Camera
from sensors.circles import centre_shift
from sensors.hand_eye_adjust import Variances, find_blunders
from sensors.hand_eye_chain import BoardChain
from sensors.hand_eye_motion import motion_sentences, suspicions
from sensors.hand_eye_result import HandEye, PoseRow, held_row, of_block, placement, rms, standard
from sensors.hand_eye_scatter import held_scatter, scatter
from sensors.hand_eye_start import board_poses, nearest_turns, start_from_boards
from workbench.core.errors import InputError

__all__ = ["HandEye", "PoseRow", "hand_eye_from_views"]
KINDS = ("in-hand", "to-hand")


def hand_eye_from_views(views, board, camera, flange, kind="in-hand", camera_covariance=None,
                        pivot="board") -> HandEye:
    """Hand-eye, board and robot's pose error from views of one board.

    views: of each pose one with `index` (k,) and `pixels` (2, k); board: with `points` (3, N) mm;
    camera: Camera, or a calibration with `camera` and `covariance`; flange: (P, 4, 4) T_base_flange;
    kind: "in-hand", the camera on the flange and the board fixed in the base, or "to-hand", the
    board on the flange. camera_covariance (V, V) of `camera.values`: the camera is adjusted too,
    with this as prior; None: that of the calibration, or the camera is held. pivot: where the
    robot's errors of position and of rotation are taken as independent, "board": at the middle of
    the board, which makes the most likely hand-eye that of the least board scatter, or "flange".
    InputError for fewer than three poses, or numbers of poses and views that differ.
    """
    flange = _checked(views, flange, kind)
    camera, covariance = _camera(camera, camera_covariance)
    views = _same_way_round(views, board, camera, flange, kind)
    chain = _chain(views, board, camera, flange, kind, covariance)
    seen = board_poses(chain.board, chain.pixels, chain.pose, camera)
    start, misfit = start_from_boards(flange, seen, board.points, kind)
    chain = replace(chain, pivot=_pivot(pivot, chain, start, board.points))
    parameters = replace(chain.parameters, values=np.concatenate([start, np.zeros(chain.modes.shape[1])])).free("*")
    first = Variances(_noise(chain, seen), np.array([misfit, misfit / _reach(seen)]))
    doubts = suspicions(flange, seen, kind)
    most = 0 if doubts else len(flange) // 4  # poses read wrongly are not to be taken for blunders
    return _result(chain, board.points, find_blunders(chain, parameters, first, most), doubts)


def camera_prior(camera: Camera, focal: float = 0.002, centre: float = 0.005, distortion: float = 0.02) -> np.ndarray:
    """(V, V) covariance of a camera of which only values are known, as maker's sheets state them.

    focal: of fx and fy, as a share; centre: of cx and cy, as a share of the focal length;
    distortion: of every coefficient, times 10 for each further power of the radius squared.
    """
    steps = [1, 10, 0.1, 0.1, 100, 1, 10, 100][: len(camera.distortion)]
    sigma = [focal * camera.fx, focal * camera.fy, centre * camera.fx, centre * camera.fy]
    return np.diag(np.square([*sigma, *(distortion * step for step in steps)]))


def _checked(views, flange, kind):
    flange = np.asarray(flange, float)
    if kind not in KINDS:
        raise InputError(f"hand-eye: expected kind in-hand or to-hand, found '{kind}'; write one of them")
    if flange.ndim != 3 or flange.shape[1:] != (4, 4) or not np.isfinite(flange).all():
        raise InputError(f"hand-eye: expected finite flange poses (n, 4, 4), found shape {flange.shape}; correct them")
    if len(flange) != len(views):
        raise InputError(f"hand-eye: expected one flange pose a picture, found {len(flange)} poses and "
                         f"{len(views)} pictures; take out what has no partner")
    if len(flange) < 3:
        raise InputError(f"hand-eye: expected at least 3 poses, found {len(flange)}; take more, with turns about "
                         "two axes")
    return flange


def _camera(camera, covariance):
    """The camera, and its covariance or None."""
    if isinstance(camera, Camera):
        return camera, covariance
    known = getattr(camera, "covariance", None) if covariance is None else covariance
    size = len(camera.camera.values)
    return camera.camera, None if known is None else np.asarray(known)[:size, :size]


def _chain(views, board, camera, flange, kind, covariance):
    pose = np.concatenate([np.full(len(view.index), k) for k, view in enumerate(views)])
    points = np.concatenate([board.points[:, view.index] for view in views], 1)
    pixels = np.concatenate([view.pixels for view in views], 1).astype(float)
    points = points + _shifts(views, points, pixels, pose, camera)
    modes = np.zeros((len(camera.values), 0)) if covariance is None else _root(covariance)
    return BoardChain(kind, camera, points, pixels, flange, pose, np.zeros((len(flange), 6)), modes,
                      np.zeros((len(flange), 3)))


def _shifts(views, points, pixels, pose, camera):
    """(3, n) mm on the board: an ellipse's centre is not where the disc's centre projects."""
    radius = np.array([getattr(view, "radius_mm", 0.0) for view in views])[pose]
    if not radius.any():
        return np.zeros_like(points)
    turn = board_poses(points, pixels, pose, camera)
    placed = np.einsum("nij,jn->in", turn[pose, :3, :3], points) + turn[pose, :3, 3].T
    shift = centre_shift(placed, turn[pose, :3, 2].T, radius)
    return np.einsum("nji,jn->in", turn[pose, :3, :3], shift)


def _same_way_round(views, board, camera, flange, kind):
    """Views of a board that looks the same after a turn, relabelled so that it stands still in the base.

    The first start trusts the labels of most pictures; those that then lie nearer when turned, are.
    """
    turns = getattr(board, "turns", 1)
    if turns == 1:
        return views
    every = [[relabelled(view, board, turn) for view in views] for turn in range(turns)]
    chains = [_chain(labelled, board, camera, flange, kind, None) for labelled in every]
    seen = np.array([board_poses(c.board, c.pixels, c.pose, camera) for c in chains])
    best = nearest_turns(flange, seen, board.points, kind)
    return [every[turn][k] for k, turn in enumerate(best)]


def _pivot(pivot, chain, start, points):
    """(P, 3) mm, of every pose, in the base; on the flange for "to-hand"."""
    if pivot == "flange":
        return chain.flange[:, :3, 3] if chain.kind == "in-hand" else np.zeros((len(chain.flange), 3))
    board = placement(start[6:])
    return np.tile(board[:3, :3] @ points.mean(1) + board[:3, 3], (len(chain.flange), 1))


def _root(covariance):
    """(V, M) with root root' = covariance, without the directions that are known exactly."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    real = values > 1e-12
    return scale[:, None] * vectors[:, real] * np.sqrt(values[real])


def _noise(chain, seen):
    """px, of one coordinate, by which each board misses its own picture."""
    placed = np.einsum("nij,jn->in", seen[chain.pose, :3, :3], chain.board) + seen[chain.pose, :3, 3].T
    return max(float(np.sqrt(np.mean((chain.camera.project(placed) - chain.pixels) ** 2))), 1e-4)


def _reach(seen):
    return float(np.median(np.linalg.norm(seen[:, :3, 3], axis=1)))


def _result(chain, points, found, doubts):
    adjusted, left_out, blunders = found
    values, count = adjusted.parameters.values, len(chain.flange)
    used = ~np.isin(np.arange(count), blunders)
    exact = chain.evaluate(values).residual
    free = chain.with_families({"pose": adjusted.errors}).evaluate(values).residual
    held = np.empty_like(exact)
    for k in range(count):
        held[:, chain.pose == k] = chain.at(np.flatnonzero(chain.pose == k)).evaluate(left_out[k].values).residual
    return HandEye(
        kind=chain.kind, sensor=placement(values[:6]), covariance=of_block(adjusted, "sensor"),
        target=placement(values[6:12]), target_covariance=of_block(adjusted, "target"), camera=chain.camera_at(values),
        parameters=adjusted.parameters, std=standard(adjusted), noise=adjusted.variances.noise, unit="px",
        robot_sigma={"position_mm": float(adjusted.variances.spread[0]),
                     "rotation_deg": float(np.degrees(adjusted.variances.spread[1]))},
        fit={"rms_px": rms(exact, used[chain.pose]), "sensor_rms_px": rms(free, used[chain.pose]),
             **scatter(chain, points, values, used)},
        held_out={"rms_px": rms(held, used[chain.pose]), "folds": int(used.sum()),
                  **held_scatter(chain, points, left_out, used)},
        poses=tuple(held_row(k, chain, adjusted, exact, held, left_out[k], k in blunders) for k in range(count)),
        undetermined=(*motion_sentences(chain.flange[used], chain.kind), *_undetermined(adjusted.known)),
        suspicions=doubts, outcome=adjusted.outcome,
        converged=adjusted.converged, history=adjusted.history,
    )  # fmt: skip


def _undetermined(known):
    """Sentences on hand-eye and board; that a prior alone holds a part of the camera is no news of theirs."""
    groups = zip(known.groups(), known.sentences())
    return tuple(words for group, words in groups if not any(key.startswith("camera.") for key in group))
