"""Effects on the measured point: the sensor's field, the artefact, and the noise."""

import numpy as np

from workbench.core.common_effects import (
    ArtefactExpansionLaw,
    BallPositionLaw,
    FieldBiasLaw,
    LateralScaleLaw,
    NoiseLaw,
    RangeScaleLaw,
)
from workbench.core.covariates import (
    known,
    limit_expansion,
    missing_temperature,
    warmth,
    warmth_sizes,
)
from workbench.core.effect import Effect, Variant


class RangeScale(RangeScaleLaw, Effect):
    """The sensor's range is off by a share of the distance from its middle range."""

    port = "sensor"

    @classmethod
    def candidates(cls, chain):
        """About the mean range of the recording."""
        for where in chain.places("sensor"):
            yield Variant(cls(where, float(np.round(chain.state.points[2].mean()))))


class LateralScale(LateralScaleLaw, Effect):
    """A lateral coordinate of the sensor is off by a share of itself, as x of a profiler."""

    port = "sensor"

    @classmethod
    def candidates(cls, chain):
        """Of x, where all points lie in the plane y = 0 of a profiler."""
        sensors = chain.places("sensor")
        if not sensors:  # a length has no point
            return
        x, y, _ = chain.state.points
        if np.ptp(x) > 0 and not np.any(y):
            yield from map(Variant, map(cls, sensors))


class SensorThermalGrowth(Effect):
    """The sensor's scale changes with its temperature: camera and laser move apart as their mount expands."""

    effect = "sensor-thermal-growth"
    port = "sensor"
    places = ("sensor",)
    equation = "p -> p (1 + c (T - T0)), p the point in the sensor frame"
    source = "first-order thermal drift of a triangulation sensor"
    reads = ("temperature",)
    column = "temperature_sensor_c"

    @classmethod
    def candidates(cls, chain):
        """One, where a temperature is recorded and varies."""
        if chain.varies(cls.column) or chain.varies("temperature_c"):
            yield from map(Variant, map(cls, chain.places("sensor")))

    def table(self, chain):
        unit, size, prior = warmth_sizes(chain.state, 1e-4, self.column)
        return (self.parameter("per_unit", f"1/{unit}", size, "the sensor's scale", prior),)

    def basis(self, state):
        return (known(state.points) * warmth(state, self.column))[None]


class FieldBias(FieldBiasLaw, Effect):
    """The sensor's range is off by a quadratic polynomial of the place in its field."""

    port = "sensor"
    equation = f"{FieldBiasLaw.equation}, x and y in units of 100 mm"


class BallPosition(BallPositionLaw, Effect):
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    @classmethod
    def candidates(cls, chain):
        """Of every ball where there are several: the position of a single one is that of the artefact."""
        balls = chain.places("ball")
        if len(balls) > 1:
            return [Variant(cls(where)) for where in balls]
        return []


class ArtefactExpansion(ArtefactExpansionLaw, Effect):
    """The plate that carries the balls grows with temperature, or with time where none was recorded."""

    @classmethod
    def candidates(cls, chain):
        """One, with time where no temperature is recorded."""
        for expansion in map(cls, chain.places("artefact")):
            limit_expansion(expansion, chain.state, cls.column)
            yield Variant(expansion, missing_covariate=missing_temperature(chain.state, cls.column))


class NoiseHeteroscedastic(NoiseLaw, Effect):
    """The spread, not the mean, depends on a covariate."""
