"""Uncertainty of laws of time after the recording that they were fitted on: a drift may go on, slow down or stop."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from robot_model.effects.structure_function import distance_beyond
from workbench.core.effect import Effect

CLOCK = "time_s"


def change_after_recording(
    effect: Effect, p: np.ndarray, state, recorded: Mapping[str, tuple[float, float]] | None
) -> np.ndarray | None:
    """(m, n) size of what a law predicts to change between the end of the recording and the time of each sample.

    As 1 sigma: that the law holds on beyond the recording is as likely as that the change ends with it. None for
    samples within the recorded time, and where no time was recorded or its range is not known.
    """
    low, high = (recorded or {}).get("time", (-np.inf, np.inf))
    time = state.covariates.get(CLOCK)
    if time is None or not distance_beyond(time, low, high).any():
        return None
    known = {**state.covariates, CLOCK: np.clip(time, low, high)}
    last = effect.delta(p, replace(state, covariates=known))
    return np.abs(effect.delta(p, state) - last)


__all__ = ["CLOCK", "change_after_recording"]
