"""Effects on the measured point: the sensor's field, the artefact, and the noise."""

from typing import Annotated

import numpy as np
from pydantic import Field

from workbench.core.covariates import missing_temperature, warmth, warmth_sizes
from workbench.core.effect import Effect, Variant


class RangeScale(Effect):
    """The sensor's range is off by a share of the distance from its middle range."""

    effect = "range-scale"
    port = "sensor"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c (z - z0)"
    source = "first-order range error of a triangulation sensor"

    def __init__(self, where: str, z0: float = 0.0):
        super().__init__(where)
        self.z0 = z0

    @classmethod
    def candidates(cls, chain):
        """About the mean range of the recording."""
        for where in chain.places("sensor"):
            yield Variant(cls(where, float(np.round(chain.state.measured[2].mean()))))

    def table(self, chain):
        return (self.parameter("scale", "mm/mm", 1e-3, "the range scale"),)

    def basis(self, state):
        return (state.measured[2] - self.z0)[None, None]


class FieldBias(Effect):
    """The sensor's range is off by a quadratic polynomial of the place in its field."""

    effect = "field-bias"
    port = "sensor"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c1 x + c2 y + c3 x^2 + c4 x y + c5 y^2, x and y in units of 100 mm"
    source = "second-order expansion of what a camera or light-plane model leaves"

    def table(self, chain):
        return tuple(
            self.parameter(name, "mm", 0.02, f"the field bias in {name}")
            for name in ("x", "y", "xx", "xy", "yy")
        )

    def basis(self, state):
        x, y = state.measured[:2] / 100
        return np.stack([x, y, x * x, x * y, y * y])[:, None]


class BallPosition(Effect):
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    effect = "ball-position"
    port = "target"
    places = ("ball",)
    equation = "ball K -> ball K + d"
    source = "one free vector a ball"

    @classmethod
    def candidates(cls, chain):
        """Of every ball where there are several: the position of a single one is that of the artefact."""
        balls = chain.places("ball")
        return [Variant(cls(where)) for where in balls] if len(balls) > 1 else []

    def table(self, chain):
        return tuple(
            self.parameter(axis, "mm", 0.05, f"ball {self.number}'s error along {axis}")
            for axis in "xyz"
        )

    def basis(self, state):
        mine = (state.index == self.number).astype(float)
        return np.eye(3)[:, :, None] * mine


class ArtefactExpansion(Effect):
    """The plate that carries the balls grows with temperature, or with time where none was recorded."""

    effect = "artefact-expansion"
    port = "target"
    places = ("artefact",)
    equation = "ball -> ball (1 + c (T - T0))"
    source = "linear expansion about the artefact's origin"
    reads = ("temperature",)
    unrecorded = "temperature"

    @classmethod
    def candidates(cls, chain):
        """One, with time where no temperature is recorded."""
        for made in map(cls, chain.places("artefact")):
            yield Variant(made, missing=missing_temperature(chain.state, "temperature_artefact_c"))

    def table(self, chain):
        unit, size, prior = warmth_sizes(chain.state, 1e-5, "temperature_artefact_c")
        return (self.parameter("per_unit", f"1/{unit}", size, "the artefact's expansion", prior),)

    def basis(self, state):
        return (state.target * warmth(state, "temperature_artefact_c"))[None]


class NoiseHeteroscedastic(Effect):
    """The spread, not the mean, depends on a covariate."""

    effect = "noise-heteroscedastic"
    port = "noise"
    places = ("noise",)
    equation = "log sigma -> log sigma + c (s - mean s) / spread of s"
    source = "log-linear variance model: Harvey, Econometrica 44 (1976)"

    @classmethod
    def candidates(cls, chain):
        """None: the diagnosis tests the variance apart from the mean."""
        return ()

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
        return (self.covariate,)

    def table(self, chain):
        return (
            self.parameter(
                self.covariate, "1", 0.3, f"the growth of the noise with {self.covariate}"
            ),
        )

    def slots(self, chain):
        return (0,)

    def basis(self, state):
        return ((state.covariate(self.covariate) - self.mean) / self.spread)[None, None]
