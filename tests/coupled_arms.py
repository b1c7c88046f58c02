"""Arms whose drives move several joints, computed without the product's code: points of random poses."""

from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording

_G = 9.80665e-3  # N m for a kg at a mm

# theta, d, a, alpha (deg, mm), mass (kg), centre in the frame after the joint (mm), range of the reading (deg)
_SIX = (
    (0.0, 480.0, 210.0, -90.0, 120.0, (-90.0, 60.0, 10.0), (-150, 150)),
    (-90.0, 0.0, 870.0, 0.0, 85.0, (-400.0, 5.0, 70.0), (-40, 65)),
    (0.0, 0.0, 160.0, -90.0, 70.0, (-60.0, 30.0, 40.0), (-30, 70)),
    (0.0, 940.0, 0.0, 90.0, 30.0, (0.0, -260.0, 5.0), (-170, 170)),
    (0.0, 0.0, 0.0, -90.0, 12.0, (0.0, 10.0, 20.0), (-100, 100)),
    (180.0, 130.0, 0.0, 0.0, 16.0, (15.0, 0.0, 90.0), (-170, 170)),
)
_PALLETISER = (
    (0.0, 690.0, 290.0, -90.0, 300.0, (-200.0, 80.0, 0.0), (-150, 150)),
    (-90.0, 0.0, 1100.0, 0.0, 160.0, (-520.0, 10.0, 30.0), (-35, 70)),
    (90.0, 0.0, 1310.0, 0.0, 170.0, (-820.0, -40.0, 0.0), (-25, 65)),
    (0.0, 0.0, 230.0, -90.0, 45.0, (-110.0, 0.0, 30.0), (0, 0)),
    (0.0, 190.0, 0.0, 0.0, 60.0, (10.0, 0.0, 150.0), (-170, 170)),
)
ARMS = {
    "parallelogram": (_SIX, {3: (2, -1.0)}),
    "palletiser": (_PALLETISER, {3: (2, -1.0), 4: (3, -1.0)}),
    "wrist": (_SIX, {5: (4, 0.0125), 6: (5, 0.75)}),
}
_TOOLS = np.array([[60.0, -35.0, 170.0], [-80.0, 20.0, 90.0], [10.0, 90.0, 120.0]])


@dataclass(frozen=True)
class CoupledArm:
    """A true arm of `ARMS`: errors of its drives, which act on all joints that they move where `is_mechanical`.

    `compliances` (J,) rad/(N m); `harmonics`: (joint, order, cosine, sine) in rad of the drive's own angle; `half_gaps`
    (J,) rad to the side of the last move. `with_masses`: whether the robot file states them; `says`: value of the key
    `mechanical`, None to leave it out.
    """

    name: str
    compliances: tuple[float, ...] = ()
    harmonics: tuple[tuple[int, float, float, float], ...] = ()
    half_gaps: tuple[float, ...] = ()
    is_mechanical: bool = True
    with_masses: bool = True
    says: bool | None = None
    noise_mm: float = 0.03
    couplings: dict | None = None
    stated: dict | None = None
    """Joint -> (other joint, ratio) of the true arm, and of the robot file, where they are not those of `ARMS`."""

    @property
    def rows(self):
        return ARMS[self.name][0]

    @property
    def true_couplings(self) -> dict:
        return ARMS[self.name][1] if self.couplings is None else self.couplings

    @property
    def mixing(self) -> np.ndarray:
        mixing = np.eye(len(self.rows))
        for joint, (other, ratio) in self.true_couplings.items():
            mixing[joint - 1, other - 1] = ratio
        return mixing

    def keys(self) -> dict:
        """Keys of robot.toml, with nominal geometry."""
        joints = []
        for number, (theta, d, a, alpha, mass, centre, _) in enumerate(self.rows, 1):
            joint = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
            if self.with_masses:
                joint |= {"mass_kg": mass, "com_mm": list(centre)}
            stated = self.true_couplings if self.stated is None else self.stated
            if number in stated:
                other, ratio = stated[number]
                said = {} if self.says is None else {"mechanical": self.says}
                joint["coupled"] = {"joint": other, "ratio": ratio, **said}
            joints.append(joint)
        return {"name": self.name, "convention": "distal", "joint": joints}

    def recording(self, n: int = 150, seed: int = 3, reflectors: int = 1) -> Recording:
        """External points of n random poses."""
        rng = np.random.default_rng(seed)
        low, high = np.deg2rad([row[-1] for row in self.rows]).T
        readings = rng.uniform(low, high, (n, len(self.rows)))
        errors = rng.normal(0, 1, (len(self.rows), 4)) * [6e-4, 0.3, 0.3, 6e-4]
        before = np.vstack([np.zeros(len(self.rows)), readings[:-1]])
        sides = np.sign(readings - before)
        points = [
            self.points(*pair, errors)[k % reflectors]
            for k, pair in enumerate(zip(readings, sides))
        ]
        points = np.array(points) + rng.normal(0, self.noise_mm, (n, 3))
        return Recording.from_arrays(
            self.keys(), np.rad2deg(readings), points, sigma_mm=self.noise_mm
        )

    def points(self, reading, side, errors) -> np.ndarray:
        """(3, 3) mm of three reflectors at one reading (J,), in a frame of the instrument."""
        drives = self.mixing if self.is_mechanical else np.eye(len(self.rows))
        error = np.zeros(len(self.rows))
        for joint, order, cosine, sine in self.harmonics:
            angle = (reading if self.is_mechanical else self.mixing @ reading)[joint - 1]
            error[joint - 1] += cosine * np.cos(order * angle) + sine * np.sin(order * angle)
        if self.half_gaps:
            error += np.array(self.half_gaps) * side
        joints = self.mixing @ reading + drives @ error
        if self.compliances:
            torque = drives.T @ self.torques(joints, errors)
            joints = joints + drives @ (np.array(self.compliances) * torque)
        frame = self.frames(joints, errors)[-1]
        turn = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
        return (frame[:3, :3] @ _TOOLS.T + frame[:3, 3:]).T @ turn.T + [2100.0, 900.0, -260.0]

    def frames(self, joints, errors) -> list[np.ndarray]:
        """Frame after each joint, (4, 4), at joint variables (J,)."""
        frame, frames = np.eye(4), []
        for (theta, d, a, alpha, *_), q, error in zip(self.rows, joints, errors):
            t, w = np.deg2rad(theta) + q + error[0], np.deg2rad(alpha) + error[3]
            about_z = np.eye(4)
            about_z[:2, :2] = [[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]
            about_z[2, 3] = d + error[1]
            about_x = np.eye(4)
            about_x[1:3, 1:3] = [[np.cos(w), -np.sin(w)], [np.sin(w), np.cos(w)]]
            about_x[0, 3] = a + error[2]
            frame = frame @ about_z @ about_x
            frames.append(frame)
        return frames

    def energy(self, joints, errors) -> float:
        """Potential energy, N m, of the links at joint variables (J,)."""
        heights = [
            frame[2, :3] @ row[5] + frame[2, 3]
            for frame, row in zip(self.frames(joints, errors), self.rows)
        ]
        return _G * sum(row[4] * height for row, height in zip(self.rows, heights))

    def torques(self, joints, errors) -> np.ndarray:
        """(J,) N m of gravity about the joints: how the potential energy falls with each, by finite differences."""
        steps = 1e-4 * np.eye(len(joints))
        return np.array(
            [
                (self.energy(joints - h, errors) - self.energy(joints + h, errors)) / 2e-4
                for h in steps
            ]
        )
