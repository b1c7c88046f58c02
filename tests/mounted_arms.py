"""An arm of six joints that deflects under gravity, mounted anywhere; computed without the product's code."""

from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording

# theta, d, a, alpha of each joint (deg, mm), mass (kg) and its centre in the frame after the joint (mm)
_ROWS = (
    (0.0, 410.0, 75.0, -90.0, 64.0, (-40.0, 30.0, 10.0)),
    (-90.0, 0.0, 720.0, 0.0, 52.0, (-330.0, 10.0, 60.0)),
    (0.0, 0.0, 95.0, -90.0, 38.0, (-50.0, 20.0, 25.0)),
    (0.0, 680.0, 0.0, 90.0, 21.0, (0.0, -150.0, 5.0)),
    (0.0, 0.0, 0.0, -90.0, 8.0, (0.0, 15.0, 20.0)),
    (180.0, 105.0, 0.0, 0.0, 9.0, (10.0, 0.0, 60.0)),
)
_RANGES_DEG = ((-150, 150), (-60, 70), (-70, 90), (-160, 160), (-100, 100), (-170, 170))
_TOOL = np.array([40.0, -25.0, 130.0])
_G = 9.80665e-3  # N m for a kg at a mm


@dataclass(frozen=True)
class MountedArm:
    """The true arm: direction of gravity in its base, compliances (6,) rad/(N m), and errors of the joints.

    `springs` (6,): signs of the deflections; -1 for a joint that its spring overcompensates. `first_harmonic` (6,) rad.
    """

    gravity: tuple[float, float, float]
    compliances: tuple[float, ...] = (1.5e-6, 1.1e-6, 1.9e-6, 6e-6, 9e-6, 0.0)
    springs: tuple[float, ...] = (1, 1, 1, 1, 1, 1)
    first_harmonic: tuple[float, ...] = (0, 0, 0, 0, 0, 0)
    noise_mm: float = 0.03

    def recording(self, has_masses: bool = True, n: int = 120, seed: int = 5) -> Recording:
        """External points of n random poses; the robot file states no gravity and, without masses, none."""
        rng = np.random.default_rng(seed)
        low, high = np.array(_RANGES_DEG, float).T
        joints = rng.uniform(low, high, (n, 6))
        errors = rng.normal(0, 1, (6, 4)) * [6e-4, 0.3, 0.3, 6e-4]
        points = [self._point(np.deg2rad(row), errors) for row in joints]
        points = np.array(points) + rng.normal(0, self.noise_mm, (n, 3))
        return Recording.from_arrays(_keys(has_masses), joints, points, sigma_mm=self.noise_mm)

    def _point(self, joints, errors):
        joints = joints + np.array(self.first_harmonic) * np.cos(joints + 0.4)
        torques = _torques(joints, errors, np.array(self.gravity))
        deflected = joints + np.array(self.compliances) * self.springs * torques
        frame = _frames(deflected, errors)[-1]
        turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
        return turn @ (frame @ np.append(_TOOL, 1))[:3] + [1900.0, -700.0, 350.0]


def _keys(has_masses: bool) -> dict:
    joints = []
    for theta, d, a, alpha, mass, centre in _ROWS:
        joint = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        joints.append(joint | ({"mass_kg": mass, "com_mm": list(centre)} if has_masses else {}))
    return {"name": "mounted", "convention": "distal", "joint": joints}


def _frames(joints, errors) -> list[np.ndarray]:
    frames = [np.eye(4)]
    for row, q, error in zip(_ROWS, joints, errors):
        theta, alpha = np.deg2rad(row[0]) + q + error[0], np.deg2rad(row[3]) + error[3]
        d, a = row[1] + error[1], row[2] + error[2]
        about_z = np.array(
            [
                [np.cos(theta), -np.sin(theta), 0, 0],
                [np.sin(theta), np.cos(theta), 0, 0],
                [0, 0, 1, d],
                [0, 0, 0, 1],
            ]
        )
        about_x = np.array(
            [
                [1, 0, 0, a],
                [0, np.cos(alpha), -np.sin(alpha), 0],
                [0, np.sin(alpha), np.cos(alpha), 0],
                [0, 0, 0, 1],
            ]
        )
        frames.append(frames[-1] @ about_z @ about_x)
    return frames


def _torques(joints, errors, gravity) -> np.ndarray:
    """(6,) N m: the derivative of the work of gravity by each joint, by finite differences."""

    def work(q):
        frames = _frames(q, errors)[1:]
        centres = [(frame @ np.append(row[5], 1))[:3] for frame, row in zip(frames, _ROWS)]
        return _G * sum(row[4] * centre @ gravity for centre, row in zip(centres, _ROWS))

    step = 1e-4 * np.eye(6)
    return np.array([(work(joints + h) - work(joints - h)) / 2e-4 for h in step])
