"""Uncertainty of laws beyond the recorded range of their argument: empirical functions, and drifts after the recording.

An empirical function is extrapolated by its structure function within the range; a drift may go on, slow down or stop.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from workbench.core.effect import Effect

CLOCK = "time_s"
"""Covariate of the laws of time."""
GRID = 257
"""Least number of grid points over a recorded range."""
_PER_HALF_WAVE = 8


def grid_points(half_waves: int) -> int:
    """Points of a grid that resolves a function with so many half waves over its range."""
    return max(GRID, _PER_HALF_WAVE * half_waves + 1)


def distance_beyond(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """(n,) distance of values (n,) from an interval; 0 within it."""
    return np.maximum(np.maximum(low - x, x - high), 0.0)


def extrapolation_sigma(values: np.ndarray, span: float, distance: np.ndarray) -> np.ndarray:
    """(m, n) 1 sigma of what m functions change by over distances (n,) beyond the range that they were fitted on.

    values (m, ..., G): on a uniform grid over that range, of length `span`, along the last axis; axes between the first
    and the last one are averaged over. Each function is a realisation of a random function with stationary increments.
    Their mean square over a distance d is the structure function D(d) = mean over x of (f(x + d) - f(x))^2 (Kolmogorov;
    twice the variogram of geostatistics: Matheron, Econ. Geol. 58 (1963) 1246). It is estimated from all pairs up to
    half the range. A function does not become better known with distance: sqrt(D) never decreases here, as it would at
    the period of a harmonic, and the linear trend of the function continues beyond.
    """
    points = values.shape[-1]
    lags = np.arange(1, points // 2 + 1)
    averaged = tuple(range(1, values.ndim))
    increments = [values[..., k:] - values[..., :-k] for k in lags]
    structure = np.stack([(increment**2).mean(averaged) for increment in increments], 1)
    grown = np.maximum.accumulate(np.sqrt(structure), 1)
    known = np.concatenate([[0.0], lags * span / (points - 1)])
    sigma = np.stack([np.interp(distance, known, [0.0, *row]) for row in grown])
    return np.maximum(sigma, _trend(values, span)[:, None] * distance)


def _trend(values: np.ndarray, span: float) -> np.ndarray:
    """(m,) size of the slope of the straight line through each function, RMS over the axes that are averaged over."""
    place = np.linspace(-0.5, 0.5, values.shape[-1]) * span
    slope = values @ place / max(place @ place, 1e-300)
    return np.sqrt((slope**2).reshape(len(values), -1).mean(1))


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


__all__ = [
    "CLOCK",
    "GRID",
    "change_after_recording",
    "distance_beyond",
    "extrapolation_sigma",
    "grid_points",
]
