"""What the effects of the sensor share: heat, and nothing where an observation lacks what they act on."""

import numpy as np

from workbench.core.covariates import warmth, warmth_sizes
from workbench.core.effect import Variant


def known(values: np.ndarray) -> np.ndarray:
    """The same with 0 for nan: an observation without a light plane, say, is not moved by one."""
    return np.where(np.isnan(values), 0.0, values)


def heat(state, *names: str) -> np.ndarray:
    """(n,) K above the reference, else hours, as `warmth`; InputError where neither was recorded."""
    if not {*names, "temperature_c", "time_s"} & set(state.covariates):
        state.covariate("temperature_c")
    return warmth(state, *names)


heat_sizes = warmth_sizes
CLOCKS = ("temperature_c", "time_s")


def warming(kind, chain):
    """The effect `kind` at its places, where temperature or else time varies; with what it has to do without."""
    if any(chain.varies(name) for name in CLOCKS):
        known = any(name.startswith("temperature") for name in chain.varying)
        for place in kind.places:
            for where in chain.places(place):
                yield Variant(kind(where), missing="" if known else "temperature")
