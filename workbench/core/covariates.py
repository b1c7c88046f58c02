"""Covariates as effects use them: a clock, and how warm it is against the mean of the recording."""

import numpy as np


def known(values: np.ndarray) -> np.ndarray:
    """The same with 0 for nan: an observation without a light plane, say, is not moved by one."""
    return np.where(np.isnan(values), 0.0, values)


def clock(state) -> np.ndarray:
    """(n,) time in s where it was recorded, else the row number."""
    return state.covariates.get(
        "time_s", state.covariates.get("row", np.arange(state.n, dtype=float))
    )


def last_moves(
    variables: np.ndarray, time: np.ndarray, still: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """(J, n) how far each joint came from the configuration before, in the order of `time` (n,).

    Rows one after another with the same `pose` (n,), or that differ by no more than `still` (J,), were measured at one
    configuration, as several reflectors are, and share how it was reached. The first has moved nowhere.
    """
    order = np.argsort(time, kind="stable")
    q = variables[:, order]
    step = np.diff(q, axis=1, prepend=q[:, :1])
    came = (np.abs(step) > still[:, None]).any(0) & (
        np.diff(pose[order], prepend=pose[order[:1]]) != 0
    )
    arrived = np.maximum.accumulate(np.where(came, np.arange(len(order)), 0))
    moves = np.empty_like(q)
    moves[:, order] = step[:, arrived]
    return moves


def warmth(state, *names: str) -> np.ndarray:
    """(n,) temperature above `REFERENCE_C` from the first column that is there, in K; else hours.

    InputError where there is neither a temperature nor a time nor an order of the samples.

    A fixed reference, and not the recording's mean, so that a held-out part of it means the same.
    """
    for name in (*names, "temperature_c"):
        if name in state.covariates:
            return state.covariates[name] - REFERENCE_C
    if "time_s" not in state.covariates and not getattr(state, "in_order", True):
        state.covariate("temperature_c")  # raises: without an order nothing stands in for it
    return clock(state) / 3600


def missing_temperature(state, *names: str) -> str:
    """ "temperature" where `warmth` has to use time instead; else ""."""
    known = any(name in state.covariates for name in (*names, "temperature_c"))
    return "" if known else "temperature"


def warmth_sizes(state, kelvin: float, *names: str) -> tuple[str, float, float | None]:
    """Unit of `warmth`, and typical size and prior of what grows with it by about `kelvin` a kelvin.

    An arm that works warms by up to ten kelvins in its first hour, so an hour's worth is larger.
    """
    if any(name in state.covariates for name in (*names, "temperature_c")):
        return "K", kelvin, None
    return "h", 5 * kelvin, 30 * kelvin


REFERENCE_C = 20.0
"""ISO 1: the standard reference temperature for dimensions, in degrees Celsius."""
