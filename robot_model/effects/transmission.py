"""Effects between a joint's reading and its angle: gears, belts, encoders, clocks and heat."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robot_model.state import sliding
from workbench.core.covariates import clock, warmth, warmth_sizes
from workbench.core.effect import Effect
from workbench.core.errors import InputError


class TransmissionHarmonic(Effect):
    """Periodic error of the gear and the encoder of joint K. The phase is n times the joint variable q_K: after sign
    and coupling, without the offset theta.
    """

    effect = "transmission-harmonic"
    port = "joint"
    places = ("joint",)
    turning = True
    equation = "dq = A cos(n q) + B sin(n q)"
    source = "Ye et al., Sensors 24, 2559 (2024), eq. 16-17, there n = 1, 2"

    def __init__(self, where: str, order: Annotated[float, Field(gt=0)] = 1):
        super().__init__(where)
        self.order = order

    def table(self, chain):
        times = f"{self.order:g} times a turn"
        # 3e-4 rad is one minute of arc: what makers state as the accuracy of a robot's gears
        return tuple(
            self.parameter(
                f"{wave}{self.order:g}", "rad", 3e-4, f"joint {self.number}'s {wave} {times}"
            )
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.order * state.variables[self.number - 1]
        return np.stack([np.cos(phase), np.sin(phase)])[:, None]

    @property
    def title(self):
        return f"{self.effect} of order {self.order:g} at {self.where}"


class ConstantTerm(Effect):
    """The constant term of Ye's Fourier series: a joint offset under another name."""

    effect = "zero-offset"
    port = "joint"
    places = ("joint",)
    equation = "dq = k0"
    source = "Ye et al., Sensors 24, 2559 (2024), eq. 16"

    def table(self, chain):
        return (
            self.parameter(
                "k0", *_size(chain, self.number, 1e-3), f"the constant term of joint {self.number}"
            ),
        )

    def basis(self, state):
        return np.ones((1, 1, state.n))


class Backlash(Effect):
    """The joint stops short of its reading on the side that it came from.

    `seat="approach"`: the side of the last motion; `seat="gravity"`: the side to which gravity
    pulls, smooth where the torque is within `width` N m of zero (an absolute width, and not a share
    of the largest torque, so that the law means the same on any part of the samples).
    """

    effect = "backlash"
    port = "joint"
    places = ("joint",)
    equation = "dq = g * approach, or g * tanh(tau / width)"
    source = "half-gap model, e.g. Slamani, Nubiola & Bonev, Robotica 30 (2012)"

    def __init__(
        self,
        where: str,
        seat: Literal["approach", "gravity"] = "approach",
        width: Annotated[float, Field(gt=0)] = 0.5,
    ):
        super().__init__(where)
        self.seat, self.width = seat, width

    @property
    def needs(self):
        return (f"approach{self.number}",) if self.seat == "approach" else ()

    def table(self, chain):
        return (
            self.parameter(
                "half_gap", *_size(chain, self.number, 1e-3), f"joint {self.number}'s half gap"
            ),
        )

    def basis(self, state):
        if self.seat == "approach":
            return state.covariate(f"approach{self.number}")[None, None]
        return np.tanh(state.torque[self.number - 1] / self.width)[None, None]

    @property
    def elastic(self):
        return self.seat == "gravity"


class ZeroShift(Effect):
    """A belt slipped, the arm was hit or counts were lost: the zero of a joint jumps once.

    `after` is an instant in s where time was recorded, else the number of a row.
    """

    effect = "zero-shift"
    port = "joint"
    places = ("joint",)
    equation = "dq = a after an instant"
    source = "step change of a joint offset"

    def __init__(self, where: str, after: float):
        super().__init__(where)
        self.after = after

    def table(self, chain):
        label = f"joint {self.number}'s shift after {self.after:g}"
        return (self.parameter("shift", *_size(chain, self.number, 1e-3), label),)

    def basis(self, state):
        return (clock(state) > self.after).astype(float)[None, None]


class JointCoupling(Effect):
    """The motion of joint J moves joint K by a fixed ratio, in addition to `coupled` in the robot file."""

    effect = "joint-coupling"
    port = "joint"
    places = ("joint",)
    equation = "dq_K = c * q_J"
    source = "wrist gear coupling, e.g. Stone, Kinematic Modeling (1987), ch. 3"

    def __init__(self, where: str, joint: int):
        super().__init__(where)
        self.joint = joint

    def table(self, chain):
        if not 1 <= self.joint <= chain.robot.joints:
            expected = f"one of the arm's {chain.robot.joints} joints"
            raise InputError(
                f"{self.title}, option joint: expected {expected}, found {self.joint}; correct it"
            )
        unit, size = _size(chain, self.number, 1e-3)
        other, per = _size(chain, self.joint, 1.0)
        label = f"joint {self.number}'s share of joint {self.joint}"
        return (self.parameter(f"from{self.joint}", f"{unit}/{other}", size / per, label),)

    def basis(self, state):
        return state.variables[self.joint - 1][None, None]


class JointThermalDrift(Effect):
    """The encoder or gear of a joint drifts with temperature, or with time where none was recorded."""

    effect = "joint-thermal-drift"
    port = "joint"
    places = ("joint",)
    equation = "dq = c (T - T0)"
    source = "linear thermal drift of a joint offset"

    def table(self, chain):
        angle, kelvin = _size(chain, self.number, 1e-4)
        unit, size, prior = warmth_sizes(chain.state, kelvin, self.column)
        return (
            self.parameter(
                "per_unit", f"{angle}/{unit}", size, f"joint {self.number}'s drift", prior
            ),
        )

    def basis(self, state):
        return warmth(state, self.column)[None, None]

    @property
    def column(self):
        """Where the temperature of the joint itself would be recorded."""
        return f"temperature_j{self.number}_c"


class TimeOffset(Effect):
    """The readings were taken a moment before or after the measured point.

    Speeds are columns `qdot<k>_deg_s`, `qdot<k>_mm_s` of a reading that slides.
    """

    effect = "time-offset"
    port = "joint"
    places = ("time",)
    needs = ("qdot1_deg_s",)  # and those of all other readings
    equation = "dq = t qdot"
    source = "first-order clock offset"

    def table(self, chain):
        return (self.parameter("offset", "s", 1e-2, "the time offset"),)

    def basis(self, state):
        speeds = [
            state.covariate(f"qdot{k}_mm_s")
            if slides
            else np.deg2rad(state.covariate(f"qdot{k}_deg_s"))
            for k, slides in enumerate(sliding(state.robot), 1)
        ]
        return (state.robot.mixing @ np.stack(speeds))[None]


class ReadingLag(Effect):
    """The joints were read before the arm had come to rest, so that each is still short of where it will stand.

    Joints of one move start and stop together, so that all are short by one share of their last move.
    `law="braking"`: that joint which moves farthest is short by the same angle after every move, as when all are
    read a fixed moment before a uniform braking ends; `law="share"`: each by the same share of its own move. The
    order of the rows tells the moves.
    """

    effect = "reading-lag"
    port = "joint"
    places = ("time",)
    by_moves = True
    equation = "dq_K = e move_K / max_J |move_J|, or s move_K"
    source = "uniform braking: the way that is left at a fixed moment before the end is a t^2 / 2, of all moves alike"

    def __init__(self, where: str, law: Literal["braking", "share"] = "braking"):
        super().__init__(where)
        self.law = law

    def table(self, chain):
        if self.law == "share":
            return (
                self.parameter(
                    "share", "1", 1e-3, "the share of its last move that each joint is short by"
                ),
            )
        return (
            self.parameter("short", "rad", 1e-3, "what the joint that moved farthest is short by"),
        )

    def basis(self, state):
        moves = np.stack([state.covariate(f"move{k}") for k in range(1, state.robot.joints + 1)])
        if self.law == "share":
            return moves[None]
        metres = np.where(state.robot.prismatic, 1e-3, 1.0)[
            :, None
        ]  # a slide's metre counts as a radian
        return (moves / np.maximum(np.abs(moves * metres).max(0), 1e-9))[None]


def _size(chain, number: int, turn: float) -> tuple[str, float]:
    """Unit and typical size of a joint's error, `turn` rad; of a slide what that makes a metre away, in mm."""
    return ("mm", 1000 * turn) if chain.robot.prismatic[number - 1] else ("rad", turn)
