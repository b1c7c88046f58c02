"""Laws that a robot's sensor and a scanner share: one definition each, on whatever port and state they act.

A package makes an effect of a law by `class RangeScale(RangeScaleLaw, Effect)` with its `port`, and says
there which candidates a diagnosis tests. A state gives `points` (3, n) mm, the measured point in the
sensor frame; `field` (2, n), its place in the sensor's field; `ball` (n,), the number of the ball; and
`target` (3, n) mm, the nominal point. What an observation does not have is nan, and then nothing acts.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from workbench.core.covariates import known, warmth, warmth_sizes

AXES = ("x", "y", "z")


class RangeScaleLaw:
    """The range is off by a share of the distance from a middle range."""

    effect = "range-scale"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c (z - z0)"
    source = "first-order range error of a triangulation sensor"

    def __init__(self, where: str, z0: float = 0.0):
        super().__init__(where)
        self.z0 = z0

    def table(self, chain):
        """One scale, mm/mm."""
        return (self.parameter("scale", "mm/mm", 1e-3, "the range scale"),)

    def basis(self, state):
        """(1, 1, n) distance from the middle range, mm."""
        return known(state.points[2] - self.z0)[None, None]


class LateralScaleLaw:
    """One lateral coordinate is off by a share of itself: x of a profiler, x or y of a 3-D camera."""

    effect = "lateral-scale"
    places = ("sensor",)
    source = "first-order scale error of a triangulation sensor across its range"
    equation = "dx = c x, or dy = c y"

    def __init__(self, where: str, axis: Literal["x", "y"] = "x"):
        super().__init__(where)
        self.axis = axis

    @property
    def components(self):
        """The axis that errs."""
        return (AXES.index(self.axis),)

    def table(self, chain):
        """One scale, mm/mm."""
        return (self.parameter(f"scale_{self.axis}", "mm/mm", 1e-3, f"the scale of {self.axis}"),)

    def basis(self, state):
        """(1, 1, n) the coordinate, mm."""
        return known(state.points[AXES.index(self.axis)])[None, None]


class FieldBiasLaw:
    """The range is off by a quadratic polynomial of the place in the field."""

    effect = "field-bias"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c1 x + c2 y + c3 x^2 + c4 x y + c5 y^2"
    source = "second-order expansion of the remaining error of a camera or light-plane model"

    def table(self, chain):
        """Five coefficients, mm."""
        return tuple(
            self.parameter(name, "mm", 0.02, f"the field bias in {name}")
            for name in ("x", "y", "xx", "xy", "yy")
        )

    def basis(self, state):
        """(5, 1, n) the polynomials."""
        x, y = state.field
        return known(np.stack([x, y, x * x, x * y, y * y]))[:, None]


class BallPositionLaw:
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    effect = "ball-position"
    port = "target"
    places = ("ball",)
    equation = "ball K -> ball K + d"
    source = "one free vector a ball"

    def table(self, chain):
        """The vector, mm."""
        return tuple(
            self.parameter(axis, "mm", 0.05, f"ball {self.number}'s error along {axis}")
            for axis in "xyz"
        )

    def basis(self, state):
        """(3, 3, n) the identity where it is this ball."""
        return np.eye(3)[:, :, None] * (state.ball == self.number).astype(float)


class ArtefactExpansionLaw:
    """The artefact grows with temperature, or with time where none was recorded."""

    effect = "artefact-expansion"
    port = "target"
    places = ("artefact",)
    equation = "X -> X (1 + c (T - T0))"
    source = "linear expansion about the artefact's origin"
    column = "temperature_artefact_c"
    reads = ("temperature",)
    unrecorded = "temperature"

    def table(self, chain):
        """One coefficient of expansion."""
        unit, size, prior = warmth_sizes(chain.state, 1e-5, self.column)
        return (self.parameter("per_unit", f"1/{unit}", size, "the artefact's expansion", prior),)

    def basis(self, state):
        """(1, 3, n) the nominal point times the temperature above the reference."""
        return (known(state.target) * warmth(state, self.column))[None]


class NoiseLaw:
    """The spread, not the mean, depends on a covariate."""

    effect = "noise-heteroscedastic"
    port = "noise"
    places = ("noise",)
    equation = "log sigma -> log sigma + c (s - mean s) / spread of s"
    source = "log-linear variance model: Harvey, Econometrica 44 (1976)"

    def __init__(
        self,
        where: str,
        covariate: str,
        mean: float = 0.0,
        spread: Annotated[float, Field(gt=0)] = 1.0,
    ):
        super().__init__(where)
        self.covariate, self.mean, self.spread = covariate, mean, spread

    @property
    def needs(self):
        """The covariate."""
        return (self.covariate,)

    @property
    def reads(self):
        """The covariate."""
        return (self.covariate,)

    @classmethod
    def candidates(cls, chain):
        """None: the diagnosis tests the variance apart from the mean."""
        return ()

    def table(self, chain):
        """One slope, per spread of the covariate."""
        label = f"the growth of the noise with {self.covariate}"
        return (self.parameter(self.covariate, "1", 0.3, label),)

    def port_indices(self, chain):
        """The noise has one component."""
        return (0,)

    def basis(self, state):
        """(1, 1, n) the covariate from its mean over its spread."""
        values = state.covariate(self.covariate)
        return known((values - self.mean) / self.spread)[None, None]
