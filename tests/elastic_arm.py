"""An elastic arm that is computed here, independent of the product: joint springs under a load on the flange.

Transforms are built from the rows of the robot file; torques are those of forces at points. mm, rad, N, kg.
"""

from dataclasses import dataclass, field

import numpy as np

from datasets.recording import Recording

GRAVITY = 9.80665
ROWS = (
    (0.0, 480.0, 160.0, -90.0),
    (-90.0, 0.0, 700.0, 0.0),
    (0.0, 0.0, 130.0, -90.0),
    (0.0, 720.0, 0.0, 90.0),
    (0.0, 0.0, 0.0, -90.0),
    (0.0, 110.0, 0.0, 0.0),
)
POINT = np.array([35.0, -50.0, 140.0])
RANGES = np.array([150.0, 70.0, 60.0, 160.0, 100.0, 170.0])


@dataclass(frozen=True)
class ElasticArm:
    """`compliance` (6,) rad/(N m) of the drives; `centre` (3,) mm of the load in the flange frame; `coupling` (6, 6):
    motion of the joints per unit of motion of each drive; `links`: (kg, (3,) mm) of each link's own weight."""

    compliance: np.ndarray
    centre: np.ndarray = field(default_factory=lambda: POINT.copy())
    coupling: np.ndarray = field(default_factory=lambda: np.eye(6))
    links: tuple = ()

    def frames(self, joints):
        """Poses (4, 4) before each joint, and of the flange."""
        pose, poses = np.eye(4), []
        for (theta, d, a, alpha), q in zip(ROWS, joints):
            poses.append(pose)
            c, s = np.cos(np.deg2rad(theta) + q), np.sin(np.deg2rad(theta) + q)
            ca, sa = np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
            row = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d]]
            pose = pose @ np.vstack([row, [0, 0, 0, 1]])
        return [*poses, pose]

    def torques(self, joints, load_kg):
        """(6,) N m about each joint of all weights."""
        poses = self.frames(joints)
        weights = [(load_kg, 6, self.centre)]
        weights += [(kg, k, np.asarray(centre)) for k, (kg, centre) in enumerate(self.links, 1)]
        torque = np.zeros(6)
        for kg, frame, centre in weights:
            place = (poses[frame] @ [*centre, 1.0])[:3]
            for k in range(frame):
                lever = place - poses[k][:3, 3]
                torque[k] += poses[k][:3, 2] @ np.cross(lever, [0, 0, -kg * GRAVITY]) / 1000
        return torque

    def point(self, drives, load_kg):
        """(3,) the measured point, after the drives have given way under all weights."""
        motion = np.asarray(drives, float)
        for _ in range(3):
            torque = self.coupling.T @ self.torques(self.coupling @ motion, load_kg)
            motion = drives + self.compliance * torque
        return (self.frames(self.coupling @ motion)[-1] @ [*POINT, 1.0])[:3]


def robot_file(coupled=None, masses=()):
    """Keys of the robot file; coupled: joint number -> its key; masses: (kg, (3,) mm) of each link."""
    joints = []
    for k, (theta, d, a, alpha) in enumerate(ROWS, 1):
        row = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        if coupled and k in coupled:
            row["coupled"] = coupled[k]
        if masses:
            row |= {"mass_kg": masses[k - 1][0], "com_mm": list(masses[k - 1][1])}
        joints.append(row)
    return {"name": "elastic arm", "convention": "distal", "joint": joints}


def measured(arm, robot, loads, n=80, sigma=0.01, seed=3):
    """A recording of n random poses of the drives, with one of the `loads` (kg) on the flange in each."""
    rng = np.random.default_rng(seed)
    drives = np.deg2rad(rng.uniform(-RANGES, RANGES, (n, 6)))
    load = rng.choice(loads, n)
    points = np.array([arm.point(q, kg) for q, kg in zip(drives, load)])
    points = points + rng.normal(0, sigma, points.shape)
    columns = {"sample": np.arange(1.0, n + 1), "reflector": np.ones(n)}
    columns |= {f"q{k + 1}_deg": np.rad2deg(drives[:, k]) for k in range(6)}
    columns |= {f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")}
    if max(loads) > 0:
        columns["payload_kg"] = load
    return Recording("external-point", columns, robot, sigma_mm=sigma, name="elastic arm")
