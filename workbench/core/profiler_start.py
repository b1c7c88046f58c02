"""A hand-eye of a profiler without a guess, from circles of one ball at several flange poses.

A circle says how far the light plane is from the ball's centre, not on which side. That and the unknown rotation make
many valleys; they are all tried: for each of a fixed set of rotations the rest is linear, and the best of them go down
into their valley by least squares. The hand-eye then says on which side of the plane the ball is in each pose.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.rigid import left_jacobian, rotation_matrix, rotation_vector, skew

_BEST = 24
_THINNED_AFTER, _LEAST_VALLEYS = (12, 30), 4
_LEAST_FALL, _MOST_DAMPING = 1e-9, 1e8
_QUICK = {"best": 4, "steps": 12}
_FEWEST_OF_BALL = 3


@dataclass(frozen=True)
class Start:
    """`values` (10,): hand-eye, ball, radius; `rms` mm a circle's number; `second` the rms of the next valley."""

    values: np.ndarray
    rms: float
    second: float


@lru_cache
def start_rotations() -> np.ndarray:
    """(480, 3, 3) rotations, no rotation further than about 20 degrees from one of them."""
    twist = Rotation.from_rotvec(
        np.concatenate(
            [
                np.zeros((1, 3)),
                0.45
                * np.array(
                    [
                        [1, 1, 1],
                        [1, -1, -1],
                        [-1, 1, -1],
                        [-1, -1, 1],
                        [1.2, 0, 0],
                        [0, 1.2, 0],
                        [0, 0, 1.2],
                    ]
                ),
            ]
        )
    )
    icosahedral = Rotation.create_group("I")
    return np.concatenate([(icosahedral * rotation).as_matrix() for rotation in twist])


def find_start(
    circles: np.ndarray, flange: np.ndarray, radius: float | None, best: int = _BEST, steps=200
) -> Start:
    """The deepest of the `best` most promising valleys, of `steps` evaluations each.

    circles (3, P): x, z of the centre and radius, mm; flange (P, 4, 4) T_base_flange; radius of the
    ball, mm, None where unknown.
    """
    known = radius if radius is not None else 1.02 * circles[2].max()
    values = _linear(circles, flange, known)
    cost = (_residual(values, circles, flange, known if radius is None else radius) ** 2).sum(
        (1, 2)
    )
    promising = np.argsort(cost, kind="stable")[:best]
    bottoms, costs = _descend(values[promising], circles, flange, radius, steps)
    others = [other for x, other in zip(bottoms, costs) if _is_other_minimum(x, bottoms[0])]
    second = min(others, default=np.inf)
    rms, second_rms = np.sqrt(np.array([costs[0], second]) / circles.size)
    return Start(bottoms[0], float(rms), float(second_rms))


def circle_distances(
    values: np.ndarray, circles: np.ndarray, flange: np.ndarray, radius: float
) -> np.ndarray:
    """(P,) mm by which circles (3, P) are off at values (10,) of `Start`; flange (P, 4, 4), radius of the ball mm."""
    return np.linalg.norm(_residual(values[None], circles, flange, radius)[0], axis=0)


def _linear(circles, flange, radius):
    """(S, 10) for every rotation the place of profiler and ball that fit the centres in the plane best.

    With the rotation X: x = X_x . (R'(c - p) - t) and the same for z: linear in c and t.
    """
    inverse_rotation = np.swapaxes(flange[:, :3, :3], 1, 2)
    home = (inverse_rotation @ flange[:, :3, 3, None])[..., 0]  # R' p
    axes = start_rotations()[:, :, [0, 2]].transpose(
        0, 2, 1
    )  # (S, 2, 3) the plane's axes in the flange
    rows = np.concatenate(
        [
            np.broadcast_to(-axes[:, None], (len(axes), len(flange), 2, 3)),
            np.einsum("saj,pjk->spak", axes, inverse_rotation),
        ],
        -1,
    )
    right = circles[:2].T + np.einsum("saj,pj->spa", axes, home)
    rows = rows.reshape(len(axes), -1, 6)
    right = right.reshape(len(axes), -1, 1)
    size = np.sqrt(
        (rows**2).sum(1, keepdims=True).max(0)
    )  # what poses that never rotate leave open stays small
    normal = (rows / size).transpose(0, 2, 1) @ (rows / size) + 1e-9 * np.eye(6)
    solved = solve_positive(normal, (rows / size).transpose(0, 2, 1) @ right)[..., 0] / size[:, 0]
    vectors = rotation_vector(start_rotations())
    return np.concatenate(
        [solved[:, :3], vectors, solved[:, 3:], np.full((len(axes), 1), radius)], 1
    )


def _residual(values, circles, flange, radius):
    """(S, 3, P) mm at values (S, 10): place of the circle in the plane, and distance from the ball's surface."""
    sensor_place = values[:, None, :3]
    sensor_rotation = values[:, 3:6]
    ball = values[:, None, 6:9]
    flange_inverse = np.swapaxes(flange[:, :3, :3], 1, 2)
    from_flange = ball - flange[:, :3, 3]
    in_flange = np.einsum("pij,spj->spi", flange_inverse, from_flange)
    from_sensor = in_flange - sensor_place
    centre = np.einsum("spi,sij->spj", from_sensor, rotation_matrix(sensor_rotation))
    x, y, z = np.moveaxis(centre, -1, 0)
    size = values[:, 9:] if radius is None else radius
    off_surface = (y**2 + circles[2] ** 2 - size**2) / (2 * size)
    return np.stack([x - circles[0], z - circles[1], off_surface], 1)


def _descend(values, circles, flange, radius, steps):
    """Values (S, 10) at the bottoms of the valleys, and the sums of squares (S,) there: Levenberg-Marquardt in all
    valleys at once. The shallowest two thirds are left after the first steps; at least `_LEAST_VALLEYS` go on."""
    free = 9 + (radius is None)
    scale = np.array([100.0] * 3 + [0.3] * 3 + [100.0] * 3 + [1.0])[:free]
    values = values.copy()
    cost = (_residual(values, circles, flange, radius) ** 2).sum((1, 2))
    damping = np.full(len(values), 1e-3)
    is_moving = np.ones(len(values), bool)
    for step in range(steps):
        if step in _THINNED_AFTER:
            deepest = np.argsort(cost, kind="stable")[: max(len(cost) // 3, _LEAST_VALLEYS)]
            values, cost, damping = values[deepest], cost[deepest], damping[deepest]
            is_moving = is_moving[deepest]
        active = np.flatnonzero(is_moving)
        if not active.size:
            break
        moved = values[active]
        moved[:, :free] += scale * _move(moved, circles, flange, radius, damping[active], scale)
        new_cost = (_residual(moved, circles, flange, radius) ** 2).sum((1, 2))
        is_better = new_cost < cost[active]
        better = active[is_better]
        falls = 1 - new_cost[is_better] / np.maximum(cost[better], 1e-300)
        values[better], cost[better] = moved[is_better], new_cost[is_better]
        damping[active] *= np.where(is_better, 0.2, 8.0)
        is_moving[better] = falls > _LEAST_FALL
        is_moving[active] &= damping[active] < _MOST_DAMPING
    order = np.argsort(cost, kind="stable")
    return values[order], cost[order]


def _move(values, circles, flange, radius, damping, scale):
    """(S, F) scaled Levenberg-Marquardt steps at values (S, 10)."""
    slope = _slope(values, circles, flange, radius)[..., : len(scale)] * scale
    slope = slope.reshape(len(values), -1, len(scale))
    deviation = _residual(values, circles, flange, radius).reshape(len(values), -1)
    normal = slope.transpose(0, 2, 1) @ slope
    size = np.maximum(np.einsum("sii->si", normal), 1e-9)
    normal = normal + damping[:, None, None] * np.eye(len(scale)) * size[:, None, :]
    gradient = np.einsum("snf,sn->sf", slope, deviation)
    return -np.linalg.solve(normal, gradient[..., None])[..., 0]


def _slope(values, circles, flange, radius):
    """(S, 3, P, 10) derivative of `_residual` at values (S, 10)."""
    sensor_place = values[:, None, :3]
    sensor_rotation = values[:, 3:6]
    rotation = rotation_matrix(sensor_rotation)
    flange_inverse = np.swapaxes(flange[:, :3, :3], 1, 2)
    from_flange = values[:, None, 6:9] - flange[:, :3, 3]
    in_flange = np.einsum("pij,spj->spi", flange_inverse, from_flange)
    centre = (in_flange - sensor_place) @ rotation
    slope = np.zeros((len(values), len(flange), 3, 10))
    inverse_rotation = np.swapaxes(rotation, 1, 2)
    slope[..., :3] = -inverse_rotation[:, None]
    slope[..., 3:6] = skew(centre) @ left_jacobian(-sensor_rotation)[:, None]
    slope[..., 6:9] = inverse_rotation[:, None] @ flange_inverse
    # y, out of the profile's plane, enters by the radius of the circle that the plane cuts
    size = values[:, 9:] if radius is None else radius
    y = centre[..., 1]
    slope[:, :, 1] *= (y / size)[..., None]
    slope[:, :, 1, 9] = -(y**2 + circles[2] ** 2 + size**2) / (2 * size**2)
    return slope[:, :, [0, 2, 1]].transpose(0, 2, 1, 3)


def _is_other_minimum(values, top):
    """Whether this is another hand-eye and not the same valley: another rotation by more than a degree."""
    difference = rotation_matrix(values[3:6]).T @ rotation_matrix(top[3:6])
    return np.linalg.norm(rotation_vector(difference)) > 0.02


def algebraic_circles(flat: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    """(3, count) mm: x, z of the centre and radius of the circle through the points (2, n) of each label from 0.

    Kasa, IEEE Trans. Instrum. Meas. 25 (1976) 8: linear, about the mean point of each label; as good as a start needs.
    """
    number = np.bincount(label, minlength=count)
    middle = np.stack([np.bincount(label, row, count) / number for row in flat])
    x, z = flat - middle[:, label]
    rows = [x, z, np.ones_like(x)]
    target = (x**2 + z**2) / 2
    x0, z0, level = solved_by_label(rows, target, label, count).T
    return np.stack([x0 + middle[0], z0 + middle[1], np.sqrt(2 * level + x0**2 + z0**2)])


def solved_by_label(rows, target: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    """(count, len(rows)) least-squares coefficients of rows (n,) that make the target (n,), of each label from 0."""
    normal = np.array([[np.bincount(label, p * q, count) for q in rows] for p in rows])
    right = np.stack([np.bincount(label, p * target, count) for p in rows], -1)
    return solve_positive(np.moveaxis(normal, -1, 0), right[..., None])[..., 0]


def signed_centres(
    circles: np.ndarray,
    label: np.ndarray,
    flange: np.ndarray,
    radii: np.ndarray,
    is_quick: bool = False,
) -> np.ndarray:
    """Centres (3, P) mm of balls in the profiler's frame, nan where unknown, from circles that the light plane cuts out
    of them, at flange poses that may have small errors.

    circles (3, P): x, z of the centre and radius, mm; label (P,) number of each one's ball from 0; flange (P, 4, 4)
    T_base_flange; radii (K,) of the balls, mm. The circle says |y| of the centre, the hand-eye of the ball that most
    profiles show says its sign; other balls then need three profiles. is_quick: fewer valleys and steps.
    """
    largest_label = np.bincount(label, minlength=len(radii)).argmax()
    is_largest = label == largest_label
    effort = _QUICK if is_quick else {}
    start = find_start(
        circles[:, is_largest], flange[is_largest], float(radii[largest_label]), **effort
    )
    rotation = rotation_matrix(start.values[3:6])
    place = start.values[:3]
    sensor_rotation = flange[:, :3, :3] @ rotation
    sensor_place = flange[:, :3, :3] @ place + flange[:, :3, 3]
    centres = np.full((3, len(label)), np.nan)
    for ball, radius in enumerate(radii):
        rows = np.flatnonzero(label == ball)
        if len(rows) < _FEWEST_OF_BALL:
            continue
        predicted = _seen_centres(circles[:, rows], sensor_rotation[rows], sensor_place[rows])
        distance = np.sqrt(np.maximum(radius**2 - circles[2, rows] ** 2, 0.0))
        centres[:, rows] = circles[0, rows], np.copysign(distance, predicted[1]), circles[1, rows]
    return centres


def _seen_centres(circles, rotation, place):
    """(3, P) centre of a ball that stands still, in the profiler's frame, from its x and z alone: linear."""
    rows = rotation[:, :, [0, 2]].transpose(0, 2, 1).reshape(-1, 3)
    shift = (rotation.transpose(0, 2, 1) @ place[..., None])[:, [0, 2], 0]
    ball = np.linalg.lstsq(rows, (circles[:2].T + shift).ravel(), rcond=None)[0]
    return (rotation.transpose(0, 2, 1) @ (ball - place)[..., None])[..., 0].T
