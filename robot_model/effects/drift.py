"""Effects of heat and time on links and base, and axes that run out."""

import numpy as np

from robot_model.chain import A, D
from robot_model.effects.covariates import clock, warmth
from workbench.core.effect import Effect


class LinkThermalGrowth(Effect):
    """A link grows with temperature, or with time where none was recorded."""

    effect = "link-thermal-growth"
    port = "geometry"
    places = ("link",)
    components = (D, A)
    equation = "(d, a) grow by c (T - T0) (d, a)"
    source = "linear expansion"

    def parameters(self, chain):
        return (self.parameter("per_unit", "1/unit", 1e-5, f"link {self.number}'s growth"),)

    def basis(self, state):
        lengths = state.robot.geometry[self.number - 1, [D, A]]
        return (lengths[:, None] * warmth(state, f"temperature_link{self.number}_c"))[None]


class BaseDrift(Effect):
    """The base wanders: six numbers times smooth functions of time, Legendre polynomials 1..order.

    `start` and `end` are the instants that the polynomials span, in the unit of the clock.
    """

    effect = "base-drift"
    port = "frame"
    places = ("base",)
    equation = "twist = sum_k c_k P_k(t)"
    source = "Legendre polynomials on the span of the recording, constant left to the base pose"

    def __init__(self, where: str, start: float, end: float, order: int = 3):
        super().__init__(where)
        self.start, self.end, self.order = start, end, order

    def parameters(self, chain):
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
    """The axis of joint K moves across itself once a turn, as the bearing's seat is off."""

    effect = "axis-run-out"
    port = "frame"
    places = ("joint",)
    components = (0, 1)
    equation = "dx = A cos q + B sin q, dy = C cos q + D sin q"
    source = "radial error motion of an axis of rotation: ISO 230-7"

    def slots(self, chain):
        """Across the axis means across z of the frame before joint K (exact for distal arms)."""
        before = f"link-{self.number - 1}" if self.number > 1 else "base"
        return chain.slots(self.port, before, self.components)

    def parameters(self, chain):
        return tuple(
            self.parameter(f"{axis}_{wave}", "mm", 0.02, f"joint {self.number}'s run-out {axis} {wave}")
            for axis in "xy"
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = state.variables[self.number - 1]
        waves = np.stack([np.cos(phase), np.sin(phase)])
        return np.einsum("ij,wn->iwjn", np.eye(2), waves).reshape(4, 2, state.n)
