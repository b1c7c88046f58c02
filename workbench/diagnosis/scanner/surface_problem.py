"""Distances of measured points from a ball, or of measured ball centres from their means, linearised.

The baseline is the hand-eye transform and the centres of the balls.
The errors of flange poses are random effects: they move all points of one pose alike, so that they do not pass for an
effect of the sensor.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from datasets.recording import Recording
from sensors.hand_eye.result import HandEye
from workbench.core.distributions import norm
from workbench.core.rigid import rotation_matrix, skew
from workbench.diagnosis.levels import ROUNDING
from workbench.diagnosis.validation.folds import LEAST_FOLDS
from workbench.files.images.flange import flange_poses

_STEPS = 5
"""Steps of Gauss and Newton from the hand-eye calibration, which differs by the weights alone."""
_MOST_POINTS = 20_000
"""Points that are used at most, thinned evenly: their number determines the effects far better than the poses do."""
_OUTLIER_SIGMAS = 6.0
"""Robust standard deviations beyond which a point is not of the surface: two in a billion Gaussian ones are."""
LEAST_NOISE = 1e-6
"""mm, of a point: rounding."""
_LEAST_ERROR = 1e-4
"""mm, of a flange pose: a smaller one is not distinguishable from none."""


@dataclass(frozen=True)
class SurfaceData:
    """Points of one ball: `residual` (n,) mm distance from its surface, `normal` (n, 3) outward in the base frame,
    `pose` (n,) number, `baseline` (n, 9) columns of hand-eye transform and centre, `noise` mm of a point, `pose_error`
    mm of a coordinate of a flange pose, `local` (3, n) mm points in the sensor frame, `flange` and `sensor` (P, 4, 4)
    T_base_flange and T_base_sensor, `row` (n,) of each point in the recording."""

    residual: np.ndarray
    normal: np.ndarray
    pose: np.ndarray
    baseline: np.ndarray
    noise: float
    pose_error: float
    local: np.ndarray
    flange: np.ndarray
    sensor: np.ndarray
    row: np.ndarray

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """V^-1/2 values (n, k), V = noise^2 I + pose_error^2 N N^T in each pose; N (m, 3) its normals."""
        white = np.array(values, float)
        for k in np.unique(self.pose):
            of_pose = self.pose == k
            basis, size, _ = np.linalg.svd(self.normal[of_pose], full_matrices=False)
            relative_size = self.pose_error * size / self.noise
            shrink = 1 - 1 / np.sqrt(1 + relative_size**2)
            coordinates = basis.T @ white[of_pose]
            white[of_pose] -= basis @ (shrink[:, None] * coordinates)
        return white / self.noise

    def displacement_derivative(self, axis: int) -> np.ndarray:
        """(n,) fall of the distance for a point that is displaced by one unit along an axis of the sensor frame."""
        return np.einsum("ni,ni->n", self.normal, self.sensor[self.pose][:, :3, axis])

    def whitened_residual(self) -> np.ndarray:
        """(n,) residual, whitened as the columns are."""
        return self.whitened(self.residual[:, None])[:, 0]

    def held_out(self, columns: np.ndarray) -> np.ndarray:
        """(n,) mm, signed distances of the points of held-out poses from the ball.

        columns (n, k): of the baseline and of effects; every fifth pose is left out together.
        """
        white = self.whitened(columns)
        target = self.whitened_residual()
        fold = self.pose % LEAST_FOLDS
        errors = np.empty_like(self.residual)
        for k in range(LEAST_FOLDS):
            train, test = fold != k, fold == k
            solution = np.linalg.lstsq(white[train], target[train], rcond=ROUNDING)[0]
            predicted = columns[test] @ solution
            errors[test] = self.residual[test] - predicted
        return errors


def linearised(recording: Recording, found: HandEye) -> SurfaceData:
    """The problem at the weighted solution, from a hand-eye calibration `found` with the same points."""
    pose = np.unique(recording.poses, return_inverse=True)[1]
    first = np.unique(pose, return_index=True)[1]
    flange = flange_poses(recording)[first]
    stride = 1 + recording.n // _MOST_POINTS
    rows = np.arange(0, recording.n, stride)
    error = max(found.robot_sigma.get("position_mm", 0.0), _LEAST_ERROR)
    mount = found.sensor.copy()
    centre = found.centre.copy()
    for _ in range(_STEPS):
        solution = (mount, centre, found.radius)
        points = recording.points.T[:, rows]
        data = _linearise(points, pose[rows], rows, flange, solution, error)
        white = data.whitened(data.baseline)
        target = data.whitened_residual()
        step = -np.linalg.lstsq(white, target, rcond=ROUNDING)[0]
        mount[:3, :3] = rotation_matrix(step[3:6]) @ mount[:3, :3]
        mount[:3, 3] += step[:3]
        centre = centre + step[6:9]
    return data


def _linearise(local, pose, rows, flange, solution, error) -> SurfaceData:
    """The problem at a hand-eye transform, centre and radius."""
    mount, centre, radius = solution
    sensor = flange @ mount
    rotation = sensor[pose, :3, :3]
    points = np.einsum("nij,jn->ni", rotation, local) + sensor[pose, :3, 3]
    radial = points - centre
    distance = np.linalg.norm(radial, axis=1)
    normal = radial / distance[:, None]
    residual = distance - radius
    flange_rotation = flange[pose, :3, :3]
    in_flange = np.einsum("nji,nj->ni", flange_rotation, normal)
    arm = local.T @ mount[:3, :3].T
    by_rotation = np.einsum("ni,nij->nj", in_flange, -skew(arm))
    baseline = np.concatenate([in_flange, by_rotation, -normal], axis=1)
    without_shifts = without_pose_shifts(residual, normal, pose)
    noise = max(robust_spread(without_shifts), LEAST_NOISE)
    spread = max(noise, robust_spread(residual))
    deviation = np.abs(residual - np.median(residual))
    inliers = deviation < _OUTLIER_SIGMAS * spread
    arrays = (residual[inliers], normal[inliers], pose[inliers], baseline[inliers])
    return SurfaceData(*arrays, noise, error, local[:, inliers], flange, sensor, rows[inliers])


def linearised_centres(recording: Recording, found: HandEye) -> SurfaceData:
    """The problem of measured ball centres: three distances each, along the axes of the base.

    Errors of flange poses and of centres are one random error: a pose has no second point that would distinguish them.
    """
    pose = np.unique(recording.poses, return_inverse=True)[1]
    first = np.unique(pose, return_index=True)[1]
    ball = np.unique(recording.ball, return_inverse=True)[1]
    flange = flange_poses(recording)[first]
    sensor = flange @ found.sensor
    local = recording.points.T
    rotation = sensor[pose, :3, :3]
    points = np.einsum("nij,jn->ni", rotation, local) + sensor[pose, :3, 3]
    count = np.bincount(ball)
    means = np.stack([np.bincount(ball, column) / count for column in points.T], axis=1)
    # each row is repeated for x, y and z of the base
    axes = np.tile(np.eye(3), (len(pose), 1))
    rows = np.repeat(np.arange(len(pose)), 3)
    flange_rotation = flange[pose[rows], :3, :3]
    in_flange = np.einsum("nji,nj->ni", flange_rotation, axes)
    arm = (local.T @ found.sensor[:3, :3].T)[rows]
    by_rotation = np.einsum("ni,nij->nj", in_flange, -skew(arm))
    is_of_ball = ball[rows, None] == np.arange(len(count))
    of_ball = -axes[:, None] * is_of_ball[:, :, None]
    by_ball = of_ball.reshape(len(rows), -1)
    baseline = np.concatenate([in_flange, by_rotation, by_ball], axis=1)
    residual = (points - means[ball]).reshape(-1)
    solution = np.linalg.lstsq(baseline, residual, rcond=ROUNDING)[0]
    fitted = residual - baseline @ solution
    noise = max(robust_spread(fitted), LEAST_NOISE)
    arrays = (residual, axes, pose[rows], baseline, noise, LEAST_NOISE, local[:, rows])
    return SurfaceData(*arrays, flange, sensor, rows)


def robust_spread(values: np.ndarray) -> float:
    """Standard deviation from the median absolute deviation."""
    deviation = np.abs(values - np.median(values))
    return float(np.median(deviation) / norm.isf(0.25))


def pose_error(data: SurfaceData, remaining: np.ndarray, noise: float) -> float:
    """mm, 1 sigma of a coordinate of the flange poses by maximum likelihood; residuals (n,) mm, noise of points mm."""
    scores, sizes = [], []
    for k in np.unique(data.pose):
        of_pose = data.pose == k
        columns, size, _ = np.linalg.svd(data.normal[of_pose], full_matrices=False)
        scores.append(columns.T @ remaining[of_pose])
        sizes.append(size)
    square, size = np.concatenate(scores) ** 2, np.concatenate(sizes)

    def deviance(log_error: float) -> float:
        spread = np.exp(log_error) * size
        variance = noise**2 + spread**2
        return float((np.log(variance) + square / variance).sum())

    largest = 10 * np.sqrt(square.max()) + 2 * _LEAST_ERROR
    bounds = np.log(_LEAST_ERROR), np.log(largest)
    best = minimize_scalar(deviance, bounds=bounds, method="bounded")
    return float(np.exp(best.x))


def shift_basis(normal: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(n, 3) orthonormal columns, within each pose, of what a shift of the pose makes of its distances."""
    basis = np.zeros_like(normal)
    for k in np.unique(pose):
        of_pose = pose == k
        columns, size, _ = np.linalg.svd(normal[of_pose], full_matrices=False)
        used = size > 1e-6 * size[0]
        basis[of_pose, : used.sum()] = columns[:, used]
    return basis


def without_pose_shifts(residual, normal, pose) -> np.ndarray:
    """(n,) residuals less the shift of every pose that fits its own points best."""
    basis = shift_basis(normal, pose)
    poses = int(pose.max()) + 1
    shift = np.zeros((poses, basis.shape[1]))
    np.add.at(shift, pose, basis * residual[:, None])
    moved = np.einsum("ni,ni->n", basis, shift[pose])
    return residual - moved


def pairs_at(data: SurfaceData, share: float) -> np.ndarray:
    """(m, 2) numbers of two points of one pose each, at a distance of about `share` of the extent of its points."""
    pairs = []
    for k in np.unique(data.pose):
        of_pose = np.flatnonzero(data.pose == k)
        points = data.local[:, of_pose].T
        extent = np.ptp(points, axis=0)
        axes = np.flatnonzero(extent[:2] > 0)
        if not len(axes):
            continue
        axis = axes[k % len(axes)]
        partner = points + share * extent[axis] * np.eye(3)[axis]
        distance, nearest = cKDTree(points).query(partner)
        is_near = distance < share * extent[axis] / 2
        pairs.append(np.stack([of_pose, of_pose[nearest]], axis=1)[is_near])
    if pairs:
        return np.concatenate(pairs)
    return np.empty((0, 2), int)
