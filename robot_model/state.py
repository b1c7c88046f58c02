"""State that effects read: joint readings, torques, bending moments and covariates of n samples."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from robot_model.chain import Frames, cross, forward
from robot_model.robot import Robot
from robot_model.statics import (
    STANDARD_GRAVITY,
    Levers,
    link_levers,
    load_levers,
    moment_levers,
)
from workbench.core.covariates import MotionHistory, last_moves, last_side, last_sides
from workbench.core.errors import InputError

_MM_A_METRE = 1e3
_HISTORY = re.compile(r"(?:approach|move)(\d+)")
_STATIC_LIMITS = 0.1, 1e-4  # mm, rad that a reading may change by while the arm stands
_TRAVEL = 1.0, 1e-3  # mm, rad in one direction from which on it is the side that a joint came from


@dataclass(frozen=True)
class State:
    """The nominal arm at the recorded readings.

    Torques about joints, angles and moves of joints are those of their drives, which a coupling of joints makes
    differ from those of the joint itself (`Robot.coupling`). Frames and bending moments are those of the links.

    `variables` (J, n) joint variables (rad, mm); `covariates` name -> (n,) in file units;
    `gravity` (3,) unit vector in the root frame; `payload` (n,) kg on the flange with its centre
    at `load_centre` (3,) mm in the flange frame; `measured` (3, n) mm as the instrument gave it;
    `index` (n,) number of the ball or reflector and `target` (3, n) mm its nominal place on artefact
    or tool. Torques are those of the nominal geometry: a millimetre of error in a link changes them
    by a thousandth, which is a micrometre of deflection.
    """

    robot: Robot
    variables: np.ndarray
    covariates: Mapping[str, np.ndarray]
    gravity: np.ndarray
    payload: np.ndarray
    load_centre: np.ndarray
    measured: np.ndarray
    index: np.ndarray
    target: np.ndarray
    root_rotation: np.ndarray | None = None
    """(3, 3) from the robot's root frame to the external one, at the start of the fit; None where there is none."""
    history: MotionHistory | None = None
    """The moves that led to the samples; None where these have no order."""

    @property
    def n(self) -> int:
        return self.variables.shape[1]

    @property
    def points(self) -> np.ndarray:
        """(3, n) mm, the measured point in the frame of the sensor or instrument."""
        return self.measured

    @property
    def field(self) -> np.ndarray:
        """(2, n) its place across the sensor's axis, in units of 100 mm."""
        return self.measured[:2] / 100

    @property
    def ball(self) -> np.ndarray:
        """(n,) number of the ball that was measured."""
        return self.index

    @property
    def has_masses(self) -> bool:
        """Whether a mass of the arm or of its load is known, so that gravity torques are."""
        return bool(self.robot.mass.any() or self.payload.any())

    @cached_property
    def drive_angles(self) -> np.ndarray:
        """(J, n) motion of each joint's own drive, rad (mm where prismatic): the joint variables without a coupling."""
        return self.robot.drive_motion(self.variables)

    @cached_property
    def frames(self) -> Frames:
        """Nominal frames in the root frame."""
        return forward(self.robot, self.variables, links=True)

    @cached_property
    def link_levers(self) -> Levers:
        return link_levers(self.robot, self.frames)

    @cached_property
    def load_levers(self) -> Levers:
        return load_levers(self.robot, self.frames, self.payload, self.load_centre)

    @cached_property
    def torque(self) -> np.ndarray:
        """(J, n) gravity torque of links and load on the drive of each joint, N m (N where prismatic)."""
        levers = self.link_levers.torque + self.load_levers.torque
        return self._project(levers)

    @cached_property
    def self_torque(self) -> np.ndarray:
        """(J, n) the part of the links alone, N m."""
        return self._project(self.link_levers.torque)

    @cached_property
    def unit_load_torque(self) -> np.ndarray:
        """(J, n) torque of one newton of load at the load centre, in N m: a lever in metres."""
        one_newton = np.full(self.n, 1 / STANDARD_GRAVITY)
        return self._project(
            load_levers(self.robot, self.frames, one_newton, self.load_centre).torque
        )

    @cached_property
    def load_moment_torque(self) -> np.ndarray:
        """(3, J, n) torque (N m) of 1 N m of first moment of the load along each axis of the flange."""
        torque = []
        for axis in range(3):
            change = np.zeros((self.robot.joints + 1, 3, self.n))
            change[-1, axis] = _MM_A_METRE / STANDARD_GRAVITY  # kg mm
            torque.append(self._project(moment_levers(self.robot, self.frames, change).torque))
        return np.stack(torque)

    @cached_property
    def moment(self) -> np.ndarray:
        """(J+2, 3, n) bending moment at base, links and tool, N m, each in its own frame."""
        levers = self.link_levers.moment + self.load_levers.moment
        world = cross(levers, np.broadcast_to(self.gravity[:, None], (3, self.n)))
        return np.einsum("pcin,pin->pcn", self.frames.link, world)

    @cached_property
    def bearing_moment(self) -> np.ndarray:
        """(J, 3, n) moment across each joint's axis, N m, in the frame of the link after it."""
        arm = self.link_levers.arm + self.load_levers.arm
        world = cross(arm, np.broadcast_to(self.gravity[:, None], (3, self.n)))
        transverse = world - self.frames.z * (world * self.frames.z).sum(1, keepdims=True)
        return np.einsum("pcin,pin->pcn", self.frames.link[1:-1], transverse)

    def _project(self, levers):
        """(J, n) torque on each drive."""
        return self.robot.drive_torque(np.einsum("kin,i->kn", levers, self.gravity))

    def altered(self, changes) -> "State":
        """The same under changed gravity or masses; changes: (port, components, delta (k, n)) each.

        Port `gravity`: components 0-2, change of the direction (a small tilt keeps its length). Port `mass`: component
        3 k + c, change of the first moment (kg mm) of body k along axis c of its own frame; body J
        is the load, in the flange frame. Component 3 J + 3: change of the load's mass (kg), at the flange's origin.
        """
        gravity = self.gravity.copy()
        moments = np.zeros((3 * self.robot.joints + 4, self.n))
        for port, port_indices, delta in changes:
            for port_index, change in zip(port_indices, delta):
                if port == "gravity":
                    gravity[port_index] += change[0]
                else:
                    moments[port_index] += change
        mass = moments[-1]
        moments = moments[:-1].reshape(-1, 3, self.n)
        of_link = (np.arange(self.robot.joints + 1) < self.robot.joints)[:, None, None]
        of_links = self._with_added_moments(self.link_levers, np.where(of_link, moments, 0))
        of_load = self._with_added_moments(self.load_levers, np.where(of_link, 0, moments))
        if mass.any():
            of_load = of_load + load_levers(self.robot, self.frames, mass, np.zeros(3))
        fields_of_state = {field.name: getattr(self, field.name) for field in fields(State)}
        fields_of_state |= {
            "gravity": gravity,
            "same_frames": self.frames,
            "levers": (of_links, of_load),
        }
        return _Altered(**fields_of_state)

    def _with_added_moments(self, levers: Levers, moments: np.ndarray) -> Levers:
        """The levers with (J + 1, 3, n) kg mm of first moments more."""
        if not moments.any():
            return levers
        return levers + moment_levers(self.robot, self.frames, moments)

    @cached_property
    def unit_moments(self) -> "tuple[State, ...]":
        """(3 J + 3) states with one kg mm more of one first moment: of each link along x, y, z, then of the load."""
        return tuple(map(self.with_moments, np.eye(3 * self.robot.joints + 3)))

    def with_moments(self, change: np.ndarray) -> "State":
        """The same with first moments changed by `change` (3 J + 3,) kg mm.

        Those of each link along x, y and z, then those of the load.
        """
        changes = np.repeat(change[:, None], self.n, axis=1)
        return self.altered([("mass", np.arange(len(change)), changes)])

    def wound_up(self, joint: int, width: float, of_dahl: bool = False) -> np.ndarray:
        """(n,) state of friction of a joint, from 1, between -1 and 1, see `MotionHistory`; width: rad, m of a slide.

        Of a target, which has no history, that of `with_history`.
        """
        if self.history is None:
            return self.covariate(_wound(joint))
        metres = _MM_A_METRE if self.robot.prismatic[joint - 1] else 1.0
        return self.history.wound_up(joint, metres * width, of_dahl)

    def covariate(self, name: str) -> np.ndarray:
        """(n,) a recorded covariate; InputError where the recording does not hold it."""
        if name not in self.covariates:
            recorded = (
                ", ".join(sorted(k for k in self.covariates if not k.startswith("move"))) or "none"
            )
            raise InputError(
                f"samples.csv of the recording: column '{name}' is needed by an effect, found {recorded}; "
                f"add the column or take the effect out of the plan"
            )
        return self.covariates[name]


@dataclass(frozen=True)
class _Altered(State):
    """A state under changed gravity or masses: its frames are those of the original, its `levers` given."""

    same_frames: Frames | None = None
    levers: tuple[Levers, Levers] | None = None

    @property
    def frames(self) -> Frames:
        return self.same_frames

    @property
    def link_levers(self) -> Levers:
        return self.levers[0]

    @property
    def load_levers(self) -> Levers:
        return self.levers[1]


def moved(
    robot: Robot, variables: np.ndarray, time: np.ndarray, pose: np.ndarray
) -> tuple[dict[str, np.ndarray], MotionHistory]:
    """Last move of each joint: covariates `move<k>` and `move<k>_side`, and the history; pose (n,): labels.

    `move<k>` (n,) rad, mm: how far it came from the configuration before; `move<k>_side` (n,): the direction in
    which it moved last, 0 before the first move.
    """
    static_limit = np.where(robot.prismatic, *_STATIC_LIMITS)
    moves = last_moves(variables, time, static_limit, pose)
    covariates = {f"move{k}": row for k, row in enumerate(moves, 1)}
    travel = np.where(robot.prismatic, *_TRAVEL)
    for k, side in enumerate(last_sides(moves, time, travel), 1):
        covariates[last_side(k)] = side
    return covariates, MotionHistory.of(moves, time)


def with_history(covariates: Mapping[str, np.ndarray], joints: int, n: int) -> dict:
    """Covariates of n targets with what the moves before would tell: a target has no history.

    Every joint is at the centre of its loop, unless `approach<k>` (n,), -1 or 1, states the side that it comes from:
    its friction is then fully wound up. What the covariates hold stays.
    """
    history = {}
    for k in range(1, joints + 1):
        side = covariates.get(f"approach{k}", np.zeros(n))
        history |= {
            f"approach{k}": side,
            f"move{k}": np.zeros(n),
            last_side(k): side,
            _wound(k): side,
        }
    return history | dict(covariates)


def _wound(joint: int) -> str:
    """Name of the covariate that holds the state of friction of a target, whatever the width."""
    return f"move{joint}_wound"


def approaches_read(effects) -> list[str]:
    """Columns `approach<k>` that state what these effects read of the moves before a sample."""
    found = [_HISTORY.fullmatch(name) for effect in effects for name in effect.reads]
    return sorted({f"approach{match[1]}" for match in found if match})


def sliding(robot: Robot) -> np.ndarray:
    """(R,) True for a reading in mm: that of a prismatic joint, or of the first joint that it drives."""
    joints, readings = robot.mixing.shape
    if joints == readings:
        joint_of_reading = np.arange(readings)
    else:
        joint_of_reading = np.argmax(robot.mixing != 0, axis=0)
    return robot.prismatic[joint_of_reading]


def reading_names(robot: Robot) -> list[str]:
    """R names of the columns of joint readings: q1_deg, or q1_mm for a reading in mm."""
    units = np.where(sliding(robot), "mm", "deg")
    return [f"q{number}_{unit}" for number, unit in enumerate(units.tolist(), 1)]
