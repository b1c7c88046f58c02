"""Common part of the thermal effects of a scanner: the law of a warm-up, and where a diagnosis tests it."""

from typing import Annotated

import numpy as np
from pydantic import Field

from workbench.core.covariates import warmth, warmth_sizes
from workbench.core.effect import Variant
from workbench.core.vocabulary import Covariate

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
CLOCKS = ("temperature_c", "time_s")
_TIME_CONSTANTS = (30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)  # s, where the times are not known
# Of the duration: a shorter warm-up is over within the first images, a longer one is linear. Neighbours differ by a
# third, so that the nearest one leaves 1 % of the drift.
_SHORTEST, _LONGEST, _COUNT = 1 / 60, 1.5, 17
_RESOLVED = (
    1 / 3
)  # of the time to the second image, at which 5 % of such a warm-up are still to come


class WarmUpLaw:
    """Linear growth with temperature or time, or a warm-up with a time constant.

    `time_constant_s` 0: in proportion to the temperature above the reference, or to the hours where none was recorded.
    Else 1 - exp(-(t - start) / tau), the response of a body of one heat capacity to a constant power from `start_s` on.
    """

    column = "temperature_c"

    def __init__(
        self,
        where: str,
        time_constant_s: Annotated[float, Field(ge=0)] = 0.0,
        start_s: float = 0.0,
    ):
        super().__init__(where)
        self.time_constant_s, self.start_s = time_constant_s, start_s
        if time_constant_s:
            self.needs = self.reads = ("time_s",)

    def option_unit(self, chain, name):
        return "s"

    def progress(self, state) -> np.ndarray:
        """(n,) the factor by which the parameters are multiplied."""
        if not self.time_constant_s:
            return warmth(state, self.column)
        passed = np.maximum(state.covariate("time_s") - self.start_s, 0.0)
        return -np.expm1(-passed / self.time_constant_s)

    def sizes(self, chain, kelvin: float) -> tuple[str, float, float | None]:
        """Unit of `progress`, typical size and prior of a parameter that changes by about `kelvin` a kelvin."""
        if not self.time_constant_s:
            return warmth_sizes(chain.state, kelvin, self.column)
        return "1", 5 * kelvin, 30 * kelvin


def warm_ups(kind, where: str, times, prior: float = 1.0, missing: str = "", suffix: str = ""):
    """Variants of a `WarmUpLaw` with time constants that images at `times` (n,) s can distinguish.

    suffix: of their labels, which variants of several laws of one effect are distinguished by.
    """
    constants, start = time_constants(times)
    word = "warming up with time constant {:g} s" + suffix
    for constant in constants:
        description = (word.format(constant), prior / len(constants), missing)
        yield Variant(kind(where, constant, start), *description, "time_constant_s", word)


def time_constants(times) -> tuple[list[float], float]:
    """Time constants (s), three digits each, that images at `times` (n,) s can distinguish, and when they begin (s)."""
    duration = float(np.ptp(times)) if len(times) else 0.0
    if not duration > 0:
        return list(_TIME_CONSTANTS), 0.0
    start, second = np.unique(times)[:2]
    shortest = max(_SHORTEST * duration, _RESOLVED * (second - start))
    values = np.geomspace(shortest, _LONGEST * duration, _COUNT)
    return [float(f"{value:.3g}") for value in values], float(start)


def warming(kind, chain):
    """The `WarmUpLaw` `kind` at its places, where temperature or else time varies; with what it has to do without."""
    if not any(chain.varies(name) for name in CLOCKS):
        return
    known = any(Covariate.of(name).kind == "temperature" for name in chain.varying)
    for where in (place_of_kind for place in kind.places for place_of_kind in chain.places(place)):
        if known or not chain.varies("time_s"):
            yield Variant(kind(where), missing_covariate="" if known else "temperature")
            continue
        yield Variant(kind(where), "linear with time", 0.5, "temperature")
        yield from warm_ups(kind, where, getattr(chain, "times", ()), 0.5, "temperature")
