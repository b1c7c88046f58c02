"""Values of a sampled motion between its samples: monotone piecewise cubics (Fritsch & Butland, SIAM J. Sci. Stat.
Comput. 5 (1984)).

A linear interpolation of samples at an interval h misses a motion of acceleration a by up to a h^2 / 8, which is
0.25 mrad for 5 rad/s^2 and 20 ms. The cubic follows the acceleration and never leaves the range of the two samples next
to it, so that steps between stations do not overshoot.
"""

import numpy as np


def interpolated(times: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(m,) values at the times `wanted` (m,) of n samples; times (n,) ascending, equal times allowed.

    Outside the samples the first or the last value; next to a sample that is not finite, nan.
    """
    if len(times) < 3:
        return np.interp(wanted, times, values)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    before = after - 1
    interval = times[after] - times[before]
    share = np.clip((wanted - times[before]) / np.where(interval > 0, interval, 1.0), 0.0, 1.0)
    rise = values[after] - values[before]
    first = _tangents(times, values, before) * interval
    last = _tangents(times, values, after) * interval
    bend = share * (1 - share)
    change = share**2 * (3 - 2 * share) * rise
    return values[before] + change + bend * ((1 - share) * first - share * last)


def _tangents(times: np.ndarray, values: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(m,) slopes at the samples `samples` (m,): weighted harmonic means of the slopes to either side, 0 at extrema.

    At the ends, and at a step between two samples of equal time, the slope of the side that has one.
    """
    slope_before, end_slope_before = _slopes(times, values, np.maximum(samples - 1, 0), samples)
    slope_after, end_slope_after = _slopes(
        times, values, samples, np.minimum(samples + 1, len(times) - 1)
    )
    weight_back, weight_ahead = 2 * slope_after + slope_before, slope_after + 2 * slope_before
    is_inner = end_slope_before * end_slope_after > 0
    divisor = weight_back * end_slope_after + weight_ahead * end_slope_before
    product = (weight_back + weight_ahead) * end_slope_before * end_slope_after
    mean = np.where(is_inner, product / np.where(is_inner, divisor, 1.0), 0.0)
    return np.where(
        slope_before == 0, end_slope_after, np.where(slope_after == 0, end_slope_before, mean)
    )


def _slopes(times, values, first, last) -> tuple[np.ndarray, np.ndarray]:
    """(m,) intervals from samples `first` to `last`, and slopes, 0 over an interval of 0."""
    interval = times[last] - times[first]
    rise = values[last] - values[first]
    return interval, np.where(interval > 0, rise / np.where(interval > 0, interval, 1.0), 0.0)
