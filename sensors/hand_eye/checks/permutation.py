"""Assignment of flange poses to images, found from quantities that need no hand-eye transform.

Flange and camera are one rigid body, so between two images both rotate by the same angle and shift by the same
distance along the rotation axis, whatever the hand-eye transform (Chen, CVPR 1991).
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from sensors.hand_eye.checks.pose_data import PoseData, PoseFit
from sensors.hand_eye.checks.pose_fit import fit_poses, possible_labels
from workbench.core.rigid import inverse, rotation_vector

_MAX_POSES = 60
_TRIED = 6
_ROUNDS = 6
# An image keeps its pose unless another fits it this many times better.
_BETTER = 3.0


def best_permutation(data: PoseData) -> tuple[np.ndarray, PoseFit] | None:
    """The assignment of poses to images that fits best, and its fit: image k has pose order[k].

    None where there are too many images for the search, or too few for it to mean anything.
    """
    if not 4 <= data.count <= _MAX_POSES:
        return None
    improved = [_improved(data, order) for order in _candidates(data)]
    order_and_fit = [row for row in improved if row is not None]
    return min(order_and_fit, key=lambda row: row[1].rms, default=None)


def permuted(data: PoseData, order: np.ndarray) -> PoseData:
    """The data with pose order[k] for image k."""
    return replace(data, moved=data.moved[order])


def reassigned(data: PoseData, fit: PoseFit, allowed: float) -> np.ndarray:
    """(P,) the pose nearest to each image under a fit, each pose once; an image within `allowed` mm keeps its own."""
    distance = _pair_distances(data, fit)
    current_distance = np.diag(distance)
    rows = np.flatnonzero(current_distance > allowed)
    order = np.arange(data.count)
    if len(rows) > 1:
        inner = distance[np.ix_(rows, rows)]
        images, poses = linear_sum_assignment(np.minimum(inner, 1e9) ** 2)
        order[rows[images]] = rows[poses]
    moves = order != np.arange(data.count)
    better = distance[np.arange(data.count), order] * _BETTER < current_distance
    return order if (better | ~moves).all() else np.arange(data.count)


def _candidates(data):
    """Orders (P,) that preserve the angles between images best, by assignment from two anchor images."""
    labels = possible_labels(data)[0]
    board = data.seen[labels, np.arange(data.count)]
    flange_motions = inverse(data.moved)[:, None] @ data.moved[None]
    camera_motions = board[:, None] @ inverse(board)[None]
    return _ranked_orders(_invariants(flange_motions), _invariants(camera_motions))


def _ranked_orders(flange, camera):
    count = flange.shape[1]
    first, second = _far_apart(camera[0])
    gap = np.abs(flange[0] - camera[0, first, second])
    np.fill_diagonal(gap, np.inf)
    pairs = np.argsort(gap, axis=None)[: max(2 * count, 40)]
    scored = []
    for c, d in zip(*np.unravel_index(pairs, gap.shape)):
        cost = sum(
            np.abs(camera[q, first][:, None] - flange[q, c][None])
            + np.abs(camera[q, second][:, None] - flange[q, d])
            for q in range(2)
        )
        cost[first], cost[:, c], cost[first, c] = 1e6, 1e6, 0
        cost[second], cost[:, d], cost[second, d] = 1e6, 1e6, 0
        order = linear_sum_assignment(cost)[1]
        scored.append((float(np.abs(camera - flange[:, order][:, :, order]).mean()), tuple(order)))
    return [np.array(order) for _, order in sorted(set(scored))[:_TRIED]]


def _invariants(relative):
    """(2, P, P) of relative motions (P, P, 4, 4): angle over 0.01 rad, and shift along the axis over 1 mm."""
    vector = rotation_vector(relative[..., :3, :3])
    angle = np.linalg.norm(vector, axis=-1)
    axis = vector / np.maximum(angle, 1e-9)[..., None]
    axial_shift = np.einsum("...k,...k->...", axis, relative[..., :3, 3])
    return np.stack([angle / 0.01, np.where(angle > 0.05, np.abs(axial_shift), 0.0)])


def _far_apart(angle):
    """Two images between which the camera rotated far, but not by a half turn."""
    usable = np.where(angle < np.pi / 0.01 * 0.9, angle, 0)
    return np.unravel_index(int(np.argmax(usable)), angle.shape)


def _improved(data, order):
    """The order after alternating between fit and nearest pose, and its fit."""
    for _ in range(_ROUNDS):
        fit = fit_poses(permuted(data, order))
        nearest = _assigned(data, fit)
        if (nearest == order).all():
            return order, fit
        order = nearest
    return order, fit_poses(permuted(data, order))


def _assigned(data, fit):
    return linear_sum_assignment(_pair_distances(data, fit) ** 2)[1]


def _pair_distances(data, fit):
    """(P, P) mm, RMS corner distance of image k with pose p under a fit, the label that fits best."""
    sensor = fit.sensor[0]
    board = fit.board[0]
    target_corners = board[:3, :3] @ data.corners + board[:3, 3:]
    outer = data.moved @ sensor
    best = np.full((data.count, data.count), np.inf)
    for seen in data.seen:
        local = seen[:, :3, :3] @ data.corners + seen[:, :3, 3:]
        seen_corners = np.einsum("pab,kbn->kpan", outer[:, :3, :3], local) + outer[None, :, :3, 3:]
        best = np.minimum(
            best,
            np.sqrt(((seen_corners - target_corners) ** 2).sum((2, 3)) / data.corners.shape[1]),
        )
    return best
