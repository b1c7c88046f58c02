"""Light planes as numbers that a solve may change: two tilts and an offset each, and a plane through points."""

import numpy as np

from sensors.state import stripe_direction
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.least_squares.bundle import Family
from workbench.core.least_squares.linear_algebra import thin_svd

TILTS = ("tilt_across", "tilt_along", "offset")
UNITS = ("rad", "rad", "mm")
_TYPICAL = np.array([0.01, 0.01, 1.0])
_PARALLEL_SPREAD = 1e-3
"""Spread of the normals (rad, RMS) below which planes are parallel, as of a laser on a slide, and meet nowhere."""


def tilt_directions(planes: np.ndarray) -> np.ndarray:
    """(2, 3, S) unit vectors along which the normals of planes (4, S) tilt: the stripe, and across it."""
    stripe_axis = stripe_direction(planes)
    return np.stack([stripe_axis, np.cross(planes[:3], stripe_axis, axis=0)])


def moved(planes: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(4, S) planes after change (S, 3): normal n + a e1 + c e2 made a unit again, offset b + db (mm).

    e1, e2 are those of `tilt_directions`; the tilts (rad) turn the normal, not about a point of the
    plane but with the offset from the camera kept.
    """
    tilted = planes[:3] + np.einsum("kis,sk->is", tilt_directions(planes), change[:, :2])
    moved_planes = np.empty_like(planes)
    moved_planes[:3] = tilted / np.linalg.norm(tilted, axis=0)
    moved_planes[3] = planes[3] + change[:, 2]
    return moved_planes


def moved_rows(planes: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(3, 4, S) derivative of `moved` with respect to the change."""
    directions = tilt_directions(planes)
    tilted = planes[:3] + np.einsum("kis,sk->is", directions, change[:, :2])
    length = np.linalg.norm(tilted, axis=0)
    normal = tilted / length
    rows = np.zeros((3, *planes.shape))
    rows[:2, :3] = (directions - normal * (directions * normal).sum(1)[:, None]) / length
    rows[2, 3] = 1
    return rows


def in_tilts(planes: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(P, 3, S) derivatives rows (P, 4, S) of planes (4, S), as tilts and offset."""
    tilts = np.einsum("kis,pis->pks", tilt_directions(planes), rows[:, :3])
    return np.concatenate([tilts, rows[:, 3:]], 1)


def steps_family(planes: np.ndarray) -> Family:
    """The family `step` of free light planes (4, S): changes (S, 3) from where they start."""
    return Family("step", np.zeros((planes.shape[1], 3)), _TYPICAL, None, TILTS, UNITS)


def plane_through(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(4,) plane nearest to points (3, n) mm, its offset positive, and (3,) their spreads, largest first.

    Robust: points farther than three robust sigmas (median of the absolute distances) are excluded, in three rounds.
    The normal is the singular vector of the smallest singular value: Pearson, Phil. Mag. 2 (1901).
    """
    is_inlier = np.ones(points.shape[1], bool)
    for _ in range(4):
        middle = points[:, is_inlier].mean(1)
        _, spread, directions = thin_svd((points[:, is_inlier] - middle[:, None]).T)
        distance = np.abs(directions[2] @ (points - middle[:, None]))
        is_inlier = distance <= max(3 * MEDIAN_TO_SIGMA * np.median(distance), 1e-12)
    plane = np.append(directions[2], -directions[2] @ middle)
    return plane * (1.0 if plane[3] >= 0 else -1.0), spread / np.sqrt(is_inlier.sum())


def light_origin(planes: np.ndarray) -> np.ndarray | None:
    """(3,) mm, where the light of planes (4, S) comes from; None of one plane, or of parallel ones.

    Planes that one mirror or one fan of light makes meet near a line: the point of it that is nearest to the camera,
    in least squares. How far along that line the light starts is not known, and hardly changes where it falls on a
    surface across the planes.
    """
    normals = planes[:3].T
    offsets = planes[3]
    if len(offsets) < 2:
        return None
    aligned = normals * np.sign(normals @ normals[0])[:, None]
    sides, spread, directions = thin_svd(aligned)
    if spread[1] / np.sqrt(len(offsets)) < _PARALLEL_SPREAD:
        return None
    distances = -offsets * np.sign(normals @ normals[0])
    return directions[:2].T @ (sides[:, :2].T @ distances / spread[:2])


def plane_variance(
    planes: np.ndarray, points: np.ndarray, step: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """(n,) mm^2, of the distance of points (3, n) from their planes, column `step` (n,) of planes (4, S).

    covariance: (3 S, 3 S) of the planes' tilts and offsets.
    """
    steps = np.arange(planes.shape[1])
    blocks = covariance.reshape(len(steps), 3, len(steps), 3)[steps, :, steps]
    tilts = np.einsum("kin,in->kn", tilt_directions(planes)[:, :, step], points)
    rows = np.concatenate([tilts, np.ones((1, len(step)))])
    return np.einsum("in,nij,jn->n", rows, blocks[step], rows)
