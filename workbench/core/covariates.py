"""Derived covariates of effects: the clock, the last moves of the joints, and the temperature above the reference."""

import math
from dataclasses import dataclass

import numpy as np


def known(values: np.ndarray) -> np.ndarray:
    """The same with 0 for nan: an observation without a light plane, say, is not moved by one."""
    return np.where(np.isnan(values), 0.0, values)


def clock(state) -> np.ndarray:
    """(n,) time in s where it was recorded, else the row number."""
    return state.covariates.get(
        "time_s", state.covariates.get("row", np.arange(state.n, dtype=float))
    )


def instants_between(state, is_own: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(V,) instants midway between two samples, but for the first and the last two; is_own (n,): of these samples."""
    instants = np.unique(clock(state)[is_own])
    return ((instants[1:] + instants[:-1]) / 2)[2:-2]


def instant_format(state) -> str:
    """Format string that shows an instant of `clock` with its unit, or as the number of a row."""
    return "{:g} s" if "time_s" in state.covariates else "row {:g}"


def last_moves(
    variables: np.ndarray, time: np.ndarray, is_static: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """(J, n) how far each joint came from the configuration before, in the order of `time` (n,).

    Rows one after another with the same `pose` (n,), or that differ by no more than `is_static` (J,), were measured at
    one configuration, as several reflectors are, and share how it was reached. The first has moved nowhere.
    """
    order = np.argsort(time, kind="stable")
    q = variables[:, order]
    step = np.diff(q, axis=1, prepend=q[:, :1])
    came = (np.abs(step) > is_static[:, None]).any(0) & (
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
    poses = steps[:, is_new]
    sides = [_sides(row, limit / 2) for row, limit in zip(poses, travel, strict=True)]
    reached = np.reshape(sides, poses.shape)
    out = np.empty_like(steps)
    out[:, order] = reached[:, np.cumsum(is_new) - 1]
    return out


def _sides(steps: np.ndarray, half: float) -> list[float]:
    """Output of a play operator of half width `half` > 0 for successive steps (K,): -1, 0 or 1.

    Plain numbers: each value depends on the one before, and an array of a few joints costs ten times as much.
    """
    offset = 0.0
    side = 0.0
    sides = []
    for step in steps.tolist():
        offset += step
        if offset >= half:
            offset = half
            side = 1.0
        elif offset <= -half:
            offset = -half
            side = -1.0
        sides.append(side)
    return sides


def reversals(side: np.ndarray, time: np.ndarray) -> int:
    """Count the changes of a side (n,), -1 or 1 and 0 where not known, in the order of `time` (n,)."""
    ordered = side[np.argsort(time, kind="stable")]
    return int(np.count_nonzero(np.diff(ordered[ordered != 0])))


@dataclass(frozen=True)
class MotionHistory:
    """The moves that led to each sample, which friction remembers.

    `moves` (J, K) rad, mm: of every joint to each of K configurations, in the order in which they were measured;
    `reached` (n,): the configuration of each sample.
    """

    moves: np.ndarray
    reached: np.ndarray

    @classmethod
    def of(cls, moves: np.ndarray, time: np.ndarray) -> "MotionHistory":
        """Of moves (J, n) as of `last_moves`, in the order of `time` (n,).

        Rows of one pose share a move: it counts where it differs from that of the row before.
        """
        order = np.argsort(time, kind="stable")
        steps = moves[:, order]
        is_new = np.ones(len(order), bool)
        is_new[1:] = (np.diff(steps, axis=1) != 0).any(0)
        reached = np.empty(len(order), int)
        reached[order] = np.cumsum(is_new) - 1
        return cls(steps[:, is_new], reached)

    def at(self, samples: np.ndarray) -> "MotionHistory":
        """The history of some of the samples: all moves that led to them, those to other samples too."""
        return MotionHistory(self.moves, self.reached[samples])

    def wound_up(self, joint: int, width: float, of_dahl: bool = False) -> np.ndarray:
        """(n,) state of friction of a joint, from 1, between -1 and 1; 0 before the first move.

        Bouc-Wen with exponent 1 and beta = gamma = 1/2, straight moves: dz/dq = (1 - |z| (1 + sign(z dq)) / 2) / width,
        so that z first falls linearly to 0 and then approaches the sign of the move exponentially. of_dahl: by Dahl's
        law with exponent 1, dz/dq = (1 - z sign(dq)) / width, exponential from the reversal on. width: rad, mm.
        """
        state = 0.0
        states = []
        wound = _wound_by_dahl if of_dahl else _wound
        for length in (self.moves[joint - 1] / width).tolist():
            if length >= 0:
                state = wound(state, length)
            else:
                state = -wound(-state, -length)
            states.append(state)
        return np.array(states)[self.reached]


def _wound(z: float, length: float) -> float:
    """The state after a straight move whose length is given in widths; z, from -1 to 1, is positive along the move."""
    if z < 0:
        released = min(-z, length)
        z, length = z + released, length - released
    return z if length == 0 else _wound_by_dahl(z, length)


def _wound_by_dahl(z: float, length: float) -> float:
    """As `_wound`, where z approaches 1 exponentially from any value."""
    return 1 - (1 - z) * math.exp(-length)


def missing_temperature(state, *names: str) -> str:
    """ "temperature" where `warmth` has to use time instead; else ""."""
    known = any(name in state.covariates for name in (*names, "temperature_c"))
    return "" if known else "temperature"


def limit_expansion(effect, state, *names: str) -> None:
    """State the sign and the plausible limit of an effect that is a linear expansion; its size with time is open."""
    if not missing_temperature(state, *names):
        effect.nonnegative, effect.largest = 1, LARGEST_EXPANSION


def warmth_sizes(state, kelvin: float, *names: str) -> tuple[str, float, float | None]:
    """Unit of `warmth`, and typical size and prior of what grows with it by about `kelvin` a kelvin.

    An arm that works warms by up to ten kelvins in its first hour, so an hour's worth is larger.
    """
    if any(name in state.covariates for name in (*names, "temperature_c")):
        return "K", kelvin, None
    return "h", 5 * kelvin, 30 * kelvin


LARGEST_EXPANSION = 1.5e-4
"""Coefficient of linear expansion that no material of a machine exceeds, 1/K: metals have 5e-6 to 25e-6, unfilled
plastics about 1e-4. None of them is negative."""
REFERENCE_C = 20.0
"""ISO 1: the standard reference temperature for dimensions, in degrees Celsius."""
