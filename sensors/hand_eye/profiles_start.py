"""A hand-eye of a profiler without a guess: from circles of one ball at several flange poses.

A circle says how far the light plane is from the ball's centre, not on which side. That and the
unknown rotation make many valleys; they are all tried: for each of a fixed set of rotations the rest is
linear, and the best of them go down into their valley by least squares.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.rigid import left_jacobian, rotation_matrix, rotation_vector, skew

_BEST = 24


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
    found = [
        _descend(values[k], circles, flange, radius, steps)
        for k in np.argsort(cost, kind="stable")[:best]
    ]
    found.sort(key=lambda pair: pair[1])
    top = found[0]
    other = [cost for x, cost in found if _elsewhere(x, top[0])]
    count = circles.size
    return Start(
        top[0], float(np.sqrt(top[1] / count)), float(np.sqrt(min(other, default=np.inf) / count))
    )


def circle_distances(
    values: np.ndarray, circles: np.ndarray, flange: np.ndarray, radius: float
) -> np.ndarray:
    """(P,) mm by which circles (3, P) are off at values (10,) of `Start`; flange (P, 4, 4), radius of the ball mm."""
    return np.linalg.norm(_residual(values[None], circles, flange, radius)[0], axis=0)


def _linear(circles, flange, radius):
    """(S, 10) for every rotation the place of profiler and ball that fit the centres in the plane best.

    With the rotation X: x = X_x . (R'(c - p) - t) and the same for z: linear in c and t.
    """
    back = np.swapaxes(flange[:, :3, :3], 1, 2)
    home = (back @ flange[:, :3, 3, None])[..., 0]  # R' p
    axes = start_rotations()[:, :, [0, 2]].transpose(
        0, 2, 1
    )  # (S, 2, 3) the plane's axes in the flange
    rows = np.concatenate(
        [
            np.broadcast_to(-axes[:, None], (len(axes), len(flange), 2, 3)),
            np.einsum("saj,pjk->spak", axes, back),
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
    """Values (10,) at the bottom of the valley, and the sum of squares there."""
    from scipy.optimize import least_squares

    free = 9 + (radius is None)
    scale = np.array([100.0] * 3 + [0.3] * 3 + [100.0] * 3 + [1.0])[:free]

    def whole(x):
        return np.concatenate([x * scale, values[free:]])

    def cost(x):
        return _residual(whole(x)[None], circles, flange, radius).ravel()

    def slope(x):
        return _slope(whole(x), circles, flange, radius).reshape(-1, 10)[:, :free] * scale

    found = least_squares(cost, values[:free] / scale, slope, method="lm", max_nfev=steps)
    return whole(found.x), 2 * found.cost


def _slope(values, circles, flange, radius):
    """(3, P, 10) derivative of `_residual` at values (10,)."""
    sensor_place = values[:3]
    sensor_rotation = values[3:6]
    ball = values[6:9]
    rotation = rotation_matrix(sensor_rotation)
    flange_inverse = np.swapaxes(flange[:, :3, :3], 1, 2)
    from_flange = ball - flange[:, :3, 3]
    in_flange = (flange_inverse @ from_flange[..., None])[..., 0]
    centre = (in_flange - sensor_place) @ rotation
    slope = np.zeros((len(flange), 3, 10))
    slope[:, :, :3] = -rotation.T
    slope[:, :, 3:6] = skew(centre) @ left_jacobian(-sensor_rotation)
    slope[:, :, 6:9] = rotation.T @ flange_inverse
    # y, out of the profile's plane, enters by the radius of the circle that the plane cuts
    size = values[9] if radius is None else radius
    y = centre[:, 1]
    slope[:, 1] *= (y / size)[:, None]
    slope[:, 1, 9] = -(y**2 + circles[2] ** 2 + size**2) / (2 * size**2)
    in_order = slope[:, [0, 2, 1]]
    return in_order.transpose(1, 0, 2)


def _elsewhere(values, top):
    """Whether this is another hand-eye and not the same valley: another rotation by more than a degree."""
    between = rotation_matrix(values[3:6]).T @ rotation_matrix(top[3:6])
    return np.linalg.norm(rotation_vector(between)) > 0.02
