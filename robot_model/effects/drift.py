"""Effects of heat and time on joints, links and base, and axes that run out."""

from typing import Annotated

import numpy as np
from pydantic import Field

from robot_model.chain import THETA, growing_lengths
from robot_model.effects.extrapolation import change_after_recording
from robot_model.effects.transmission import size_of, turning_joints
from workbench.core.covariates import (
    clock,
    limit_expansion,
    missing_temperature,
    warmth,
    warmth_sizes,
)
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError

# by the order of the polynomial: fewer parameters show smaller drifts; a random walk has all orders
_SHAPES = {1: "evenly", 2: "with one bend", 3: "with two bends", 12: "as a random walk"}
_MOVES_RAD = 0.2  # range of a joint below which no cycle is distinguishable


class LinkThermalGrowth(Effect):
    """A link grows with temperature, or with time where none was recorded.

    The scale or the screw of a slide grows, too: its reading counts as a length from where it is zero.
    """

    effect = "link-thermal-growth"
    port = "geometry"
    places = ("link",)
    equation = "the lengths d, a of the link, and the travel of a slide, grow by c (T - T0) of them"
    source = "linear expansion"
    reads = ("temperature",)
    unrecorded = "temperature"

    @classmethod
    def candidates(cls, chain):
        """At every link that has a length, with time where no temperature is recorded."""
        for growth in map(cls, chain.places("link")):
            limit_expansion(growth, chain.state, growth.column)
            if growing_lengths(chain.robot, chain.state.variables, growth.number)[1].any():
                yield Variant(
                    growth, missing_covariate=missing_temperature(chain.state, growth.column)
                )

    def port_indices(self, chain):
        return growing_lengths(chain.robot, chain.state.variables, self.number)[0]

    def table(self, chain):
        unit, size, prior = warmth_sizes(chain.state, 1e-5, self.column)
        return (
            self.parameter("per_unit", f"1/{unit}", size, f"link {self.number}'s growth", prior),
        )

    def basis(self, state):
        lengths = growing_lengths(state.robot, state.variables, self.number)[1]
        return (lengths * warmth(state, self.column))[None]

    def extrapolation(self, p, state, recorded=None):
        return change_after_recording(self, p, state, recorded)

    @property
    def column(self):
        """Name of the column for the temperature of the link itself."""
        return f"temperature_link{self.number}_c"


class JointThermalDrift(Effect):
    """The encoder or gear of a joint drifts with temperature, or with time where none was recorded."""

    effect = "joint-thermal-drift"
    port = "joint"
    places = ("joint",)
    equation = "dq = c (T - T0)"
    source = "linear thermal drift of a joint offset"
    reads = ("temperature",)
    unrecorded = "temperature"

    @classmethod
    def candidates(cls, chain):
        """At every joint, with time where no temperature is recorded."""
        for drift in map(cls, chain.places("joint")):
            yield Variant(drift, missing_covariate=missing_temperature(chain.state, drift.column))

    def table(self, chain):
        angle, kelvin = size_of(chain, self.number, 1e-4)
        unit, size, prior = warmth_sizes(chain.state, kelvin, self.column)
        return (
            self.parameter(
                "per_unit", f"{angle}/{unit}", size, f"joint {self.number}'s drift", prior
            ),
        )

    def basis(self, state):
        return warmth(state, self.column)[None, None]

    def extrapolation(self, p, state, recorded=None):
        return change_after_recording(self, p, state, recorded)

    @property
    def column(self):
        """Name of the column for the temperature of the joint itself."""
        return f"temperature_j{self.number}_c"


class BaseDrift(Effect):
    """The base drifts: a twist about its origin, in the base frame, of Legendre polynomials P_1 to P_order in time.

    t runs from -1 at `start` to 1 at `end`, which are instants in the unit of the clock. Before and after them the base
    stays where it was last: a polynomial predicts nothing beyond the instants that it was fitted to.
    """

    effect = "base-drift"
    port = "frame"
    places = ("base",)
    equation = "twist = sum_k c_k P_k(t), constant before t = -1 and after t = 1"
    source = (
        "Legendre polynomials on the span of the fitted samples, constant left to the base pose"
    )
    reads = ("time",)
    of_session = True
    stage = "drift"

    def __init__(
        self, where: str, start: float, end: float, order: Annotated[int, Field(ge=1, le=20)] = 3
    ):
        super().__init__(where)
        if end <= start:
            raise InputError(
                f"effect '{self.effect}', options start and end: expected an end after the start, "
                f"found {start:g} and {end:g}; correct them"
            )
        self.start, self.end, self.order = start, end, order

    @classmethod
    def candidates(cls, chain):
        """Polynomials of degree 1 to 3 over the recording, and one of a degree that follows a random walk.

        The coefficients of a Wiener process fall with their order k as 1 / k, and so do the typical sizes: with these
        as its prior the polynomial is a Gaussian process in time.
        """
        time = clock(chain.state)
        start = float(time.min())
        end = float(time.max())
        if end > start:
            for order, shape in _SHAPES.items():
                yield Variant(cls("base", start, end, order), shape)

    @classmethod
    def planned(cls, chain):
        """Over the recording, of the default degree."""
        time = clock(chain.state)
        span = {"start": float(time.min()), "end": float(time.max())}
        if span["end"] > span["start"]:
            return [("base", span)]
        return []

    def table(self, chain):
        names = [
            ("x", "mm", 0.05),
            ("y", "mm", 0.05),
            ("z", "mm", 0.05),
            ("rx", "rad", 1e-4),
            ("ry", "rad", 1e-4),
            ("rz", "rad", 1e-4),
        ]
        return tuple(
            self.parameter(f"{name}_t{k}", unit, size / k, f"the base's drift in {name}, order {k}")
            for k in range(1, self.order + 1)
            for name, unit, size in names
        )

    def basis(self, state):
        duration = max(self.end - self.start, 1e-12)
        time = 2 * (clock(state) - self.start) / duration - 1
        waves = np.polynomial.legendre.legvander(np.clip(time, -1.0, 1.0), self.order)
        components = np.eye(6)[:, :, None]
        return np.concatenate([components * wave for wave in waves.T[1:]])


class AxisRunOut(Effect):
    """The axis of joint K moves radially once a revolution: dx, dy across it, in the frame before the joint rotates."""

    effect = "axis-run-out"
    port = "frame"
    places = ("joint",)
    components = (0, 1)
    turning = True
    equation = "dx = A cos q + B sin q, dy = C cos q + D sin q"
    source = "radial error motion of an axis of rotation: ISO 230-7"

    @property
    def reads(self):
        return (f"q{self.number}",)

    @classmethod
    def candidates(cls, chain):
        """At every joint that rotates far enough."""
        return [Variant(cls(where)) for where in turning_joints(chain, _MOVES_RAD)]

    def port_indices(self, chain):
        """x and y of a frame whose z is joint K's axis: distal, the one before it; Craig, the one after it."""
        if chain.robot.convention == "craig":
            last = self.number
        else:
            last = self.number - 1
        return chain.port_indices(self.port, f"link-{last}" if last else "base", self.components)

    def table(self, chain):
        return tuple(
            self.parameter(
                f"{axis}_{wave}", "mm", 0.02, f"joint {self.number}'s run-out {axis} {wave}"
            )
            for axis in "xy"
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = state.variables[self.number - 1]
        waves = np.stack([np.cos(phase), np.sin(phase)])
        return np.einsum("ijn,wn->iwjn", self._axes(state), waves).reshape(4, 2, state.n)

    def _axes(self, state):
        """(2, 2, n) the fixed x and y across the axis, in the frame of the components; Craig's turns with the joint."""
        turned = state.robot.convention == "craig"
        angle = turned * (
            state.variables[self.number - 1] + state.robot.geometry[self.number - 1, THETA]
        )
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
