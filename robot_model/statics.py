"""Gravity at rest: the torque at every joint and the moment at every link, of links and load.

Everything is linear in the direction of gravity, so levers are computed once and gravity is
multiplied in afterwards: the gravity port then needs no second pass along the chain.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.robot import Robot

STANDARD_GRAVITY = 9.80665
"""N/kg"""
_MM = 1e-3


@dataclass(frozen=True)
class Levers:
    """Torques and bending moments of some masses, per unit direction of gravity.

    `torque` (J, 3, n): its dot product with the direction of gravity is the torque about joint
    k in N m (for a prismatic joint the force along it in N), positive where gravity drives the
    joint forward. `moment` (J+2, 3, n): its cross product with the direction is the moment in N m
    about the pivot of base, links and tool, in the root frame. `arm` (J, 3, n): the same about
    each joint's axis, with the joint's own body.
    """

    torque: np.ndarray
    moment: np.ndarray
    arm: np.ndarray

    def __add__(self, other: "Levers") -> "Levers":
        return Levers(self.torque + other.torque, self.moment + other.moment, self.arm + other.arm)


def link_levers(robot: Robot, frames: Frames) -> Levers:
    """Levers of the links' own masses; body k moves with joint k, its centre is in frame k."""
    n = frames.end_origin.shape[1]
    from_origin = np.einsum("kcin,kc->kin", frames.link[1:-1], robot.com)
    centres = frames.origin + from_origin
    # the last body, the load at the flange, has no mass here
    masses = np.zeros((robot.joints + 1, n))
    masses[:-1] = robot.mass[:, None]
    moments = np.zeros((robot.joints + 1, 3, n))
    moments[:-1] = robot.mass[:, None, None] * centres
    return _levers(robot, frames, masses, moments)


def load_levers(robot: Robot, frames: Frames, mass: np.ndarray, centre: np.ndarray) -> Levers:
    """Levers of a load `mass` (n,) kg with its centre at `centre` (3,) mm in the flange frame."""
    masses = np.zeros((robot.joints + 1, len(mass)))
    moments = np.zeros((robot.joints + 1, 3, len(mass)))
    masses[-1] = mass
    moments[-1] = mass * frames.point(centre)
    return _levers(robot, frames, masses, moments)


def moment_levers(robot: Robot, frames: Frames, change: np.ndarray) -> Levers:
    """Levers of first moments (J+1, 3, n) kg mm added to the bodies, each in its own frame; no mass."""
    axes = np.concatenate([frames.link[1:-1], np.stack(frames.end)[None]])
    moments = np.einsum("kcin,kcn->kin", axes, change)
    masses = np.zeros((robot.joints + 1, moments.shape[-1]))
    return _levers(robot, frames, masses, moments)


def _levers(robot, frames, masses, moments):
    """Levers of J links and a load, masses (J+1, n) and first moments (J+1, 3, n)."""
    mass, moment = (np.cumsum(part[::-1], 0)[::-1] for part in (masses, moments))
    arms = moment[:-1] - mass[:-1, None] * frames.z_origin
    torque = np.where(
        robot.prismatic[:, None, None], mass[:-1, None] * frames.z, cross(frames.z, arms) * _MM
    )
    # the base carries every body; link K bends under the bodies beyond it, the tool under the load
    outer = [*range(robot.joints + 1), robot.joints]
    bending = (moment[outer] - mass[outer, None] * frames.pivot) * _MM
    return Levers(
        torque * STANDARD_GRAVITY, bending * STANDARD_GRAVITY, arms * _MM * STANDARD_GRAVITY
    )
