"""Changes in the course of a recording: a step of a pose, a tool that loosens, warming-up without a thermometer."""

from typing import Annotated

import numpy as np
from pydantic import Field

from robot_model.chain import growing_lengths
from robot_model.effects.extrapolation import change_after_recording, distance_beyond
from workbench.core.covariates import clock, instant_format, instants_between
from workbench.core.effect import Effect, Grid, Variant

_TWIST = (
    ("x", "mm", 0.1),
    ("y", "mm", 0.1),
    ("z", "mm", 0.1),
    ("rx", "rad", 3e-4),
    ("ry", "rad", 3e-4),
    ("rz", "rad", 3e-4),
)
_TIME_CONSTANTS = np.geomspace(0.03, 1.0, 10)  # of the recording's length
_GROWTH = 1e-4  # of a length, about ten kelvin


class AfterInstant:
    """Of effects that begin at an instant: `after`, in s where time was recorded, else the number of a row."""

    def __init__(self, where: str, after: float):
        super().__init__(where)
        self.after = after

    @classmethod
    def candidates(cls, chain):
        """None: `grids` has all instants."""
        return ()

    def instant(self, state) -> str:
        """`after 900 s` or `after row 12`."""
        return f"after {instant_format(state).format(self.after)}"


class RepeatedStep:
    """Of steps that may occur several times at one place: `occurrence` numbers those after the first, from 2.

    It is part of the keys of their parameters: "base.shift.x", "base.shift.x_2".
    """

    coexists = True

    def __init__(
        self, where: str, after: float, occurrence: Annotated[int | None, Field(ge=2)] = None
    ):
        super().__init__(where, after)
        self.occurrence = occurrence

    def name_of(self, name: str) -> str:
        """Name of a parameter, with the number of a repeated step."""
        if self.occurrence is None:
            return name
        return f"{name}_{self.occurrence}"


class Shift(RepeatedStep, AfterInstant, Effect):
    """A part of the machine changes its pose once, as after a bump, a slipped clamp or a bent link.

    Six numbers: the step of the twist at the place, in its own axes. That of a link turns about the middle of the link.
    `after` is an instant in s where time was recorded, else the number of a row. A step of the base is one of the
    session: a moved instrument makes the same, and the arm's own errors stay. A step of the tool is beyond
    the flange: a reflector that was remounted makes the same.
    """

    effect = "shift"
    port = "frame"
    places = ("tool", "base", "link")
    equation = "twist = d after an instant"
    source = "step change of a pose: change-point model, Basseville & Nikiforov, Detection of Abrupt Changes (1993)"
    reads = ("time",)

    def __init__(
        self, where: str, after: float, occurrence: Annotated[int | None, Field(ge=2)] = None
    ):
        super().__init__(where, after, occurrence)
        self.of_session = where == "base"
        self.beyond_flange = where == "tool"

    @classmethod
    def grids(cls, chain):
        """Any instant between two samples, but for the first and the last two; the last link is the tool."""
        instants = instants_between(chain.state)
        last = f"link-{chain.robot.joints}"
        for where in (w for place in cls.places for w in chain.places(place) if w != last):
            weights = np.ones(len(instants))
            sizes = tuple(size for _, _, size in _TWIST)
            if len(instants):
                label = f"after {instant_format(chain.state)}"
                yield Grid(cls, where, "after", "step", "time", instants, weights, sizes, label)

    def table(self, chain):
        label = f"the shift of {self.where} ({self.instant(chain.state)})"
        return tuple(
            self.parameter(self.name_of(name), unit, size, f"{label}, {name}")
            for name, unit, size in _TWIST
        )

    def basis(self, state):
        is_after = (clock(state) > self.after).astype(float)
        return np.eye(6)[:, :, None] * is_after


class TargetShift(RepeatedStep, AfterInstant, Effect):
    """A part of the machine moves once, as after a knock.

    It is one of several balls of an artefact or of several reflectors on the tool. Three numbers: the step of its
    coordinates, in the frame of the artefact or of the flange. `after` as of `Shift`.
    """

    effect = "shift"
    port = "target"
    places = ("ball", "reflector")
    of_session = True
    equation = "target K -> target K + d after an instant"
    source = Shift.source
    reads = ("time",)

    @classmethod
    def grids(cls, chain):
        """Any instant between two samples of one of several targets, but for its first and its last two."""
        targets = [w for place in cls.places for w in chain.places(place)]
        sizes = tuple(size for _, _, size in _TWIST[:3])
        label = f"after {instant_format(chain.state)}"
        for where in targets if len(targets) > 1 else ():
            is_own = cls(where, 0.0).is_observed(chain.state)
            instants = instants_between(chain.state, is_own)
            if len(instants):
                description = (
                    "after",
                    "step",
                    "time",
                    instants,
                    np.ones(len(instants)),
                    sizes,
                    label,
                )
                yield Grid(cls, where, *description, np.tile(is_own.astype(float), (3, 1)))

    def is_observed(self, state) -> np.ndarray:
        """(n,) bool: samples of this target."""
        return state.index == self.number

    def table(self, chain):
        label = f"the shift of {self.where} ({self.instant(chain.state)})"
        return tuple(
            self.parameter(self.name_of(axis), unit, size, f"{label}, {axis}")
            for axis, unit, size in _TWIST[:3]
        )

    def basis(self, state):
        is_after = (clock(state) > self.after) & self.is_observed(state)
        return np.eye(3)[:, :, None] * is_after.astype(float)


class Loosening(Effect):
    """The tool loosens: its deflection under its own weight grows during the recording.

    The sag grows linearly from `start` to `end`, in the unit of the clock: along each axis of the flange with the
    component of gravity along it, and as a rotation about the axis across the tool's z and gravity.
    """

    effect = "loosening"
    port = "frame"
    places = ("tool",)
    elastic = True
    equation = "twist = u(t) (c_i g_i, c_r z x g), u from 0 at start to 1 at end"
    source = "tool deflection with a compliance that grows linearly in time"
    reads = ("time",)

    def __init__(self, where: str, start: float, end: float):
        super().__init__(where)
        self.start, self.end = start, end

    @classmethod
    def candidates(cls, chain):
        """Over the whole recording."""
        time = clock(chain.state)
        if np.ptp(time) > 0:
            yield Variant(cls("tool", float(time.min()), float(time.max())))

    def table(self, chain):
        label = "the growth of the tool's sag"
        shifts = [self.parameter(f"sag_{a}", "mm", 0.1, f"{label} along {a}") for a in "xyz"]
        return (*shifts, self.parameter("tilt", "rad", 3e-4, f"{label}, rotation"))

    def basis(self, state):
        down = np.einsum("cin,i->cn", state.frames.link[-1], state.gravity)
        out = np.zeros((4, 6, state.n))
        out[range(3), range(3)] = down
        out[3, 3], out[3, 4] = -down[1], down[0]  # z x g in the axes of the flange
        grown = (clock(state) - self.start) / max(self.end - self.start, 1e-12)
        return out * np.clip(grown, 0.0, 1.0)

    def extrapolation(self, p, state, recorded=None):
        """(6, n): the sag may go on to grow as it did."""
        late = distance_beyond(clock(state), self.start, self.end)
        return np.abs(self.delta(p, state)) * late / max(self.end - self.start, 1e-12)


def warm_up_variants(kind, chain) -> list[Variant]:
    """Time constants of a share of the recording's length at every place, where no temperature is recorded."""
    time = clock(chain.state)
    start = float(time.min())
    span = float(np.ptp(time))
    if span <= 0 or any("temperature" in name for name in chain.state.covariates):
        return []
    mass = 1 / len(_TIME_CONSTANTS)
    found = []
    for where in (w for place in kind.places for w in chain.places(place)):
        for share in _TIME_CONSTANTS:
            constant = float(f"{share * span:.3g}")
            warm_up = kind(where, constant, start)
            word = f"with time constant {{:g}} {warm_up.option_unit(chain, 'time_constant')}"
            if np.any(warm_up.basis(chain.state)):
                description = (word.format(constant), mass, "temperature", "time_constant", word)
                found.append(Variant(warm_up, *description))
    return found


def warm_up_progress(state, time_constant: float, start: float) -> np.ndarray:
    """(n,) from 0 at the start to 1 in the steady state."""
    return -np.expm1(-np.maximum(clock(state) - start, 0.0) / time_constant)


class WarmUpLaw:
    """Base class of warm-up effects: a steady value is approached with one time constant."""

    effect = "warm-up"
    source = "first-order lag of a thermal mass: ISO 230-3, thermal distortion of rotating axes"
    reads = ("time",)

    def __init__(
        self, where: str, time_constant: Annotated[float, Field(gt=0)], start: float = 0.0
    ):
        super().__init__(where)
        self.time_constant, self.start = time_constant, start

    @classmethod
    def candidates(cls, chain):
        """With time constants of a share of the recording's length, where no temperature is recorded."""
        return warm_up_variants(cls, chain)

    def option_unit(self, chain, name):
        return "s" if "time_s" in chain.state.covariates else "samples"

    def extrapolation(self, p, state, recorded=None):
        return change_after_recording(self, p, state, recorded)


class JointWarmUp(WarmUpLaw, Effect):
    """Joint K warms up and its zero drifts to a steady value, with one time constant and no temperature recorded."""

    port = "joint"
    places = ("joint",)
    equation = "dq = c (1 - exp(-(t - start) / T))"

    def table(self, chain):
        unit = "mm" if chain.slides(self.number) else "rad"
        size = {"mm": 0.05, "rad": 3e-4}[unit]
        return (self.parameter("final", unit, size, f"joint {self.number}'s drift by warming up"),)

    def basis(self, state):
        return warm_up_progress(state, self.time_constant, self.start)[None, None]


class LinkWarmUp(WarmUpLaw, Effect):
    """Link K warms up and grows to a steady length, with one time constant and no temperature recorded."""

    port = "geometry"
    places = ("link",)
    equation = "the lengths d, a of the link, and the travel of a slide, grow by c (1 - exp(-(t - start) / T)) of them"

    def port_indices(self, chain):
        return growing_lengths(chain.robot, chain.state.variables, self.number)[0]

    def table(self, chain):
        return (
            self.parameter("final", "1", _GROWTH, f"link {self.number}'s growth by warming up"),
        )

    def basis(self, state):
        lengths = growing_lengths(state.robot, state.variables, self.number)[1]
        return (lengths * warm_up_progress(state, self.time_constant, self.start))[None]


class BaseWarmUp(WarmUpLaw, Effect):
    """The base warms up and moves to a steady pose, with one time constant and no temperature recorded."""

    port = "frame"
    places = ("base",)
    of_session = True
    equation = "twist = c (1 - exp(-(t - start) / T))"

    def table(self, chain):
        return tuple(
            self.parameter(name, unit, size, f"the base's drift by warming up, {name}")
            for name, unit, size in _TWIST
        )

    def basis(self, state):
        return np.eye(6)[:, :, None] * warm_up_progress(state, self.time_constant, self.start)


__all__ = [
    "AfterInstant",
    "BaseWarmUp",
    "JointWarmUp",
    "LinkWarmUp",
    "Loosening",
    "RepeatedStep",
    "Shift",
    "TargetShift",
    "warm_up_progress",
    "warm_up_variants",
]
