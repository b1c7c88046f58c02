"""Effects between a joint's reading and its angle: gears, belts, encoders, clocks and heat."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.steps import AfterInstant, RepeatedStep
from robot_model.state import sliding
from workbench.core.covariates import (
    clock,
    instant_format,
    instants_between,
    last_side,
    reversals,
)
from workbench.core.effect import Effect, Grid, Variant

# prior weight of the low orders: eccentric gears and encoders make one and two cycles a revolution; more are rarer
_LOW_ORDERS = {1: 0.3, 2: 0.3, 3: 0.1, 4: 0.1}
_HIGH_ORDERS = 0.2  # of all orders beyond these together
# strain wave gears of arms have ratios up to 161 and make two cycles a revolution of their wave generator
_HIGHEST_ORDER, _HIGHEST_HALF, _HALF_WEIGHT = 322.0, 40.0, 0.2
_MOVES_RAD = 0.2  # range of a joint below which no order is distinguishable
PLANNED_RAD = 0.35  # and below which the default plan fits none
_TYPICAL = {"rad": 3e-4, "mm": 0.05}  # of a step or amplitude that is searched for
_REVERSALS = 4  # of a joint, from which on its side is no step, as a shift of its zero is
_LOADED_NM = 0.02  # variation of a load below which nothing deflects measurably
_SHARP_NM, _SHARP = (
    0.5,
    0.01,
)  # width of a sharp change of side, also as a share of the largest torque
# shares of the largest torque over which a gap closes, and the prior weight of each relative to a sharp change
_CLOSING, _CLOSING_WEIGHT = (0.05, 0.1, 0.2), 0.3
WITHOUT_HOSE = (
    "measure the same poses with another load, and once more without the hose or the spring"
)
"""A deflection grows with the load; the torque of a hose or a spring ends where this is taken off."""


class TransmissionHarmonic(Effect):
    """Joint K has a transmission error of its gear or encoder that is periodic in its angle.

    Its order n is in cycles per revolution. The phase is n times the angle of the joint's drive: the joint variable
    q_K, without what the drives of other joints move it by. The offset theta is not in it.
    """

    effect = "transmission-harmonic"
    port = "joint"
    places = ("joint",)
    turning = True
    equation = "dq = A cos(n q) + B sin(n q)"
    source = "Ye et al., Sensors 24, 2559 (2024), eq. 16-17, there n = 1, 2"
    coexists = True
    stage = "transmission"
    plant_weight = 0.5

    def __init__(self, where: str, order: Annotated[float, Field(gt=0)] = 1):
        super().__init__(where)
        self.order = order

    @property
    def reads(self):
        return (f"q{self.number}",)

    @property
    def confounded_with(self):
        """A spring between two links pulls with a lever that is nearly a harmonic of the first order."""
        is_first = self.order == 1
        return (("joint-torque", self.where, "of a spring or a hose"),) if is_first else ()

    @property
    def distinguished_by(self):
        """A deflection grows with the load; the torque of a hose or a spring ends where this is taken off."""
        return WITHOUT_HOSE if self.order == 1 else ""

    @classmethod
    def candidates(cls, chain):
        """The orders 1 to 4 at every joint that rotates far enough."""
        for where in turning_joints(chain, _MOVES_RAD):
            for order, weight in _LOW_ORDERS.items():
                yield Variant(cls(where, float(order)), f"order {order}", weight)

    @classmethod
    def grids(cls, chain):
        """The orders from 4.5 to 322 at the same joints, and those of the motor where the gear ratio is stated."""
        for where in turning_joints(chain, _MOVES_RAD):
            number = cls(where).number
            orders, weights = high_orders(chain.robot.gear_ratio[number - 1])
            yield Grid(
                cls,
                where,
                "order",
                "wave",
                f"q{number}",
                orders,
                _HIGH_ORDERS * weights,
                _TYPICAL["rad"],
                "order {:g}",
            )

    @classmethod
    def planned(cls, chain):
        """Once and twice a revolution, at every joint that rotates far enough."""
        for where in turning_joints(chain, PLANNED_RAD):
            yield from ((where, {"order": order}) for order in (1, 2))

    @classmethod
    def planted(cls, readings, joint, rng):
        """Of order 2, 3 or 4, with a random phase."""
        order = int(rng.choice([2, 3, 4]))
        phase = rng.uniform(-np.pi, np.pi)
        return {"order": order}, np.cos(order * readings.angles[joint - 1] + phase)

    def table(self, chain):
        cycles = "cycle" if self.order == 1 else "cycles"
        frequency = f"{self.order:g} {cycles} per revolution"
        # 3e-4 rad is one minute of arc: what makers state as the accuracy of a robot's gears
        return tuple(
            self.parameter(
                f"{wave}{self.order:g}", "rad", 3e-4, f"joint {self.number}'s {wave} {frequency}"
            )
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.order * state.drive_angles[self.number - 1]
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

    @classmethod
    def candidates(cls, chain):
        """None: every baseline contains the joint offsets."""
        return ()

    def table(self, chain):
        return (
            self.parameter(
                "k0",
                *size_of(chain, self.number, 1e-3),
                f"the constant term of joint {self.number}",
            ),
        )

    def basis(self, state):
        return np.ones((1, 1, state.n))


def _reverses(chain, joint: int) -> bool:
    """Whether a joint came from both sides in turn."""
    side = chain.state.covariates.get(last_side(joint), np.zeros(chain.n))
    return reversals(side, clock(chain.state)) >= _REVERSALS


class Backlash(Effect):
    """The joint differs from its reading by half the gap, to one side or the other.

    `seat="approach"`: the side of the last motion, as recorded; `seat="moves"`: that side by the moves from sample to
    sample, where no side was recorded and the arm moved straight on; `seat="gravity"`: the side to which gravity
    pulls, smooth where the torque is within `width` N m of zero (an absolute width, and not a share of the largest
    torque, so that the law means the same on any part of the samples).
    """

    effect = "backlash"
    port = "joint"
    places = ("joint",)
    equation = "dq = g * approach, g * sign(last move), or g * tanh(tau / width)"
    source = "half-gap model, e.g. Slamani, Nubiola & Bonev, Robotica 30 (2012)"
    unrecorded = "approach"
    stage = "transmission"

    def __init__(
        self,
        where: str,
        seat: Literal["approach", "gravity", "moves"] = "approach",
        width: Annotated[float, Field(gt=0)] = _SHARP_NM,
    ):
        super().__init__(where)
        self.seat, self.width = seat, width

    @property
    def needs(self):
        if self.seat == "approach":
            return (f"approach{self.number}",)
        return ()

    @property
    def reads(self):
        if self.seat == "gravity":
            return (f"tau{self.number}",)
        return f"approach{self.number}", f"move{self.number}"

    @property
    def confounded_with(self):
        """A gap that gravity closes softly, next to a compliance, is the curve of a gear that stiffens under load.

        Tuttle & Seering, IEEE Trans. Robot. Autom. 12 (1996) 368; Kircanski & Goldenberg, Int. J. Robot. Res. 16
        (1997) 214.
        """
        if self.seat != "gravity" or self.width <= _SHARP_NM:
            return ()
        return ((JointCompliance.effect, self.where, "of a gear that stiffens under load"),)

    @classmethod
    def candidates(cls, chain):
        """By the side of approach, recorded or else that of the last move; by gravity where the torque changes sign."""
        for where in chain.places("joint"):
            backlash = cls(where)
            if all(chain.varies(name) for name in backlash.needs):
                yield Variant(backlash, "by the side of approach")
            elif backlash.needs[0] not in chain.state.covariates and _reverses(
                chain, backlash.number
            ):
                yield Variant(cls(where, "moves"), "by the side of the last move")
            yield from cls._by_gravity(chain, where, chain.state.torque[backlash.number - 1])

    @classmethod
    def _by_gravity(cls, chain, where, torque):
        """A sharp change of side, and softer ones of several widths."""
        if np.ptp(torque) <= _LOADED_NM or not torque.min() < 0 < torque.max():
            return
        if not chain.state.has_masses:
            return
        greatest = float(np.abs(torque).max())
        seated = cls(where, "gravity", min(_SHARP_NM, _SHARP * greatest))
        yield Variant(seated, "seated by gravity")
        word = f"seated by gravity, softly within {{:g}} {seated.option_unit(chain, 'width')}"
        for share in _CLOSING:
            width = float(f"{share * greatest:.3g}")
            description = (word.format(width), _CLOSING_WEIGHT, "", "width", word)
            yield Variant(cls(where, "gravity", width), *description)

    def option_unit(self, chain, name):
        return "N" if chain.slides(self.number) else "N m"

    @classmethod
    def planned(cls, chain):
        """By the recorded side of approach, at every joint that rotates far enough."""
        for where in turning_joints(chain, PLANNED_RAD):
            if all(chain.varies(name) for name in cls(where).needs):
                yield where, {}

    def table(self, chain):
        return (
            self.parameter(
                "half_gap", *size_of(chain, self.number, 1e-3), f"joint {self.number}'s half gap"
            ),
        )

    def basis(self, state):
        if self.seat == "approach":
            return state.covariate(f"approach{self.number}")[None, None]
        if self.seat == "moves":
            return state.covariate(last_side(self.number))[None, None]
        return np.tanh(state.torque[self.number - 1] / self.width)[None, None]

    @property
    def elastic(self):
        return self.seat == "gravity"

    @property
    def by_moves(self):
        return self.seat == "moves"


class ZeroShift(RepeatedStep, AfterInstant, Effect):
    """A belt slipped, the arm was hit or counts were lost: the zero of a joint jumps once.

    `after` is an instant in s where time was recorded, else the number of a row.
    """

    effect = "zero-shift"
    port = "joint"
    places = ("joint",)
    equation = "dq = a after an instant"
    source = "step change of a joint offset"
    reads = ("time",)
    plant_weight = 0.3

    @classmethod
    def grids(cls, chain):
        """Any instant between two samples, but for the first and the last two."""
        instants = instants_between(chain.state)
        if not len(instants):
            return
        for where in chain.places("joint"):
            size = _TYPICAL["mm" if chain.slides(cls(where, 0.0).number) else "rad"]
            weights = np.ones(len(instants))
            label = f"after {instant_format(chain.state)}"
            yield Grid(cls, where, "after", "step", "time", instants, weights, size, label)

    @classmethod
    def planted(cls, readings, joint, rng):
        """At a random pose in the middle 40 % of the recording."""
        first = int(len(readings.poses) * rng.uniform(0.3, 0.7))
        return {"row": first}, (readings.poses >= readings.poses[first]).astype(float)

    def table(self, chain):
        label = f"joint {self.number}'s shift ({self.instant(chain.state)})"
        name = self.name_of("shift")
        return (self.parameter(name, *size_of(chain, self.number, 1e-3), label),)

    def basis(self, state):
        return (clock(state) > self.after).astype(float)[None, None]


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
    reads = ("speed",)
    unrecorded = "speed"
    of_session = True

    @classmethod
    def candidates(cls, chain):
        """One, where the speeds of all joints are recorded."""
        names = (
            f"qdot{k}_mm_s" if chain.slides(k) else f"qdot{k}_deg_s"
            for k in range(1, chain.robot.joints + 1)
        )
        if all(name in chain.state.covariates for name in names):
            yield Variant(cls("time"))

    def table(self, chain):
        return (self.parameter("offset", "s", 1e-2, "the time offset"),)

    def basis(self, state):
        speeds = [
            state.covariate(f"qdot{k}_mm_s")
            if slides
            else np.deg2rad(state.covariate(f"qdot{k}_deg_s"))
            for k, slides in enumerate(sliding(state.robot), 1)
        ]
        variables = state.robot.mixing @ np.stack(speeds)
        return state.robot.drive_motion(variables)[None]


class ReadingLag(Effect):
    """The joints were read before the arm had come to rest, so that each angle is short of its final value.

    Joints of one move start and stop together, so that all are short by one share of their last move.
    `law="braking"`: that joint which moves farthest is short by the same angle after every move, as when all are
    read a fixed moment before a uniform braking ends; `law="share"`: each by the same share of its own move. The
    order of the rows tells the moves.

    An arm that is still moving is short of its target, so that neither number can be negative. Readings that are ahead
    of the measured points along the path are a clock offset between joint log and instrument (`time-offset`).
    """

    effect = "reading-lag"
    port = "joint"
    places = ("time",)
    by_moves = True
    nonnegative = 1
    equation = "dq_K = e move_K / max_J |move_J|, or s move_K"
    source = "uniform braking: the remaining way at a fixed time before the end is a t^2 / 2, the same for all moves"
    reads = ("move",)
    of_session = True

    @classmethod
    def candidates(cls, chain):
        """Both laws, where the order of the rows gives the last moves."""
        joints = range(1, chain.robot.joints + 1)
        if all(f"move{k}" in chain.state.covariates for k in joints):
            yield Variant(cls("time", "braking"), "read while braking")
            yield Variant(cls("time", "share"), "by a share of the move")

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


def high_orders(ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Orders (V,) from 4.5 on that a gear may have, and the prior weight of each; the weights add up to 1.

    ratio: motor revolutions per joint revolution, nan where it is unknown. Integer orders, half-integer ones up to 40,
    and one and two cycles a motor revolution, which get half of the weight each where the ratio is known.
    """
    halves = np.arange(4.5, _HIGHEST_HALF, 1.0)
    orders = np.concatenate([np.arange(5.0, _HIGHEST_ORDER + 1), halves])
    weights = np.concatenate(
        [np.ones(len(orders) - len(halves)), np.full(len(halves), _HALF_WEIGHT)]
    )
    if np.isfinite(ratio):
        motor = np.abs(ratio) * np.array([1.0, 2.0])
        is_other_order = ~np.isin(orders, motor)
        orders = np.concatenate([orders[is_other_order], motor])
        weights = np.concatenate(
            [weights[is_other_order] / weights[is_other_order].sum(), [0.5, 0.5]]
        )
    order = np.argsort(orders)
    return orders[order], weights[order] / weights.sum()


def turning_joints(chain, min_range: float) -> list[str]:
    """`joint-K` of the revolute joints whose angle varies by more than `min_range` rad."""
    ranges = np.ptp(chain.state.drive_angles, axis=1)
    return [
        f"joint-{k}"
        for k, moved in enumerate(ranges, 1)
        if moved > min_range and not chain.slides(k)
    ]


def size_of(chain, number: int, turn: float) -> tuple[str, float]:
    """Unit and typical size of a joint's error, `turn` rad; of a slide what that makes a metre away, in mm."""
    if chain.robot.prismatic[number - 1]:
        return ("mm", 1000 * turn)
    return ("rad", turn)
