"""Errors of a scanner's points from its pixels, planes and camera, with and without those of its frame."""

from dataclasses import dataclass

import numpy as np

from sensors.camera.model import Camera
from sensors.light.planes import tilt_directions
from sensors.state import stripe_direction
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.rigid import nearest_rotation

_DEPTHS = 7
_PLACES = 15
_FEWEST = 3  # points that a rigid motion needs
_MAX_POINTS = 3000  # points that stand for the working volume where all would take long


def cut(flat: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(3, n) mm where rays through normalised points (2, n) meet planes (4, n) or (4, 1); nan behind the camera."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -planes[3] / (planes[0] * flat[0] + planes[1] * flat[1] + planes[2])
    depth = np.where(depth > 0, depth, np.nan)
    return np.stack([flat[0] * depth, flat[1] * depth, depth])


def by_flat(points: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(2, 3, n) mm per unit of the normalised point x/z, y/z: points (3, n) stay in their planes (4, n)."""
    facing = (planes[:3] * points).sum(0)  # depth times n.r
    derivative = np.zeros((2, *points.shape))
    for axis in (0, 1):
        derivative[axis, axis] = points[2]
        derivative[axis] -= points * (planes[axis] * points[2] / facing)
    return derivative


def by_pixel(camera: Camera, points: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(2, 3, n) mm per pixel."""
    inverse = _inverse_slope(camera, points) / np.array([camera.fx, camera.fy])[:, None, None]
    return np.einsum("cjn,jin->cin", inverse, by_flat(points, planes))


def _inverse_slope(camera, points):
    """(2, 2, n) [of the distorted, by component of the ideal] normalised point."""
    _, slope, _ = camera.distort_rows(points[:2] / points[2])
    determinant = slope[0, 0] * slope[1, 1] - slope[1, 0] * slope[0, 1]
    return (
        np.stack([np.stack([slope[1, 1], -slope[0, 1]]), np.stack([-slope[1, 0], slope[0, 0]])])
        / determinant
    )


def by_camera(camera: Camera, points: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(P, 3, n) mm per unit of the camera's values, the pixel kept."""
    flat = points[:2] / points[2]
    bent, _, by_coefficient = camera.distort_rows(flat)
    # change of the distorted point (x, y) by fx, fy, cx, cy and the coefficients, for a given pixel
    rows = np.zeros((len(camera.values), 2, points.shape[1]))
    rows[0, 0] = -bent[0] / camera.fx
    rows[1, 1] = -bent[1] / camera.fy
    rows[2, 0] = -1 / camera.fx
    rows[3, 1] = -1 / camera.fy
    rows[4:] = -by_coefficient
    slope = _inverse_slope(camera, points)
    per_bent = np.einsum("cjn,jin->cin", slope, by_flat(points, planes))
    return np.einsum("pcn,cin->pin", rows, per_bent)


def by_plane(points: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(3, 3, n) mm per unit of the two tilts (rad) and the offset (mm) of each point's plane, along its ray."""
    tilts = np.einsum("kin,in->kn", tilt_directions(planes), points)
    shift = np.concatenate([tilts, np.ones((1, points.shape[1]))])
    return -shift[:, None] * (points / (planes[:3] * points).sum(0))


def field_points(
    camera: Camera, planes: np.ndarray, nearest_depth: float, farthest_depth: float
) -> tuple[np.ndarray, np.ndarray]:
    """(3, n) mm over the working volume and the column (n,) of `planes` (4, S) of each.

    In every plane, at depths from `nearest_depth` to `farthest_depth`, places along the stripe that the image shows.
    """
    depth, place_share = (
        a.ravel()
        for a in np.meshgrid(
            np.linspace(nearest_depth, farthest_depth, _DEPTHS), np.linspace(-0.5, 0.5, _PLACES)
        )
    )
    reach = np.hypot(*camera.size) / min(camera.fx, camera.fy)
    squared_tangent = (planes[:2] ** 2).sum(0)
    nearest = (
        -(np.outer(planes[2], depth) + planes[3][:, None])
        / squared_tangent[:, None]
        * planes[:2, :, None]
    )
    direction = stripe_direction(planes)[:2, :, None]
    points_in_field = np.empty((3, planes.shape[1], len(depth)))
    points_in_field[:2] = nearest + direction * (place_share * reach * depth)
    points_in_field[2] = depth
    step = np.repeat(np.arange(planes.shape[1]), len(depth))
    points = points_in_field.reshape(3, -1)
    pixels = camera.project(points)
    size = np.array(camera.size)[:, None]
    is_in_image = ((pixels > 0) & (pixels < size - 1)).all(0) & (
        np.hypot(*points[:2]) < 0.6 * reach * points[2]
    )
    return points[:, is_in_image], step[is_in_image]


def frame_moves(points: np.ndarray) -> np.ndarray:
    """(6, 3, n) mm that points move by per unit of a shift (mm) and a rotation (rad) of the frame."""
    moves = np.zeros((6, *points.shape))
    moves[[0, 1, 2], [0, 1, 2]] = 1
    moves[3:] = np.cross(np.eye(3)[:, :, None], points[None], axis=1)
    return moves


def plane_moves(planes: np.ndarray) -> np.ndarray:
    """(6, 3, S) change of tilts and offset of planes (4, S) per unit of a shift (mm) and a rotation (rad) of the frame.

    A plane n.X + b = 0 moved by X -> X + t + w x X has n + w x n and b - n.t.
    """
    moves = np.zeros((6, 3, planes.shape[1]))
    tilt = np.cross(np.eye(3)[:, :, None], planes[:3][None], axis=1)
    moves[3:, :2] = np.einsum("kis,pis->pks", tilt_directions(planes), tilt)
    moves[:3, 2] = -planes[:3]
    return moves


@dataclass(frozen=True)
class BestFrameCovariance:
    """Covariance of light planes when the scanner's frame may be laid where it fits best.

    `planes` (3 S, 3 S) covariance of their tilts (rad) and offsets (mm) in that frame; `frame` (6, 6)
    of the frame itself, mm and rad; `point_mm` what points of the working volume are off by then,
    1 sigma, root of the mean square of the 3-D distance: camera and planes together, without noise.
    `rays` (V + 6, V + 6 + 3 S): covariance of the camera's V values and of the frame with these and with the planes.
    """

    planes: np.ndarray
    frame: np.ndarray
    point_mm: float
    rays: np.ndarray


def covariance_in_best_frame(
    camera: Camera, planes: np.ndarray, volume: tuple[float, float], joint: np.ndarray
) -> BestFrameCovariance:
    """Part what a calibration leaves uncertain into a rigid motion of everything, and the rest.

    joint: (P + 3 S, D) factor of the covariance of the camera's values and the planes' tilts and
    offsets. A principal point that is off turns the whole camera frame with all planes in it, which
    no measurement with the scanner notices and a hand-eye calibration takes up. That rigid part is
    the one that fits the moves of points over the working volume best. InputError where the image shows no part of
    the planes in the working volume.
    """
    points, step = field_points(camera, planes, *volume)
    if not len(step):
        nearest_depth, farthest_depth = volume
        raise InputError(
            f"light planes: expected planes that the image shows at depths of {nearest_depth:.4g} to "
            f"{farthest_depth:.4g} mm, found none; see that the line found in the images is the laser's, and no "
            "scratch, reflection or margin of the board"
        )
    sample = slice(None, None, -(-len(step) // _MAX_POINTS))
    points = points[:, sample]
    step = step[sample]
    step_planes = planes[:, step]
    count = len(camera.values)
    moves = np.einsum(
        "pin,pd->ind", by_camera(camera, points, step_planes), joint[:count], optimize=True
    )
    by_own = joint[count:].reshape(planes.shape[1], 3, -1)
    for k, rows in enumerate(by_plane(points, step_planes)):
        moves += rows[:, :, None] * by_own[step, k]
    frame = frame_moves(points)
    normal = np.einsum("ain,bin->ab", frame, frame, optimize=True)
    laid = -solve_positive(normal, np.tensordot(frame, moves, ((1, 2), (0, 1))))
    moves += np.tensordot(frame, laid, (0, 0))
    remainder = joint[count:] + plane_moves(planes).transpose(2, 1, 0).reshape(-1, 6) @ laid
    rays = np.concatenate([joint[:count], laid])
    covariance = rays @ np.concatenate([rays, remainder]).T
    point = float(np.sqrt((moves**2).sum() / len(step)))
    return BestFrameCovariance(remainder @ remainder.T, laid @ laid.T, point, covariance)


def by_rays(camera: Camera, points: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """(V + 6, 3, n) derivative (mm per unit) of points (3, n) by the V values of the camera and by 6 of its frame.

    The frame rotates and shifts the rays of the pixels, while the planes (4, n) of the points are held. `Apart.rays` is
    the covariance of these values.
    """
    shifted = np.einsum("pkn,kin->pin", plane_moves(planes), by_plane(points, planes))
    return np.concatenate([by_camera(camera, points, planes), frame_moves(points) - shifted])


def laid_over(
    camera: Camera,
    planes: np.ndarray,
    other_camera: Camera,
    other: np.ndarray,
    volume: tuple[float, float],
):
    """Another calibration's planes (4, S) laid over these by the rigid motion that fits their points best.

    Gives points (3, n) of these planes, their column (n,), their distances (n,) from the other's
    planes and (3, n) from the points that the other finds at the same pixels, mm; nan where it finds none.
    Where it finds next to none, nothing is moved.
    """
    points, step = field_points(camera, planes, *volume)
    rays = other_camera.normalised(camera.project(points))
    found = cut(rays, other[:, step])
    is_met = np.isfinite(found).all(0)
    normals = other[:3]
    offsets = other[3]
    if is_met.sum() < _FEWEST or not np.isfinite(other).all():
        return points, step, _distances(normals, offsets, step, points), found - points
    # the rigid motion from the other frame into this one, about the middles of both sets of points
    middle = points[:, is_met].mean(1, keepdims=True)
    other_middle = found[:, is_met].mean(1, keepdims=True)
    rotation = nearest_rotation((points[:, is_met] - middle) @ (found[:, is_met] - other_middle).T)
    rotated = rotation @ normals
    moved_offsets = offsets + (normals * other_middle).sum(0) - (rotated * middle).sum(0)
    moved = rotation @ (found - other_middle) + middle
    return points, step, _distances(rotated, moved_offsets, step, points), moved - points


def _distances(normals, offsets, step, points):
    """(n,) mm of points (3, n) from the planes (3, S), (S,) of their steps."""
    return (normals[:, step] * points).sum(0) + offsets[step]
