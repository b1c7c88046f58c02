"""Poses of boards and artefacts before the camera: at random within the field, or as a scene says."""

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.camera.model import Camera
from sensors.rendering.patterns import Pattern
from sensors.rendering.scene import Place, Views
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_vector

_TRIES = 400


def board_poses(views: Views, pattern: Pattern, camera: Camera, rng) -> np.ndarray:
    """(G, 6) T_camera_board; those at random show all of the grid. InputError where that cannot be."""
    middle = np.append(pattern.middle, 0.0)
    random_poses = [
        _random(views, middle, camera, rng, lambda poses: _in_view(poses, pattern, camera))
        for _ in range(views.count)
    ]
    return np.array([*(_values(place) for place in views.places), *random_poses]).reshape(-1, 6)


def artefact_poses(views: Views, middles: np.ndarray, camera: Camera, rng) -> np.ndarray:
    """(G, 6) T_camera_artefact: each of `middles` (3, b), mm, in turn about the middle of the field."""
    poses = [
        _random(views, middles[:, k % middles.shape[1]], camera, rng) for k in range(views.count)
    ]
    return np.array([*(_values(place) for place in views.places), *poses]).reshape(-1, 6)


def _values(place: Place) -> np.ndarray:
    return np.concatenate(
        [place.xyz_mm, Rotation.from_euler("xyz", place.rpy_deg, degrees=True).as_rotvec()]
    )


def _random(views, middle, camera, rng, fits=None) -> np.ndarray:
    """(6,) pose that brings the object's point `middle` into the field; the first of many that `fits`."""
    tilt = np.deg2rad(views.tilt_deg) * np.sqrt(rng.uniform(size=_TRIES))
    azimuth = rng.uniform(0, 2 * np.pi, _TRIES)
    roll = np.deg2rad(views.roll_deg) * rng.uniform(-1, 1, _TRIES)
    tilts = Rotation.from_rotvec(
        (tilt * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])).T
    )
    rotations = (tilts * Rotation.from_rotvec(np.outer(roll, [0, 0, 1.0]))).as_matrix()
    size = np.array(camera.size)[:, None]
    pixels = (size - 1) / 2 * (1 + views.aside * rng.uniform(-1, 1, (2, _TRIES)))
    rays = camera.rays(pixels)
    places = rays / rays[2] * rng.uniform(*views.range_mm, _TRIES)
    poses = np.concatenate([places.T - rotations @ middle, rotation_vector(rotations)], axis=1)
    is_usable = np.flatnonzero(fits(poses)) if fits else np.arange(1)
    if not is_usable.size:
        raise InputError(
            "placements: expected a board that fits into the image, found none that does; make the "
            "board smaller, or range_mm larger, or give the places"
        )
    return poses[is_usable[0]]


def _in_view(poses, pattern, camera):
    """(n,) bool: the whole grid lies in the image, a little away from its border."""
    points = pattern.board.points
    rotations = Rotation.from_rotvec(poses[:, 3:]).as_matrix()
    seen = np.einsum("nij,jk->ink", rotations, points) + poses[:, :3].T[:, :, None]
    pixels = camera.project(seen.reshape(3, -1)).reshape(2, len(poses), -1)
    size = np.array(camera.size)[:, None, None]
    margin = 0.01 * size.max()
    return ((pixels > margin) & (pixels < size - 1 - margin)).all((0, 2)) & (seen[2] > 0).all(1)
