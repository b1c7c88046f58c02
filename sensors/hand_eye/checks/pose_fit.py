"""Hand-eye transform from board poses alone: a robust least-squares fit that is cheap enough to test alternatives.

Model: M_i X B_i = Z. For "in-hand" M_i is T_base_flange, X is T_flange_sensor and Z is T_base_board; for "to-hand"
M_i is T_flange_base, X is T_base_sensor and Z is T_flange_board. B_i is T_camera_board of image i alone.
The residual of image i is the distance, in mm, of the corners of its board from where the mean board has them: the
scatter of the estimated board pose.
"""

from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.checks.pose_data import Freedom, PoseData, PoseFit
from sensors.hand_eye.start import align, holding_rows, start_from_boards
from workbench.core.least_squares.linear_algebra import least_squares, solve_positive
from workbench.core.rigid import inverse, rotation_matrix, rotation_vector, transform

_STEPS = 40
_FEW_STEPS = 6
_CONVERGED = 1e-7
_DAMPING = 1e-9
_MOST_DAMPING = 1e4
# Cauchy weights: an image twice as far off as half of all counts a half.
_WIDTH, _REJECTED, _LAST_STEPS = 2.0, 2.0, 3


def fit_poses(data: PoseData, freedom: Freedom = Freedom(), starts=()) -> PoseFit:  # noqa: B008 (frozen)
    """The best fit from several starts.

    starts: (4, 4) sensor poses to start from besides the closed form of all pairs of images, which is tried with
    every labelling of the first image.
    """
    fits = [_fit_from(data, freedom, *start) for start in _starts(data, starts)]
    return min(fits, key=lambda fit: (fit.trimmed_rms, fit.rms))


def refit(data: PoseData, fit: PoseFit, freedom: Freedom, rough: bool = False) -> PoseFit:
    """A fit with more or other freedom, started from another fit; rough: a few steps, to rank alternatives."""
    sensor = fit.sensor[0]
    board = fit.board[0]
    state = _State(sensor, sensor, board, board, fit.scale)
    return _descend(data, state, fit.labels, freedom, _FEW_STEPS if rough else _STEPS)


def approximate_misfit(data: PoseData) -> float:
    """mm, of the closed form alone: what ranks many alternatives."""
    return min(
        align(data.moved, data.seen[labels, np.arange(data.count)])[1]
        for labels in possible_labels(data)
    )


def robust_starts(data: PoseData) -> list[np.ndarray]:
    """Start values (4, 4) of the sensor pose, one per labelling, from many closed forms against wrong images."""
    images = np.arange(data.count)
    sensor_poses = []
    for labels in possible_labels(data):
        boards = data.seen[labels, images]
        values = start_from_boards(data.moved, boards, data.corners, "in-hand")[0]
        sensor_poses.append(transform(rotation_matrix(values[3:6]), values[:3]))
    return sensor_poses


def possible_labels(data: PoseData) -> np.ndarray:
    """(T, P) labellings, one for each label of the first image.

    The relative rotation of flange and camera between two images has the same angle whatever the hand-eye transform
    (Chen, CVPR 1991); the other images take the label whose angle agrees best.
    """
    labellings, count = data.seen.shape[:2]
    if labellings == 1:
        return np.zeros((1, count), int)
    flange = rotation_vector(data.moved[:1, :3, :3].swapaxes(1, 2) @ data.moved[:, :3, :3])
    alpha = np.linalg.norm(flange, axis=1)
    found = []
    for first in range(labellings):
        relative = data.seen[first, 0, :3, :3] @ data.seen[..., :3, :3].swapaxes(-1, -2)
        beta = np.linalg.norm(rotation_vector(relative), axis=-1)
        labels = np.abs(beta - alpha).argmin(0)
        labels[0] = first
        found.append(labels)
    return np.array(found)


@dataclass(frozen=True)
class _State:
    sensor: np.ndarray
    later_sensor: np.ndarray
    board: np.ndarray
    later_board: np.ndarray
    scale: float = 1.0


def _starts(data, starts):
    images = np.arange(data.count)
    for labels in possible_labels(data):
        yield align(data.moved, data.seen[labels, images])[0], labels, 1.0
        for sensor in starts:
            yield sensor, labels, 1.0


def _fit_from(data, freedom, sensor, labels, scale) -> PoseFit:
    seen = data.seen[labels, np.arange(data.count)]
    if freedom.scale:
        sensor, scale = _closed_form_scale(data.moved, seen, sensor)
    moved = scaled(data.moved, scale)
    board = _middle_pose(moved @ sensor @ seen, data.corners)
    state = _State(sensor, sensor, board, board, scale)
    fit = _descend(data, state, labels, freedom)
    if len(data.seen) == 1:
        return fit
    better = _relabel(data, fit)
    return fit if (better == fit.labels).all() else _descend(data, _state_of(fit), better, freedom)


def _state_of(fit):
    return _State(fit.sensor[0], fit.sensor[-1], fit.board[0], fit.board[-1], fit.scale)


def scaled(moved: np.ndarray, scale: float) -> np.ndarray:
    """Poses (P, 4, 4) with translations times `scale`."""
    return transform(moved[:, :3, :3], scale * moved[:, :3, 3])


def _closed_form_scale(moved, seen, sensor):
    """Sensor pose and scale of the flange positions, linear least squares at the rotation of `sensor`.

    (R_A - 1) t_X + s t_A = R_X t_B of all relative motions A of the flange and B of the camera.
    """
    i, j = np.triu_indices(len(moved), 1)
    flange = inverse(moved[j]) @ moved[i]
    camera = seen[j] @ inverse(seen[i])
    rows = (flange[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    size = max(float(np.abs(flange[:, :3, 3]).max()), 1e-12)
    design = np.column_stack([rows, flange[:, :3, 3].reshape(-1) / size])
    constraint = np.column_stack([holding_rows(len(rows)), np.zeros(3)])
    right = (camera[:, :3, 3] @ sensor[:3, :3].T).reshape(-1)
    solution = least_squares(np.concatenate([design, constraint]), np.r_[right, np.zeros(3)], 1e-9)
    scale = float(solution[3]) / size
    if not np.isfinite(scale) or scale <= 0:
        return sensor, 1.0
    return transform(sensor[:3, :3], solution[:3]), scale


def _middle_pose(placed, corners):
    """That board (4, 4) of (P, 4, 4) whose corners are nearest to those of all others."""
    where = placed[:, :3, :3] @ corners + placed[:, :3, 3:]
    difference = where[:, None] - where[None]
    distance = np.sqrt((difference**2).sum(2).mean(2))
    median_distance = np.median(distance, axis=1)
    return placed[int(np.argmin(median_distance))]


def _relabel(data, fit):
    """(P,) labels under which each image's board lies nearest to the mean board of the fit."""
    distances = [
        replace_labels(data, fit, np.full(data.count, labelling))
        for labelling in range(len(data.seen))
    ]
    return np.argmin(distances, axis=0)


def replace_labels(data: PoseData, fit: PoseFit, labels: np.ndarray) -> np.ndarray:
    """(P,) mm, RMS corner distances of the images under other labels, with the fit's parameters."""
    return _distances(_residual(data, _state_of(fit), labels, fit.freedom))


def _descend(data, state, labels, freedom, steps=_STEPS) -> PoseFit:
    """Levenberg-Marquardt with Cauchy weights whose width follows the median distance."""
    damping = 1e-3
    cost = np.inf
    weight = np.ones(data.count)
    rejected = False
    for step in range(steps):
        if not rejected:
            residual = _residual(data, state, labels, freedom)
            rows = _rows(data, state, labels, freedom)
            if step % 3 == 0:
                weight = _weights(_distances(residual))
            cost = float((weight * _distances(residual) ** 2).sum())
            normal, pull = _normal(weight, rows, residual)
        diagonal = np.diag(normal) + _DAMPING * np.trace(normal)
        change = -solve_positive(normal + damping * np.diag(diagonal), pull)
        tried = _moved_state(state, change, freedom)
        new = float((weight * _distances(_residual(data, tried, labels, freedom)) ** 2).sum())
        rejected = new > cost
        if rejected:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
            continue
        small = cost - new < _CONVERGED * cost
        state, damping = tried, max(damping / 10, 1e-12)
        if small and step > 3:
            break
    if steps == _STEPS:
        state = _reweighted(data, state, labels, freedom)
    return _finished(data, state, labels, freedom)


def _reweighted(data, state, labels, freedom):
    """Plain least squares of the images that the robust fit does not reject: more precise (Rousseeuw & Leroy 1987)."""
    is_inlier = _kept(_distances(_residual(data, state, labels, freedom)))
    for _ in range(_LAST_STEPS):
        residual = _residual(data, state, labels, freedom)
        normal, pull = _normal(is_inlier, _rows(data, state, labels, freedom), residual)
        damped = normal + _DAMPING * np.diag(np.diag(normal))
        tried = _moved_state(state, -solve_positive(damped, pull), freedom)
        after = _distances(_residual(data, tried, labels, freedom))
        if (is_inlier * after**2).sum() >= (is_inlier * _distances(residual) ** 2).sum():
            break
        state = tried
    return state


def _kept(distance):
    """(P,) 1.0 for images that count in the end."""
    return (distance <= _REJECTED * _WIDTH * max(float(np.median(distance)), 1e-9)).astype(float)


def _weights(distance):
    width = _WIDTH * max(float(np.median(distance)), 1e-9)
    return 1 / (1 + (distance / width) ** 2)


def _distances(residual):
    """(P,) RMS over the corners."""
    return np.sqrt((residual**2).sum((1, 2)) / residual.shape[2])


def _normal(weight, rows, residual):
    """Normal matrix and gradient of the weighted squares."""
    flat = rows.reshape(*rows.shape[:2], -1)
    scaled_rows = flat * np.sqrt(weight)[:, None, None]
    stacked = scaled_rows.transpose(1, 0, 2).reshape(flat.shape[1], -1)
    right = (residual.reshape(len(residual), -1) * np.sqrt(weight)[:, None]).ravel()
    return stacked @ stacked.T, stacked @ right


def _finished(data, state, labels, freedom) -> PoseFit:
    residual = _residual(data, state, labels, freedom)
    fit = PoseFit(
        np.stack([state.sensor, state.later_sensor]),
        np.stack([state.board, state.later_board]),
        state.scale,
        np.nan,
        _distances(residual),
        labels,
        freedom,
    )
    if not freedom.scale:
        return fit
    rows = _rows(data, state, labels, freedom)
    return replace(fit, scale_std=_scale_std(residual, rows, fit.distance))


def _scale_std(residual, rows, distance):
    """1 sigma of the logarithm of the scale, the last parameter: one-step jackknife over the images.

    Efron & Stein, Ann. Stat. 9 (1981). The six errors of a pose need be neither equal nor independent.
    """
    weight = _kept(distance)
    flat = rows.reshape(*rows.shape[:2], -1)
    pulls = weight[:, None] * np.einsum("ikm,im->ik", flat, residual.reshape(len(residual), -1))
    blocks = weight[:, None, None] * (flat @ flat.transpose(0, 2, 1))
    normal = blocks.sum(0)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    reduced_normal = (normal - blocks) / np.outer(size, size)
    changes = solve_positive(reduced_normal, (pulls / size)[..., None])
    change = changes[:, -1, 0] / size[-1]
    count = len(change)
    return float(np.sqrt((count - 1) / count * ((change - change.mean()) ** 2).sum()))


def _poses(data, state, labels, freedom):
    """Flange, sensor and board (P, 4, 4) of each image, and the corners (P, 3, 4) in its camera frame, mm."""
    late_sensor = _later(data.count, freedom.sensor_from)[:, None, None]
    late_board = _later(data.count, freedom.board_from)[:, None, None]
    seen = data.seen[labels, np.arange(data.count)]
    local = seen[:, :3, :3] @ data.corners + seen[:, :3, 3:]
    sensor = np.where(late_sensor, state.later_sensor, state.sensor)
    return (
        scaled(data.moved, state.scale),
        sensor,
        np.where(late_board, state.later_board, state.board),
        local,
    )


def _residual(data, state, labels, freedom):
    """(P, 3, 4) mm at the corners."""
    moved, sensor, board, local = _poses(data, state, labels, freedom)
    outer = moved @ sensor
    seen_corners = outer[:, :3, :3] @ local + outer[:, :3, 3:]
    rotated_corners = board[:, :3, :3] @ data.corners
    return seen_corners - rotated_corners - board[:, :3, 3:]


def _rows(data, state, labels, freedom):
    """(P, F, 3, 4) derivatives of the residual by small motions of sensor and board, and the scale's logarithm."""
    moved, sensor, board, local = _poses(data, state, labels, freedom)
    by_sensor = _motion_rows((moved @ sensor)[:, :3, :3], local)
    by_board = -_motion_rows(board[:, :3, :3], np.broadcast_to(data.corners, local.shape))
    late_sensor = _later(data.count, freedom.sensor_from)[:, None, None, None]
    late_board = _later(data.count, freedom.board_from)[:, None, None, None]
    rows = [by_sensor * ~late_sensor, by_board * ~late_board]
    if freedom.sensor_from is not None:
        rows.append(by_sensor * late_sensor)
    if freedom.board_from is not None:
        rows.append(by_board * late_board)
    if freedom.scale:
        shift = data.moved[:, :3, 3] * state.scale
        rows.append(np.broadcast_to(shift[:, None, :, None], (data.count, 1, *data.corners.shape)))
    return np.concatenate(rows, 1)


def _later(count, first):
    return np.zeros(count, bool) if first is None else np.arange(count) >= first


def _motion_rows(rotation, points):
    """(P, 6, 3, n) derivative of R (p + v + w x p) by v and w, for R (P, 3, 3) and p (P, 3, n)."""
    shift = np.broadcast_to(rotation.swapaxes(1, 2)[..., None], (*rotation.shape, points.shape[2]))
    x, y, z = points.swapaxes(0, 1)
    zero = np.zeros_like(x)
    crossed = np.stack(
        [np.stack(row, 1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], 1
    )
    return np.concatenate([shift, rotation[:, None] @ crossed], 1)


def _moved_state(state, change, freedom) -> _State:
    pose_changes = [change[:6], change[6:12]]
    offset = 12
    later = []
    for first in (freedom.sensor_from, freedom.board_from):
        later.append(change[offset : offset + 6] if first is not None else None)
        offset += 6 if first is not None else 0
    scale = (
        state.scale * float(np.exp(np.clip(change[-1], -1, 1))) if freedom.scale else state.scale
    )
    sensor = _nudged(state.sensor, pose_changes[0])
    board = _nudged(state.board, pose_changes[1])
    return _State(
        sensor,
        sensor if later[0] is None else _nudged(state.later_sensor, later[0]),
        board,
        board if later[1] is None else _nudged(state.later_board, later[1]),
        scale,
    )


def _nudged(pose, motion):
    from scipy.spatial.transform import Rotation

    return pose @ transform(Rotation.from_rotvec(motion[3:]).as_matrix(), motion[:3])
