"""Tables of recordings for tests of the import."""

import numpy as np
from scipy.spatial.transform import Rotation


def nearly_one_orientation(noise_deg: float) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Readings (n, 6) in deg, points (n, 3) mm and rotations of a target that turns by 0.1 deg only."""
    from robot_model import load_robot
    from workbench.recordings.templates.contact import TrueArm

    rng = np.random.default_rng(5)
    arm = TrueArm.of(load_robot("ur10"), rng)
    fixed = Rotation.from_euler("xyz", [170, 20, 40], degrees=True).as_matrix()

    def gap(turn, origin):
        return 300 * Rotation.from_matrix(turn @ fixed.T).as_rotvec().T

    readings = arm.poses_with(30, rng, gap, sigma_mm=0.5)
    turn, origin = arm.flange(readings)
    base = Rotation.from_euler("xyz", [3, -4, 60], degrees=True)
    points = base.apply(origin + turn @ np.array([20.0, 10.0, 120.0])) + [2000.0, 300.0, 100.0]
    tool = Rotation.from_euler("xyz", [20, 40, 70], degrees=True)
    noise = Rotation.from_rotvec(np.deg2rad(noise_deg) * rng.normal(size=(30, 3)))
    return np.rad2deg(readings), points, base * Rotation.from_matrix(turn) * tool * noise
