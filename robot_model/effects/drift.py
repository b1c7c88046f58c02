"""Effects of heat and time on links and base, and axes that run out."""

from typing import Annotated

import numpy as np
from pydantic import Field

from robot_model.chain import THETA, A, D
from workbench.core.covariates import clock, warmth, warmth_sizes
from workbench.core.effect import Effect
from workbench.core.errors import InputError


class LinkThermalGrowth(Effect):
    """A link grows with temperature, or with time where none was recorded."""

    effect = "link-thermal-growth"
    port = "geometry"
    places = ("link",)
    components = (D, A)
    equation = "(d, a) grow by c (T - T0) (d, a)"
    source = "linear expansion"

    def table(self, chain):
        unit, size, prior = warmth_sizes(chain.state, 1e-5, self.column)
        return (
            self.parameter("per_unit", f"1/{unit}", size, f"link {self.number}'s growth", prior),
        )

    def basis(self, state):
        lengths = state.robot.geometry[self.number - 1, [D, A]]
        return (lengths[:, None] * warmth(state, self.column))[None]

    @property
    def column(self):
        """Where the temperature of the link itself would be recorded."""
        return f"temperature_link{self.number}_c"


class BaseDrift(Effect):
    """The base drifts: a twist about its origin, in the base frame, of Legendre polynomials P_1 to P_order in time.

    t runs from -1 at `start` to 1 at `end`, which are instants in the unit of the clock.
    """

    effect = "base-drift"
    port = "frame"
    places = ("base",)
    equation = "twist = sum_k c_k P_k(t)"
    source = "Legendre polynomials on the span of the recording, constant left to the base pose"

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
            self.parameter(f"{name}_t{k}", unit, size, f"the base's drift in {name}, order {k}")
            for k in range(1, self.order + 1)
            for name, unit, size in names
        )

    def basis(self, state):
        time = 2 * (clock(state) - self.start) / max(self.end - self.start, 1e-12) - 1
        waves = np.polynomial.legendre.legvander(time, self.order).T[1:]
        return np.concatenate([np.eye(6)[:, :, None] * wave for wave in waves])


class AxisRunOut(Effect):
    """The axis of joint K moves radially once a revolution: dx, dy across it, in the frame before the joint turns."""

    effect = "axis-run-out"
    port = "frame"
    places = ("joint",)
    components = (0, 1)
    turning = True
    equation = "dx = A cos q + B sin q, dy = C cos q + D sin q"
    source = "radial error motion of an axis of rotation: ISO 230-7"

    def slots(self, chain):
        """x and y of a frame whose z is joint K's axis: distal, the one before it; Craig, the one after it."""
        last = self.number if chain.robot.convention == "craig" else self.number - 1
        return chain.slots(self.port, f"link-{last}" if last else "base", self.components)

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
        """(2, 2, n) the fixed x and y across the axis, in the frame of the slots; Craig's turns with the joint."""
        turned = state.robot.convention == "craig"
        angle = turned * (
            state.variables[self.number - 1] + state.robot.geometry[self.number - 1, THETA]
        )
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
