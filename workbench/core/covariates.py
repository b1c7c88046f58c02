"""Derived covariates of effects: the clock, the last moves of the joints, and the temperature above the reference."""

import numpy as np


def known(values: np.ndarray) -> np.ndarray:
    """The same with 0 for nan: an observation without a light plane, say, is not moved by one."""
    return np.where(np.isnan(values), 0.0, values)


def clock(state) -> np.ndarray:
    """(n,) time in s where it was recorded, else the row number."""
    return state.covariates.get(
        "time_s", state.covariates.get("row", np.arange(state.n, dtype=float))
    )


def instant_format(state) -> str:
    """Format string that shows an instant of `clock` with its unit, or as the number of a row."""
    return "{:g} s" if "time_s" in state.covariates else "row {:g}"


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
        state.covariate("temperature_c")  # raises: without an order there is no substitute
    return clock(state) / 3600


WIND_UP = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Widths (rad; m of a slide) over which friction winds up a joint, for which the state is known for each sample."""


def last_side(joint: int) -> str:
    """Name of the covariate that holds the direction of the last move of a joint, counted from 1."""
    return f"move{joint}_side"


def last_sides(moves: np.ndarray, time: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """(J, n) direction, -1 or 1, in which each joint moved last, in the order of `time` (n,); 0 before the first move.

    moves (J, n) as of `last_moves`. A direction counts once the joint has travelled more than `travel` (J,) in it, so
    that rounded readings of a joint that stands still change no side (the play operator: Visintin, Differential Models
    of Hysteresis (1994), sec. III.2). Rows of one pose share a move and a side.
    """
    order = np.argsort(time, kind="stable")
    steps = moves[:, order]
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(steps, axis=1) != 0).any(0)
    offset, side = np.zeros(len(moves)), np.zeros(len(moves))
    reached = np.empty((int(is_new.sum()), len(moves)))
    for k, step in enumerate(steps[:, is_new].T):
        offset = np.clip(offset + step, -travel / 2, travel / 2)
        side = np.where(np.abs(offset) >= travel / 2, np.sign(offset), side)
        reached[k] = side
    out = np.empty_like(steps)
    out[:, order] = reached[np.cumsum(is_new) - 1].T
    return out


def reversals(side: np.ndarray, time: np.ndarray) -> int:
    """How often a side (n,), -1 or 1 and 0 where not known, changes in the order of `time` (n,)."""
    ordered = side[np.argsort(time, kind="stable")]
    return int(np.count_nonzero(np.diff(ordered[ordered != 0])))


def wound_up(moves: np.ndarray, time: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(J, W, n) state of friction, from -1 to 1, after the moves (J, n) in the order of `time` (n,); 0 at first.

    Bouc-Wen with exponent 1 and beta = gamma = 1/2, straight moves: dz/dq = (1 - |z| (1 + sign(z dq)) / 2) / width, so
    that z first falls linearly to 0 and then approaches the sign of the move exponentially. widths (J, W), units of the
    moves. Rows of one pose share a move and a state: a move counts where it differs from that of the row before.
    """
    order = np.argsort(time, kind="stable")
    steps = moves[:, order]
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(steps, axis=1) != 0).any(0)
    arrived = order[is_new]
    side = np.where(moves[:, arrived] < 0, -1.0, 1.0).T[:, :, None]  # (K, J, 1)
    lengths = np.abs(moves[:, arrived]).T[:, :, None] / widths
    z, reached = np.zeros(widths.shape), np.empty((len(arrived), *widths.shape))
    for k, length in enumerate(lengths):
        z = reached[k] = side[k] * _wound(side[k] * z, length)
    out = np.empty((*widths.shape, len(order)))
    out[:, :, order] = np.moveaxis(reached[np.cumsum(is_new) - 1], 0, -1)
    return out


def _wound(z: np.ndarray, length: np.ndarray) -> np.ndarray:
    """The state after a straight move whose length is given in widths; z, from -1 to 1, is positive along the move."""
    beyond = (
        np.minimum(z, 0.0) + length
    )  # what remains once the spring is released; negative: not yet released
    wound = 1 - (1 - np.maximum(z, 0.0)) * np.exp(-np.maximum(beyond, 0.0))
    return np.minimum(beyond, 0.0) + wound


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
