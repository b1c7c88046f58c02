"""Hand-eye of a laser profiler from profiles of one ball that stands still.

Every profile cuts the ball in a circle: its centre says where the ball is within the light plane,
its radius how far the plane passes from the ball's centre, on either side.
"""

from dataclasses import replace

import numpy as np

from sensors.hand_eye.adjust import LEAST_NOISE, Variances, find_blunders
from sensors.hand_eye.chain import BallChain
from sensors.hand_eye.circles import Circles, find_circles
from sensors.hand_eye.motion import motion, profile_suspicions
from sensors.hand_eye.poses import checked_flange
from sensors.hand_eye.result import HandEye, held_row, of_block, placement, rms
from sensors.hand_eye.uncertainty.parameter_covariance import parameter_covariance
from workbench.core.errors import InputError
from workbench.core.profiler_start import find_start

_MIN_POSES = 4
_AMBIGUOUS_RATIO = 1.2  # another hand-eye whose circles fit hardly worse is as good an answer
_SCALE = "sensor.range_scale"


def hand_eye_from_profiles(
    points,
    pose,
    flange,
    radius=None,
    range_scale=None,
    names=None,
) -> HandEye:
    """Hand-eye, ball and, where `radius` is None, its radius, from profiles at flange poses, without a guess.

    names: what each pose is called in sentences, None: "pose 0", "pose 1", ...
    points: (3, n) mm, (x, 0, z) in the profiler's frame, rows with nan are dropped; pose (n,) int,
    row of `flange` (P, 4, 4) T_base_flange of each point. The adjustment minimises the RMS
    distance of all points from the ball; sigmas are those of the variance components. range_scale:
    whether the scale of the profiler's z is free; None: where that lowers the error of held-out poses.
    `fit` and `held_out`: `rms_mm` over points of their distance from the ball, robot held exact;
    `pose_rms_mm` of the poses' RMS. InputError for fewer than four poses, or profiles without an arc.
    """
    points, pose, flange = _checked(points, pose, flange)
    flat = points[[0, 2]]
    names = [f"pose {k}" for k in range(len(flange))] if names is None else names
    circles = find_circles(flat, pose, names, radius)
    start = find_start(np.concatenate([circles.centre, [circles.radius]]), flange, radius)
    chain = _chain(flat, pose, flange, circles, start)
    values = np.append(start.values, 0.0)
    values[9] = start.values[9] if radius is None else radius
    parameters = replace(chain.parameters, values=values).free("*").fix(_SCALE)
    if radius is not None:
        parameters = parameters.fix("target.radius")
    first = Variances(
        max(_noise(circles), LEAST_NOISE), max(start.rms, 1e-3) * np.array([1.0, 0.2])
    )
    suspicions = profile_suspicions(
        flange, names, np.concatenate([circles.centre, [circles.radius]]), radius, start.rms
    )
    max_blunders = (
        0 if suspicions else len(flange) // 4
    )  # poses read wrongly are not to be taken for blunders
    found, notes = _best(chain, parameters, first, range_scale, max_blunders)
    return _result(chain, found, (*circles.why, *notes), start, circles, suspicions)


def _checked(points, pose, flange):
    points = np.asarray(points, float)
    pose = np.asarray(pose)
    if points.ndim != 2 or len(points) != 3 or pose.shape != points.shape[1:]:
        raise InputError(
            f"profiles: expected points (3, n) and one pose number a point, found {points.shape} and "
            f"{pose.shape}; correct them"
        )
    flange = checked_flange(flange, "profiles")
    finite = np.isfinite(points).all(0)
    points = points[:, finite]
    pose = pose[finite].astype(int)
    if len(flange) < _MIN_POSES:
        raise InputError(
            f"profiles: expected at least {_MIN_POSES} poses, found {len(flange)}; take more, with turns "
            "about two axes"
        )
    empty = np.setdiff1d(np.arange(len(flange)), pose)
    if len(empty) or pose.min() < 0 or pose.max() >= len(flange):
        raise InputError(
            f"profiles: expected points at every one of {len(flange)} poses, found none at pose "
            f"{empty[0] if len(empty) else pose.max()}; take the pose out or number poses from 0"
        )
    return points, pose, flange


def _chain(flat, pose, flange, circles: Circles, start) -> BallChain:
    used = circles.used
    # from a distance within the plane to one from the ball, which is to be the same for all
    relative = (start.values[9] / circles.radius)[pose[used]]
    return BallChain(
        flat[:, used],
        float(start.values[9]),
        flange,
        pose[used],
        np.zeros((len(flange), 4)),
        relative,
    )


def _best(chain, parameters, first, range_scale, max_blunders):
    """The better result of `find_blunders`, with or without the scale of z, and the sentences on it."""
    without_scale = (
        None if range_scale else find_blunders(chain, parameters, first, max_blunders, equal=True)
    )
    if range_scale is False:
        return without_scale, ()
    start = (
        parameters
        if without_scale is None
        else replace(parameters, values=without_scale[0].parameters.values)
    )
    scaled = find_blunders(chain, start.free(_SCALE), first, max_blunders, equal=True)
    if without_scale is None:
        return scaled, ()
    before, after = (_predicted(chain, found) for found in (without_scale, scaled))
    scale = scaled[0].parameters[_SCALE]
    words = (
        f"scale error of the profiler's z {scale:+.2%} (positive: z is measured too long): held-out {before:.3g} -> "
        f"{after:.3g} mm"
    )
    return (
        (scaled, (f"{words}, kept",))
        if after < before
        else (without_scale, (f"{words}, not retained by cross-validation",))
    )


def _predicted(chain, found):
    """RMS distance, mm, of the poses from the ball, each with everything taken from the others."""
    return float(
        np.sqrt(
            np.mean(
                [
                    (_of_pose(chain, k).distances(pose.values) ** 2).mean()
                    for k, pose in found[1].items()
                ]
            )
        )
    )


def _of_pose(chain, pose):
    return chain.at(np.flatnonzero(chain.pose == pose))


def _result(chain, found, notes, start, circles, suspicions):
    adjusted, left_out, blunders = found
    values = adjusted.parameters.values
    count = len(chain.flange)
    exact = chain.distances(values)[None]
    held_out = np.empty_like(exact)
    for k in range(count):
        held_out[0, chain.pose == k] = _of_pose(chain, k).distances(left_out[k].values)
    used = ~np.isin(chain.pose, blunders)
    rows = tuple(
        held_row(k, chain, adjusted, exact, held_out, left_out[k], k in blunders)
        for k in range(count)
    )
    inlier_rows = [row for row in rows if not row.outlier]
    known = parameter_covariance(adjusted, motion(chain.flange, "profiles"))
    return HandEye(
        kind="profiles",
        sensor=placement(values[:6]),
        covariance=of_block(adjusted, known, "sensor"),
        target=placement(values[6:9]),
        target_covariance=of_block(adjusted, known, "target"),
        parameters=adjusted.parameters,
        std=known.std(),
        noise=_noise(circles),
        unit="mm",
        robot_sigma={
            "position_mm": float(adjusted.variances.spread[0]),
            "radius_mm": float(adjusted.variances.spread[1]),
        },
        fit={
            "rms_mm": rms(exact, used),
            "pose_rms_mm": _root_mean_square(row.residual for row in inlier_rows),
            "points": int(used.sum()),
        },
        held_out={
            "rms_mm": rms(held_out, used),
            "pose_rms_mm": _root_mean_square(row.held_out for row in inlier_rows),
            "folds": len(inlier_rows),
        },
        poses=rows,
        radius=float(values[9]),
        range_scale=float(values[10]),
        notes=notes,
        undetermined=(*_ambiguous(start), *known.sentences),
        suspicions=suspicions,
        outcome=adjusted.outcome,
        converged=adjusted.converged,
        history=adjusted.history,
    )


def _noise(circles):
    """mm, RMS over profiles of the points' distances from their own circle."""
    return float(np.sqrt((circles.rms**2).mean()))


def _root_mean_square(values):
    return float(np.sqrt(np.mean([value**2 for value in values])))


def _ambiguous(start):
    if start.second > _AMBIGUOUS_RATIO * start.rms:
        return ()
    return (
        f"a hand-eye turned quite otherwise fits these circles as well ({start.second:.3g} against {start.rms:.3g} "
        "mm): take more poses, with the light plane on both sides of the ball's centre",
    )
