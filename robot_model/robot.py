"""Nominal description of an arm: geometry, limits, masses and gravity."""

from dataclasses import dataclass

import numpy as np

from workbench.core.errors import InputError, complaint

PARALLEL = np.sin(np.deg2rad(1))
"""sin of the angle below which two axes are parallel: their common normal is then ill-defined."""


@dataclass(frozen=True, eq=False)
class Robot:
    """Nominal kinematics and statics of a serial arm with J joints and R joint readings.

    R = J but for a URDF with mimic joints, which are chain joints without a reading of their own.
    """

    name: str
    source: str
    convention: str
    """"distal": Rz(q+theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), Hayati & Mirmirani 1985;
    "craig": alpha, beta and a stand before the joint (Craig, Introduction to Robotics, eq. 3.6)."""
    geometry: np.ndarray
    """(J, 5) theta, d, a, alpha, beta of every joint, rad and mm."""
    hayati: np.ndarray
    """(J,) bool: the next axis is parallel, so that beta is identified and d is not."""
    prismatic: np.ndarray
    """(J,) bool: the joint variable adds to d (mm) instead of theta."""
    mixing: np.ndarray
    """(J, R) joint variables = mixing @ readings: signs and coupled joints, rad and mm."""
    limits: np.ndarray
    """(R, 2) lowest and highest reading, rad or mm, nan where unknown."""
    gear_ratio: np.ndarray
    """(J,) revolutions of the motor per revolution of the joint; of a prismatic joint per mm, those of its screw. nan
    where unknown."""
    gravity: np.ndarray
    """(3,) unit vector in the root frame, which for every arm but a URDF's is the base frame."""
    mass: np.ndarray
    """(J,) kg of the body that moves with joint k, 0 where unknown."""
    com: np.ndarray
    """(J, 3) mm, centre of that mass in frame k, the frame after joint k's full transform."""
    payload_mass: float
    """kg of the empty tool, 0 where unknown."""
    payload_com: np.ndarray
    """(3,) mm in the flange frame."""
    base: np.ndarray
    """(4, 4) T_root_base, mm."""
    flange: np.ndarray
    """(4, 4) T_last_flange, mm: from the frame after the last joint to the flange."""
    coupling: np.ndarray | None = None
    """(J, J) motion of the joint variables per unit of each drive's own motion, rad and mm; None where every drive
    moves its own joint alone. A mimic joint, which has no drive, counts as one that moves alone."""
    joint_names: tuple[str, ...] = ()
    """Names of the J joints in the URDF or MJCF file; () where the arm is of another file."""

    def joint_name(self, k: int) -> str:
        """The name of joint k + 1 in files for other programs: that of its own file, else joint_1 ..."""
        if self.joint_names:
            return self.joint_names[k]
        return f"joint_{k + 1}"

    @property
    def joints(self) -> int:
        return len(self.geometry)

    def drive_motion(self, variables: np.ndarray) -> np.ndarray:
        """(J, n) motion of the drives, in units of their own joints, that makes joint variables (J, n)."""
        if self.coupling is None:
            return variables
        return np.linalg.solve(self.coupling, variables)

    def drive_torque(self, torque: np.ndarray) -> np.ndarray:
        """(..., J, n) torque on each drive under torques (..., J, n) about the joints, N m (N where prismatic).

        A virtual motion dm of the drives moves the joints by dq = C dm and does the work tau . C dm, so that the torque
        on the drives is C^T tau: Craig, Introduction to Robotics, sect. 5.9, with C in place of the Jacobian.
        """
        if self.coupling is None:
            return torque
        return self.coupling.T @ torque


def coupling_of(mixing: np.ndarray, driven: np.ndarray) -> np.ndarray | None:
    """(J, J) `Robot.coupling` of drives that move all joints whose variables follow their readings.

    mixing (J, R): joint variables of readings; driven (R,): index of the joint that is each reading's own.
    """
    coupling = np.eye(len(mixing))
    coupling[:, driven] = mixing / mixing[driven, np.arange(len(driven))]
    if np.array_equal(coupling, np.eye(len(mixing))):
        return None
    return coupling


def wrong(where: object, expected: str, found: object, remedy: str) -> InputError:
    """One sentence: where it stands, what was expected, what was found, what to do."""
    return complaint(where, expected, found, remedy)
