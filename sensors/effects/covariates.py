"""What the effects of the sensor share: heat, and nothing where an observation lacks what they act on."""

import numpy as np

from workbench.core.covariates import warmth, warmth_sizes


def known(values: np.ndarray) -> np.ndarray:
    """The same with 0 for nan: an observation without a light plane, say, is not moved by one."""
    return np.where(np.isnan(values), 0.0, values)


def heat(state, *names: str) -> np.ndarray:
    """(n,) K above the reference, else hours, as `warmth`; InputError where neither was recorded."""
    if not {*names, "temperature_c", "time_s"} & set(state.covariates):
        state.covariate("temperature_c")
    return warmth(state, *names)


heat_sizes = warmth_sizes
