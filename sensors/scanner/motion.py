"""Poses of a moving sensor at each image of a scan, and their covariance.

A scan is joined in one frame by T_frame_camera of each image: from flange pose and hand-eye transform where the
robot moves the sensor, from the axis and the angle of a turntable where the object moves. Errors of these
transforms are small twists: a point p of the frame moves by t + w x p.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag

from sensors.ball.point_errors import plane_error, stripe_error
from sensors.ball.shared import Common, Shared
from sensors.camera.model import Camera
from sensors.scanner.errors import by_rays, frame_moves


class LightPlanes(Protocol):
    """The part of a `sensors.scanner.model.Scanner` that a motion needs; the attributes are described there."""

    camera: Camera
    steps: np.ndarray
    planes: np.ndarray
    scan: np.ndarray
    frame: np.ndarray | None
    covariance: np.ndarray | None
    rays: np.ndarray | None

    def places(self, steps: np.ndarray) -> np.ndarray: ...

    def by_stripe(self, points: np.ndarray, steps: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Motion:
    """T_frame_camera of the F images of one scan, with errors.

    `frame`: name of the frame ("base", "turntable"); `poses` (F, 4, 4), mm. `common` (F, P, 6): twist (mm, rad) of each
    image's points for one unit of each of P errors that all images share, with `common_covariance` (P, P); `individual`
    (F, Q, 6) and `own_covariance` (Q, Q): the same of errors that every image has of its own. `is_closed`: the images
    go all the way round, so that none is at the limit of the scan. `absorbs_frame`: the transforms were calibrated with
    the scanner's camera, as that of hand and eye is, and took up the error of its frame.
    """

    frame: str
    poses: np.ndarray
    common: np.ndarray
    common_covariance: np.ndarray
    individual: np.ndarray
    own_covariance: np.ndarray
    is_closed: bool = False
    absorbs_frame: bool = False

    def points(self, local: np.ndarray, image: np.ndarray) -> np.ndarray:
        """(3, n) mm in the frame, of points (3, n) in the camera frame of `image` (n,)."""
        return self.directions(local, image) + self.poses[image, :3, 3].T

    def directions(self, vectors: np.ndarray, image: np.ndarray) -> np.ndarray:
        """(3, n) in the axes of the frame, of vectors (3, n) in the camera axes of `image` (n,)."""
        return np.einsum("nij,jn->in", self.poses[image, :3, :3], vectors)

    def local(self, point: np.ndarray, image: int) -> np.ndarray:
        """(3,) mm in the camera frame of one image, of a point (3,) of the frame."""
        pose = self.poses[image]
        return pose[:3, :3].T @ (point - pose[:3, 3])

    def own_moves(self, points: np.ndarray, image: np.ndarray) -> np.ndarray:
        """(Q, 3, n) mm by which points (3, n) of the frame move for one unit of each error of their own image."""
        return _moved(self.individual[image], points)

    def own_errors(self, scanner: LightPlanes, local: np.ndarray, seen: "Seen") -> Shared:
        """Errors that points (3, n) mm of one image share and no other image does, for `fit_ball`: of its pose,
        and that of its stripe, whose size is estimated. local: in the camera frame of each image."""
        label = np.unique(seen.image, return_inverse=True)[1]
        derivative = self.own_moves(self.points(local, seen.image), seen.image)
        count = label.max(initial=-1) + 1
        covariance = np.kron(np.eye(count), self.own_covariance)
        error = self.directions(scanner.by_stripe(local, seen.steps), seen.image)
        stripe_place = seen.pixels[1 if abs(scanner.scan[0]) >= abs(scanner.scan[1]) else 0]
        stripe = stripe_error(error, label, stripe_place)
        shared = Shared(label, derivative, covariance, stripe)
        if self._holds_sensor(scanner):
            shared = replace(shared, common=self._sensor_errors(scanner, local, seen, shared))
        if scanner.stripe_variance.any():
            shared = shared.with_errors(stripe, scanner.stripe_variance)
        return shared

    def _holds_sensor(self, scanner: LightPlanes) -> bool:
        """Whether `own_errors` has those of camera and light planes too."""
        return self.absorbs_frame and scanner.rays is not None and scanner.covariance is not None

    def _sensor_errors(self, scanner: LightPlanes, local, seen, shared: Shared) -> Common:
        """Errors of camera and light planes, in the frame that fits the scanner's points best."""
        place = scanner.places(seen.steps)
        used = np.unique(place)
        plane, of_plane = _of_planes(scanner, local, place)
        rays = by_rays(scanner.camera, local, scanner.planes[:, place])
        count = len(rays)
        rows = (count + 3 * used[:, None] + np.arange(3)).ravel()
        mixed = scanner.rays[:, rows]
        covariance = np.block([[scanner.rays[:, :count], mixed], [mixed.T, of_plane]])
        moves = [self.directions(part, seen.image) for part in np.concatenate([rays, plane])]
        groups = int(shared.labels.max(initial=-1)) + 1
        none = np.zeros((len(moves), groups, len(shared.derivative)))
        return Common(np.stack(moves), covariance, none)

    def common_of_centre(
        self, points: np.ndarray, image: np.ndarray, outward: np.ndarray
    ) -> np.ndarray:
        """(3, 3) mm^2 of a ball's centre from errors of the motion that all images share.

        points (3, n) mm of the frame and unit normals (3, n) there.
        """
        return _of_centre(_moved(self.common[image], points), self.common_covariance, outward)

    def common_of_radius(self, points: np.ndarray, image: np.ndarray, outward: np.ndarray) -> float:
        """mm^2, variance of a fitted radius from errors of the motion that all images share; arguments as of
        `common_of_centre`."""
        return _of_radius(_moved(self.common[image], points), self.common_covariance, outward)

    def radius_variance(
        self, scanner: LightPlanes, local: np.ndarray, seen: "Seen", outward: np.ndarray
    ) -> float:
        """mm^2, variance of a fitted radius from the same errors; arguments as of `centre_covariance`."""
        moves, covariance = self._systematic(scanner, local, seen)
        return _of_radius(moves, covariance, outward)

    def centre_covariance(
        self, scanner: LightPlanes, local: np.ndarray, seen: "Seen", outward: np.ndarray
    ) -> np.ndarray:
        """(3, 3) mm^2 of a ball's centre from errors that all images share, beyond those of `own_errors`: of the motion
        and, where the motion does not absorb the frame, of light planes and camera frame.

        local (3, n) mm in the camera frame; outward (3, n) unit normals in the frame. A ball of known radius whose
        points move by d has its centre moved by the least-squares solution of n.c = n.d.
        """
        moves, covariance = self._systematic(scanner, local, seen)
        return _of_centre(moves, covariance, outward)

    def _systematic(self, scanner: LightPlanes, local, seen) -> tuple[np.ndarray, np.ndarray]:
        """Derivative (K, 3, n) of the points by K errors that all images share, and their covariance (K, K)."""
        common = _moved(self.common[seen.image], self.points(local, seen.image))
        if self._holds_sensor(scanner):
            return common, self.common_covariance
        plane, of_plane = _of_planes(scanner, local, scanner.places(seen.steps))
        frame = np.zeros((6, 6)) if scanner.frame is None else scanner.frame
        camera = np.concatenate([plane, frame_moves(local)])
        rotated = np.stack([self.directions(part, seen.image) for part in camera])
        covariance = block_diag(of_plane, frame, self.common_covariance)
        return np.concatenate([rotated, common]), covariance


def _of_centre(moves, covariance, outward) -> np.ndarray:
    normal_moves = np.einsum("in,kin->kn", outward, moves)
    gain = np.linalg.solve(outward @ outward.T, outward @ normal_moves.T)
    return gain @ covariance @ gain.T


def _of_radius(moves, covariance, outward) -> float:
    """mm^2, of the radius in the least-squares solution of n.c + r = n.d."""
    normal_moves = np.einsum("in,kin->kn", outward, moves)
    columns = np.concatenate([outward, np.ones((1, outward.shape[1]))])
    gain = np.linalg.lstsq(columns.T, normal_moves.T, rcond=None)[0][3]
    return float(gain @ covariance @ gain)


def _of_planes(scanner: LightPlanes, local, place) -> tuple[np.ndarray, np.ndarray]:
    """Derivative (3 S, 3, n) by tilts and offset of each of the S light planes seen, and their covariance."""
    used, column = np.unique(place, return_inverse=True)
    size = 3 * len(scanner.steps)
    plane_covariance = np.zeros((size, size)) if scanner.covariance is None else scanner.covariance
    by_plane = plane_error(local, scanner.planes, place, plane_covariance).derivative
    derivative = np.zeros((len(used), 3, *local.shape))
    for k in range(len(used)):
        derivative[k, ..., column == k] = by_plane[..., column == k].transpose(2, 0, 1)
    rows = (3 * used[:, None] + np.arange(3)).ravel()
    return derivative.reshape(-1, *local.shape), plane_covariance[np.ix_(rows, rows)]


@dataclass(frozen=True, eq=False)
class Seen:
    """Stripe points of a joined scan: `pixels` (2, n), `steps` (n,) of the light planes, `image` (n,) from 0."""

    pixels: np.ndarray
    steps: np.ndarray
    image: np.ndarray

    def subset(self, chosen: np.ndarray) -> "Seen":
        """The same of the chosen points."""
        return Seen(self.pixels[:, chosen], self.steps[chosen], self.image[chosen])


def _moved(twists: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 3, n) mm by which points (3, n) move under twists (n, P, 6)."""
    rotated = np.cross(twists[:, :, 3:], points.T[:, None, :])
    return (twists[:, :, :3] + rotated).transpose(1, 2, 0)


def twists_of(poses: np.ndarray, moved: np.ndarray, step: float) -> np.ndarray:
    """(F, 6) twist (mm, rad) per unit that turns transforms `poses` (F, 4, 4) into `moved`, a small `step` away."""
    change = moved @ np.linalg.inv(poses)
    skew = (change[:, :3, :3] - change[:, :3, :3].transpose(0, 2, 1)) / 2
    rotation_vectors = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return np.concatenate([change[:, :3, 3], rotation_vectors], axis=1) / step
