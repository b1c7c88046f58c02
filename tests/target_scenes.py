"""Flange poses and poses of a marker, simulated for tests of hand-eye calibration."""

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.rigid import inverse, transform


def target_scene(seed, count=14, kind="in-hand", sigma=(0.4, 0.003)):
    """Flange poses T_base_flange and target poses T_sensor_target (n, 4, 4), and the true sensor pose (4, 4), mm.

    sigma: mm of a coordinate and rad of a rotation about an axis, of the measured target poses.
    """
    rng = np.random.default_rng(seed)
    sensor = transform(Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 80, 3))
    target = transform(
        Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 300, 3) + [800, 0, 0]
    )
    views = Rotation.from_rotvec(rng.normal(0, 0.35, (count, 3))).as_matrix()
    places = np.stack([*rng.normal(0, 60, (2, count)), rng.uniform(350, 700, count)], axis=1)
    seen = transform(views, places)
    moved = target @ inverse(seen) @ inverse(sensor)
    noise = Rotation.from_rotvec(rng.normal(0, sigma[1], (count, 3))).as_matrix()
    measured = transform(noise @ views, places + rng.normal(0, sigma[0], (count, 3)))
    return moved if kind == "in-hand" else inverse(moved), measured, sensor


def rotation_vectors(poses):
    """(n, 3) rad."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()


def euler_deg(poses, sequence):
    """(n, 3) deg."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_euler(sequence, degrees=True)


def quaternions(poses):
    """(n, 4) x y z w."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat()
